"""Ranges, fronts, objectives and samplers of a search for a robust tuning."""

import dataclasses
import math
import sys

import numpy as np
import polars as pl
import pytest

from glucoloop.component.setting import Tuned, parse_range
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import configured
from glucoloop.storage.results import parquet
from glucoloop.studies.robust import BOTH, RANGES, Search
from glucoloop.studies.robust.search import NO_SCORES, _Bound, _choose, _judged, _pareto, objective, rows_of, scores
from glucoloop.tuning.samplers import SAMPLERS, Evaluated


def test_ranges_are_read_as_they_are_written():
    for tuned in RANGES.values():
        assert parse_range(tuned.text, tuned) == dataclasses.replace(tuned, by_default=True)
        assert (tuned.at(0.0), tuned.at(1.0)) == (tuned.low, tuned.high)
    assert parse_range(".1:2", RANGES["move_weight"]) == Tuned("move_weight", 0.1, 2.0, log=True)
    assert parse_range(" 7.5 ", RANGES["caution_weight"]) == 7.5
    assert Tuned("x", 1.0, 100.0, log=True).at(0.5) == 10.0
    assert Tuned("x", 1.0, 100.0, log=False).at(0.5) == 50.5
    assert Tuned("x", 1.0, 2.0, log=False).rounded(1.23456) == 1.235


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("2:1", "move_weight is '2:1'.*the lower first"),
        ("0:1", "a lower bound above 0"),
        ("1:2:3", "write it like .1:2"),
        ("nan", "write it like .1:2"),
        ("a:b", "write it like .1:2"),
    ],
)
def test_what_is_no_range_is_refused(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        parse_range(text, RANGES["move_weight"])


def test_front_is_what_nobody_beats():
    random = np.random.default_rng(0)
    values = np.concatenate([random.integers(0, 6, (60, 2)).astype(float), random.random((40, 2)) * 6.0])
    beaten = [any((other <= own).all() and (other < own).any() for other in values) for own in values]
    np.testing.assert_array_equal(_pareto(values), ~np.array(beaten))


def test_choice_of_the_front():
    front = np.array([[0.0, 10.0], [1.0, 2.0], [10.0, 0.0]])
    names = ("peak-p95", "undershoot-p95")
    assert [_choose(front, names, of) for of in (*names, BOTH)] == [0, 2, 1]
    assert _choose(front[:1], names, BOTH) == 0


def test_bounds():
    peaks, names = [1.0, 0.9, None, 3.0], ("peak-p95", "undershoot-p95")
    tried = pl.DataFrame({name: peaks if name == "peak_p95_mg_dl" else [1.0] * 4 for name in NO_SCORES})

    def found(*bounds):
        table = _judged(tried, bounds, names)
        return table["keeps_the_bounds"].to_list(), table["chosen"].to_list().index(True)

    assert found() == ([True, True, False, True], 1)
    assert found(_Bound("peak-p95", 1.0)) == ([True, True, False, False], 1)
    assert found(_Bound("peak-p95", 0.89)) == ([False] * 4, 1)
    assert found(_Bound("peak-p95", 0.89), _Bound("peak-median", 2.0)) == ([False] * 4, 1)
    assert _Bound("peak-p95", 100.0).violation({"peak_p95_mg_dl": 110.0}) == pytest.approx(0.1)
    with pytest.raises(ValueError, match="no tuning of the search has a controller"):
        _judged(tried[2:3], (), names)


def test_scores_by_hand():
    lowest = np.array([59.9, 60.0, 81.0, 70.0, 75.0, 80.0])
    metrics = {
        "undershoot_mg_dl": 81.1 - lowest,
        "minimum_mg_dl": lowest,
        "peak_mg_dl": np.array([100.0, 120.0, 110.0, 90.0, 91.0, 95.0]),
        "insulin_total_variation_mU_min": np.array([9.0, 9.0, 9.0, 1.0, 2.0, 6.0]),
    }
    found = scores(metrics, 3)
    assert list(found) == list(NO_SCORES)
    assert found["undershoot_median_mg_dl"] == pytest.approx(6.1)
    assert found["undershoot_p95_mg_dl"] == pytest.approx(0.9 * 11.1 + 0.1 * 6.1)  # of three, 95 % lies at 1.9
    assert (found["peak_median_mg_dl"], found["total_variation_mU_min"]) == (91.0, 2.0)
    assert found["people_peak_p95_mg_dl"] == pytest.approx(119.0)
    assert found["people_below_60"] == 1.0
    metrics["minimum_mg_dl"] = np.full(6, np.nan)
    assert np.isnan(scores(metrics, 3)["people_below_60"])


def test_unknown_objectives_are_refused():
    with pytest.raises(ValueError, match="unknown objective 'peak'; did you mean"):
        objective("peak")


TWO = (Tuned("x", 0.01, 10.0, log=True), Tuned("y", -5.0, 5.0, log=False))


def trade(point):
    """Two parabolas whose front is x = 1 with y from 0 to 2, of which y may not exceed 1.5."""
    far = np.log10(point["x"]) ** 2
    return Evaluated(values=(far + point["y"] ** 2, far + (point["y"] - 2.0) ** 2), violation=(point["y"] - 1.5,))


def sampled(name, seed, **known):
    return SAMPLERS.find(name)(seed=seed).made(space=TWO, **known)


@pytest.mark.parametrize("name", ["tpe", "nsga2", "random"])
def test_samplers_stay_within_bounds_and_repeat_themselves(name):
    def tried(rounds):
        sampler = sampled(name, 3, batch=8, start={"x": 2.0, "y": 1.0})
        for _ in range(rounds):
            asked = sampler.ask(8)
            sampler.tell([trade(point) for point in asked])
            yield asked

    first, again = list(tried(3)), list(tried(3))
    assert first == again
    assert first[0][0] == {"x": 2.0, "y": 1.0}
    points = [point for asked in first for point in asked]
    assert all(of.holds(point[of.name]) for point in points for of in TWO)
    assert len({point["x"] for point in points}) > 20


def test_tpe_learns():
    def best(name):
        sampler, found = sampled(name, 0, batch=16), []
        for _ in range(6):
            asked = sampler.ask(16)
            found += [told for told in map(trade, asked) if told.violation[0] <= 0.0]
            sampler.tell([trade(point) for point in asked])
        return np.sort([sum(told.values) for told in found])[:20].mean()

    assert best("tpe") < 0.7 * best("random")  # the smallest sum is 2


def test_a_tuning_without_a_controller_is_told_too():
    sampler = sampled("tpe", 0, batch=2)
    sampler.ask(2)
    sampler.tell([Evaluated((np.nan, np.nan), (1e9,)), Evaluated((1.0, 1.0), (0.0,))])
    assert len(sampler.ask(2)) == 2


def test_chance_needs_no_optuna(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert len(sampled("random", 0, batch=4).ask(4)) == 4
    with pytest.raises(ValueError, match=r"needs optuna; install it with: pip install 'glucoloop\[search\]'"):
        sampled("tpe", 0, batch=4)
    with pytest.raises(ValueError, match="unknown sampler 'x'"):
        sampled("x", 0, batch=4)


def test_stored_candidates_outside_of_the_search_are_refused(tmp_path):
    config = configured(Search, {"rounds": 1, "batch": 2})
    kind, place = rows_of(config), tmp_path / "candidates.parquet"
    whole = {"candidate": 0, "round": 0, **{one.name: one.low for one in config.space}, **NO_SCORES}
    place.write_bytes(parquet(kind.table([whole])))
    assert kind.read(place)[0]["candidate"] == 0
    first = config.space[0]
    for name, value, reason in (
        (first.name, 2.0 * first.high, "the search is from"),
        (first.name, math.nan, "the search is from"),
        (next(iter(NO_SCORES)), 1e300, "which no run has"),
        (next(iter(NO_SCORES)), -math.inf, "which no run has"),
    ):
        place.write_bytes(parquet(kind.table([{**whole, name: value}])))
        with pytest.raises(Refusal, match=reason):
            kind.read(place)
