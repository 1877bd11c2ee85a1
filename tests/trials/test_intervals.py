"""Intervals of means, shares and paired differences are those of SciPy, and cover the truth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from glucoloop.trials.people import PeopleRows
from glucoloop.trials.statistics import (
    FEWEST_DIFFERENT,
    Margin,
    Moments,
    PairedDifferences,
    mean_interval,
    people_for,
    share_difference_interval,
    share_interval,
)


def moments_of(values):
    moments = Moments()
    moments.add(np.asarray(values, float))
    return moments


def rows(minimum, **metrics):
    minimum = np.asarray(minimum, float)
    metrics = {"minimum_mg_dl": minimum, **{name: np.asarray(values, float) for name, values in metrics.items()}}
    everybody = np.ones(minimum.size, bool)
    return PeopleRows(np.arange(minimum.size), everybody, 40.0 + 0.0 * minimum, {}, metrics)


def differences(first, other):
    paired = PairedDifferences((54,))
    paired.add(first, other, first.feasible)
    return paired.plain()


@given(st.integers(1, 400).flatmap(lambda total: st.tuples(st.integers(0, total), st.just(total))))
def test_a_share_has_the_interval_of_wilson(of):
    count, total = of
    expected = stats.binomtest(count, total).proportion_ci(method="wilson")
    assert share_interval(count, total) == pytest.approx((100.0 * expected.low, 100.0 * expected.high), abs=1e-9)


def test_without_people_there_is_no_interval():
    for interval in (mean_interval(Moments()), share_interval(0, 0), share_difference_interval(0, 0, 0)):
        assert np.isnan(interval).all()
    assert people_for(1.0, math.nan) is None


@given(st.floats(0.01, 50.0), st.floats(0.01, 100.0))
def test_so_many_people_make_an_interval_as_narrow_as_asked(half_width, sd):
    people = people_for(half_width, sd)

    def half(number):
        return stats.t.ppf(0.975, number - 1) * sd / math.sqrt(number)

    assert half(people) <= half_width * (1.0 + 1e-12)
    assert people == 2 or half(people - 1) > half_width * (1.0 - 1e-6)


@pytest.mark.parametrize(("low", "high", "verdict"), [
    (-1.5, 1.9, "equivalent"), (2.1, 4.0, "higher"), (-4.0, -2.1, "lower"), (-1.0, 2.5, "inconclusive"),
    (math.nan, math.nan, "inconclusive"),
])  # fmt: skip
def test_a_margin_is_judged_by_the_whole_interval(low, high, verdict):
    assert Margin("time_70_180_pct", 2.0).verdict({"low": low, "high": high}) == verdict


def test_a_difference_of_few_people_has_no_interval():
    minimum = np.full(50, 90.0)
    longer = np.zeros(50)
    longer[: FEWEST_DIFFERENT - 1] = 5.0
    first = rows(minimum, time_below_54_pct=np.zeros(50))
    few = differences(first, rows(minimum, time_below_54_pct=longer))["metrics"]["time_below_54_pct"]
    assert few["mean"] == pytest.approx(longer.mean())
    assert math.isnan(few["low"])
    longer[:FEWEST_DIFFERENT] = 5.0
    enough = differences(first, rows(minimum, time_below_54_pct=longer))["metrics"]["time_below_54_pct"]
    assert enough["low"] < enough["mean"] < enough["high"]


def test_intervals_of_paired_differences_cover_the_truth():
    """In 1 000 simulated trials of skewed metrics, of people who react alike under both controllers."""
    rng, people, held = np.random.default_rng(5), 100, {"time_above_180_pct": 0, "54_mg_dl": 0}
    for _ in range(1000):
        sick, luck = rng.gamma(2.0, 10.0, people), rng.random((2, people))
        before, after = (sick * rng.gamma(4.0, 0.25, people) * factor for factor in (1.0, 0.8))
        low = [np.where(luck[0] + 0.2 * luck[1] < bound, 50.0, 90.0) for bound in (0.3, 0.2)]
        plain = differences(rows(low[0], time_above_180_pct=before), rows(low[1], time_above_180_pct=after))
        of_time, of_low = plain["metrics"]["time_above_180_pct"], plain["ever_below"]["54_mg_dl"]
        held["time_above_180_pct"] += of_time["low"] <= -0.2 * 20.0 <= of_time["high"]
        held["54_mg_dl"] += (
            of_low["low"] <= -10.0 <= of_low["high"]
        )  # a uniform and a fifth of another one, shares .2, .1
    assert all(930 <= count <= 970 for count in held.values()), held
