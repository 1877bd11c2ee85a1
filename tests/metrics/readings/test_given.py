"""Insulin and carbohydrate of whole days: sums by hand, what is not told, and rates beside their integral."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from glucoloop.metrics.readings import Readings
from glucoloop.metrics.readings.given import Amounts, Given, day_sums, given_numbers, known_results, whole_days

DAY = 1440.0


def amounts(*pairs):
    return Amounts(*np.array(pairs, float).reshape(-1, 2).T)


def readings(first_min, last_min, step_min=5.0):
    t = np.arange(first_min, last_min + step_min, step_min)
    return Readings.of(t, np.full(t.size, 120.0))


def test_sums_of_days_by_hand():
    record = Given(
        basal_U_h=amounts((-60.0, 1.0), (720.0, 2.0), (DAY + 600.0, math.nan), (DAY + 660.0, 0.5)),
        bolus_U=amounts((480.0, 4.0), (481.0, 1.0), (3.0 * DAY - 1.0, 2.0)),
        carbs_g=amounts((DAY, 30.0), (DAY + 1.0, 10.0)),
    )
    days = day_sums(record, range(4))
    assert days[0]["basal_U"] == pytest.approx(12.0 + 24.0)
    assert days[1]["basal_U"] == pytest.approx(20.0 + 0.5 * 13.0)  # an hour is not known
    assert [days[day]["bolus_U"] for day in range(3)] == [5.0, 0.0, 2.0]
    assert [days[day]["boluses"] for day in range(3)] == [2.0, 0.0, 1.0]
    assert days[1]["carbs_g"] == 40.0
    assert days[0]["insulin_U"] == pytest.approx(41.0)
    assert all(math.isnan(days[day]["carbs_g"]) for day in (0, 2, 3))
    assert math.isnan(days[3]["bolus_U"])  # after the day of the last bolus
    numbers = given_numbers(record, readings(0.0, 4.0 * DAY))
    assert numbers["insulin_U_day"] == pytest.approx((41.0 + 26.5 + 14.0) / 3.0)
    assert numbers["basal_pct"] == pytest.approx(100.0 * (36.0 + 26.5 + 12.0) / 81.5)
    assert numbers["boluses_day"] == 1.0
    assert numbers["carb_entries_day"] == 2.0


def test_a_day_with_more_than_an_hour_without_a_rate_is_not_known():
    rates = amounts((0.0, 1.0), (300.0, math.nan), (361.0, 1.0))
    record = Given(basal_U_h=rates, bolus_U=amounts((1.0, 1.0), (DAY + 1.0, 1.0)))
    assert math.isnan(day_sums(record, [0])[0]["insulin_U"])
    assert day_sums(record, [1])[1]["basal_U"] == pytest.approx(24.0)
    begun_late = Given(basal_U_h=amounts((61.0, 1.0)))
    assert math.isnan(day_sums(begun_late, [0])[0]["basal_U"])


def test_the_last_rate_holds_to_the_end_of_the_day_of_the_last_dose():
    rates = amounts((0.0, 1.0))
    for last_bolus_min, known in ((600.0, 1), (DAY + 600.0, 2)):
        days = day_sums(Given(basal_U_h=rates, bolus_U=amounts((1.0, 1.0), (last_bolus_min, 1.0))), range(4))
        assert [math.isfinite(days[day]["basal_U"]) for day in range(4)] == [day < known for day in range(4)]
    assert day_sums(Given(basal_U_h=rates, complete=True), [3])[3]["basal_U"] == pytest.approx(24.0)


def test_all_insulin_without_what_of_it_is_basal():
    rates = Given(insulin_U_h=amounts(*((60.0 * hour, 1.5) for hour in range(24))))
    numbers = given_numbers(rates, readings(0.0, DAY))
    assert numbers["insulin_U_day"] == pytest.approx(36.0)
    assert [result.name for result in known_results([numbers])] == ["insulin_U_day"]


def test_pens_have_the_basal_insulin_that_was_injected():
    record = Given(long_acting_U=amounts((1300.0, 18.0), (2.0 * DAY + 1300.0, 20.0)), bolus_U=amounts((600.0, 5.0)))
    days = day_sums(record, range(3))
    assert [days[day]["basal_U"] for day in range(3)] == [18.0, 0.0, 20.0]
    assert days[0]["insulin_U"] == 23.0
    assert math.isnan(days[1]["insulin_U"])


def test_in_a_simulation_what_is_not_told_did_not_happen():
    record = Given(basal_U_h=amounts((0.0, 1.0)), carbs_g=amounts((DAY + 480.0, 50.0)), complete=True)
    days = day_sums(record, range(2))
    assert days[0]["insulin_U"] == pytest.approx(24.0)
    assert (days[0]["boluses"], days[0]["carbs_g"], days[1]["carbs_g"]) == (0.0, 0.0, 50.0)
    assert given_numbers(record, readings(0.0, 2.0 * DAY))["basal_pct"] == pytest.approx(100.0)


def test_of_two_rates_at_one_time_the_last_one_holds():
    record = Given(basal_U_h=amounts((0.0, 1.0), (60.0, 9.0), (60.0, 2.0)))
    assert day_sums(record, [0])[0]["basal_U"] == pytest.approx(1.0 + 46.0)


def test_whole_days():
    assert whole_days(readings(0.0, DAY - 5.0)) == [0]
    assert whole_days(readings(60.0, DAY - 60.0)) == [0]
    assert whole_days(readings(65.0, 2.0 * DAY)) == [1]
    assert whole_days(readings(65.0, DAY + 1000.0)) == []
    assert whole_days(readings(-DAY, 2.0 * DAY - 65.0)) == [-1, 0]


def test_nothing_is_known_of_a_record_of_readings_alone():
    numbers = given_numbers(Given(), readings(0.0, 3.0 * DAY))
    assert known_results([numbers]) == []
    of_another = given_numbers(Given(carbs_g=amounts((1.0, 10.0))), readings(0.0, DAY))
    assert [one.name for one in known_results([numbers, of_another])] == ["carbs_g_day", "carb_entries_day"]


@given(
    st.lists(
        st.tuples(st.floats(-2000.0, 4000.0), st.floats(0.0, 35.0)),
        min_size=1,
        max_size=8,
        unique_by=lambda rate: rate[0],
    ),
    st.integers(0, 3),
)
@settings(deadline=None)
def test_basal_insulin_is_the_integral_of_its_rate(rates, day):
    rates = sorted(rates)
    begins = np.array([t for t, _ in rates])
    of_pump = Given(basal_U_h=amounts(*rates), bolus_U=amounts((3.0 * DAY, 1.0)))
    basal_U = day_sums(of_pump, [day])[day]["basal_U"]
    unknown_min = max(0.0, begins[0] - DAY * day)
    if unknown_min > 60.0:
        assert math.isnan(basal_U)
        return

    def rate_U_h(t_min):
        place = int(np.searchsorted(begins, t_min, side="right")) - 1
        return rates[place][1] if place >= 0 else 0.0

    edges = [DAY * day, *(t for t in begins if DAY * day < t < DAY * (day + 1)), DAY * (day + 1)]
    pieces = itertools.pairwise(edges)
    expected = sum(quad(rate_U_h, low, high)[0] for low, high in pieces) / 60.0
    assert basal_U == pytest.approx(expected, abs=1e-6)
