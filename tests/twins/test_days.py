"""Days of a record as a simulation takes them: nothing is lost, and what is missing is said."""

import datetime as dt

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.records import DeviceRecord
from glucoloop.records.record import SCHEMA
from glucoloop.refusal import Refusal
from glucoloop.twins import recorded_days

FIRST = dt.datetime(2026, 3, 2, 6, 30)


def record(*events, days=2.0, every_min=5.0, **constant):
    """Readings of 120 mg/dl with events ``(minute, column, value)``."""
    times = np.arange(0.0, days * 1440.0, every_min)
    rows = [(t, "glucose_mg_dl", 120.0) for t in times] + list(events)
    frame = pl.DataFrame(
        [{"time": FIRST + dt.timedelta(minutes=float(t)), column: value} for t, column, value in rows],
        schema={name: kind for name, kind in SCHEMA.items()},
    ).sort("time")
    frame = frame.with_columns(*(pl.lit(value).alias(name) for name, value in constant.items()))
    return DeviceRecord(frame=frame.select(pl.col(n).cast(k) for n, k in SCHEMA.items()), rows=frame.height)


MEALS = [(60.0 * hour, "carbs_g", 50.0) for hour in (2, 7, 12)]
DOSES = [(0.0, "basal_U_h", 0.9), (120.0, "bolus_U", 5.0)]


@settings(max_examples=30, deadline=None)
@given(
    basal=st.lists(st.tuples(st.floats(0.0, 2800.0), st.floats(0.0, 5.0)), min_size=1, max_size=8),
    boluses=st.lists(st.tuples(st.floats(0.0, 2800.0), st.floats(0.05, 20.0)), min_size=1, max_size=8),
)
def test_no_insulin_is_lost(basal, boluses):
    events = [(0.0, "basal_U_h", 1.0), *((t, "basal_U_h", rate) for t, rate in basal)]
    events += [(t, "bolus_U", dose) for t, dose in boluses]
    days = recorded_days(record(*MEALS, *events))
    steps = sorted({round(t, 5): rate for t, _, rate in events[: len(basal) + 1]}.items())
    ends = [*(t for t, _ in steps[1:]), days.insulin_mU_min.size * 5.0]
    # a time is kept to a microsecond, and of rates at one time the last one counts
    given_U = sum(rate * (end - t) / 60.0 for (t, rate), end in zip(steps, ends, strict=True))
    if len(steps) == len(events[: len(basal) + 1]):
        total = days.insulin_mU_min.sum() * 5.0 / 1000.0
        assert total == pytest.approx(given_U + sum(dose for _, dose in boluses), rel=1e-5)


def test_what_the_record_says_of_the_therapy():
    days = recorded_days(record(*MEALS, *DOSES))
    assert days.clock_min == 390.0
    assert days.meals == 3
    assert days.carb_ratio_g_U == pytest.approx(30.0)
    assert days.total_daily_dose_U == pytest.approx(0.9 * 24.0 + 2.5, rel=0.01)
    assert days.notes == ()


def test_only_what_follows_a_long_gap_is_used():
    early = [(-3.0 * 1440.0 + 5.0 * k, "glucose_mg_dl", 150.0) for k in range(200)]
    days = recorded_days(record(*MEALS, *DOSES, *early))
    assert days.first == FIRST
    assert "no readings for 55 h before it" in days.notes[0]


def test_unknown_basal_rates_are_told_and_filled():
    unknown = (600.0, "basal_U_h", float("nan")), (900.0, "basal_U_h", 0.9)
    days = recorded_days(record(*MEALS, *DOSES, *unknown))
    assert "no basal rate for 5 h; 0.90 U/h were taken" in days.notes[0]
    assert days.insulin_mU_min[150] == pytest.approx(15.0)


@pytest.mark.parametrize(
    ("given", "more", "sentence"),
    [
        ([*DOSES], {}, "0 meals"),
        ([*MEALS, (120.0, "bolus_U", 5.0)], {}, "no basal rate; give it with --basal"),
        ([*MEALS, (0.0, "basal_U_h", 0.9)], {}, "neither boluses nor a basal rate that changes"),
        ([*MEALS, *DOSES], {"every_min": 60.0}, "a twin needs 100 or more"),
    ],
)
def test_a_record_that_is_not_enough_is_refused(given, more, sentence):
    with pytest.raises(Refusal, match=sentence):
        recorded_days(record(*given, **more))


def test_a_basal_rate_may_be_given():
    days = recorded_days(record(*MEALS, (120.0, "bolus_U", 5.0)), basal_U_h=0.6)
    assert days.insulin_mU_min[0] == pytest.approx(10.0)


def test_a_bolus_over_a_time_is_given_over_it():
    at_once = recorded_days(record(*MEALS, *DOSES))
    frame = record(*MEALS, *DOSES).frame.with_columns(
        bolus_min=pl.when(pl.col("bolus_U").is_not_null()).then(pl.lit(62.5))
    )
    days = recorded_days(DeviceRecord(frame=frame, rows=frame.height))
    given = 5.0 * (days.insulin_mU_min - 0.9 * 1000.0 / 60.0) / 1000.0
    assert given[24:37] == pytest.approx([0.4] * 12 + [0.2])
    assert given.sum() == pytest.approx(5.0)
    assert (days.bolus_U, days.basal_U) == pytest.approx((5.0, at_once.basal_U))


def test_long_acting_insulin_is_the_basal_rate_where_there_is_no_other():
    pens = [(60.0 + 1440.0 * day, "long_acting_U", 24.0) for day in range(2)]
    days = recorded_days(record(*MEALS, (120.0, "bolus_U", 5.0), *pens))
    rate = days.insulin_mU_min.copy()
    rate[24] -= 1000.0
    assert rate == pytest.approx(np.full(rate.size, 1000.0 / 60.0))
    assert "2 doses of long-acting insulin stand for the basal rate" in " ".join(days.notes)


def test_long_acting_insulin_beside_a_basal_rate_is_named():
    days = recorded_days(record(*MEALS, *DOSES, (60.0, "long_acting_U", 24.0)))
    assert days.basal_U == pytest.approx(recorded_days(record(*MEALS, *DOSES)).basal_U)
    assert "1 dose of long-acting insulin, 24 U, did not count beside the basal rate." in days.notes
