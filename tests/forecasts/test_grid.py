"""A record on the grid of forecasts: nothing is lost or seen early, and the basal rate tells of automation."""

import datetime as dt

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record, smoothed_day, usual_day
from glucoloop.records import DeviceRecord
from glucoloop.records.record import SCHEMA
from glucoloop.refusal import Refusal

FIRST = dt.datetime(2026, 3, 2)


def record(events, **constant):
    """A record of events ``(minute, column, value)``."""
    rows = [{"time": FIRST + dt.timedelta(minutes=float(t)), column: value} for t, column, value in events]
    frame = pl.DataFrame(rows, schema=dict(SCHEMA)).sort("time", maintain_order=True)
    frame = frame.with_columns(pl.lit(value).alias(name) for name, value in constant.items())
    return DeviceRecord(frame=frame.select(pl.col(n).cast(k) for n, k in SCHEMA.items()), rows=frame.height)


def readings(days, every_min=5.0):
    return [(t, "glucose_mg_dl", 120.0) for t in np.arange(0.0, days * 1440.0, every_min)]


@settings(max_examples=30, deadline=None)
@given(
    basal=st.lists(
        st.tuples(st.integers(1, 2800), st.floats(0.0, 5.0)), max_size=8, unique_by=lambda pair: pair[0] // 5
    ),
    boluses=st.lists(st.tuples(st.floats(0.0, 2870.0), st.floats(0.05, 20.0)), max_size=8),
    pen=st.lists(st.tuples(st.floats(0.0, 1430.0), st.floats(0.5, 40.0)), max_size=3),
)
def test_no_insulin_is_lost(basal, boluses, pen):
    at_samples = [(0.0, 1.0), *((5.0 * (t // 5 + 1), rate) for t, rate in sorted(basal))]
    events = [(t, "basal_U_h", rate) for t, rate in at_samples]
    events += [(t, "bolus_U", dose) for t, dose in boluses] + [(t, "long_acting_U", dose) for t, dose in pen]
    grid = gridded_record(record([*readings(2), *events]))
    ends = [*(t for t, _ in at_samples[1:]), 2880.0]
    of_rates = sum(rate * (end - begin) / 60.0 for (begin, rate), end in zip(at_samples, ends, strict=True))
    expected = of_rates + sum(dose for _, dose in [*boluses, *pen])
    assert grid.insulin_U.sum() == pytest.approx(expected, rel=1e-6)
    assert grid.total_daily_dose_U == pytest.approx(expected / 2.0, rel=1e-6)


def test_a_sample_holds_what_came_within_the_five_minutes_that_end_with_it():
    grid = gridded_record(
        record(
            [
                (0.0, "glucose_mg_dl", 100.0),
                (7.0, "glucose_mg_dl", 110.0),
                (9.9, "glucose_mg_dl", 111.0),
                (10.1, "glucose_mg_dl", 112.0),
                (12.0, "bolus_U", 2.0),
                (1439.0, "glucose_mg_dl", 90.0),
            ]
        )
    )
    assert grid.first == FIRST
    assert grid.days == 1
    assert grid.reading_mg_dl[:3].tolist() == [100.0, 111.0, 112.0]
    assert grid.user_bolus_U[2] == 2.0
    assert grid.reading_mg_dl[-1] == 90.0
    assert np.isfinite(grid.reading_mg_dl).sum() == 4


def test_a_bolus_is_of_whom_the_file_says():
    told = record([*readings(1), (600.0, "bolus_U", 3.0), (900.0, "bolus_U", 1.0)])
    kinds = pl.when(pl.col("bolus_U") == 3.0).then(pl.lit("manual")).when(pl.col("bolus_U") == 1.0)
    told = DeviceRecord(frame=told.frame.with_columns(bolus_type=kinds.then(pl.lit("automatic"))), rows=told.rows)
    grid = gridded_record(told)
    assert (grid.user_bolus_U.sum(), grid.automatic_bolus_U.sum()) == (3.0, 1.0)
    assert grid.automated


def test_a_bolus_over_a_time_is_given_over_it():
    extended = record([*readings(1), (600.0, "bolus_U", 3.0), (900.0, "bolus_U", 1.0)])
    minutes = pl.when(pl.col("bolus_U") == 3.0).then(30.0)
    extended = DeviceRecord(frame=extended.frame.with_columns(bolus_min=minutes), rows=extended.rows)
    given_U = gridded_record(extended).user_bolus_U
    assert given_U[120:126].tolist() == pytest.approx([0.5] * 6)
    assert given_U[179] == 1.0
    assert given_U.sum() == pytest.approx(4.0)


def test_the_last_days_are_used():
    grid = gridded_record(record(readings(5)), most_days=3)
    assert grid.days == grid.days_with_readings == 3
    assert grid.first == FIRST + dt.timedelta(days=2)
    assert grid.notes == ("The last 3 days were used.",)
    with pytest.raises(Refusal, match="no reading"):
        gridded_record(record([(0.0, "bolus_U", 1.0)]))


def test_a_reading_at_midnight_begins_no_day_of_its_own():
    grid = gridded_record(record([*readings(2), (2880.0, "glucose_mg_dl", 77.0)]))
    assert grid.days == 2
    assert grid.reading_mg_dl[-1] == 77.0
    assert gridded_record(record([(0.0, "glucose_mg_dl", 77.0)])).days == 1


def test_times_are_those_of_the_last_clock():
    events = [(60.0, "glucose_mg_dl", 100.0), (60.0, "bolus_U", 1.0)]
    shifted = record(events, utc_offset_min=60)
    later = DeviceRecord(
        frame=shifted.frame.with_columns(
            utc_offset_min=pl.when(pl.col("bolus_U").is_null()).then(0).otherwise(60).cast(pl.Int32)
        ).sort("utc_offset_min"),
        rows=2,
    )
    grid = gridded_record(later)
    assert np.flatnonzero(np.isfinite(grid.reading_mg_dl)).tolist() == [23]  # 01:00 in UTC is 02:00 by the last clock


def test_automation_is_told_by_a_basal_rate_that_leaves_its_schedule():
    random = np.random.default_rng(1)
    schedule = [(60.0 * h + 1440.0 * d, "basal_U_h", 0.5 + 0.1 * (h % 5)) for d in range(6) for h in range(24)]
    automatic = [(t, name, float(rate * random.uniform(0.2, 1.8))) for t, name, rate in schedule]
    boluses = [(1440.0 * d + 720.0, "bolus_U", 4.0) for d in range(6)]
    boluses += [(1440.0 * d + 900.0, "bolus_U", 1.0) for d in range(6)]
    meals = [(1440.0 * d + 705.0, "carbs_g", 40.0) for d in range(6)]
    by_hand = gridded_record(record([*readings(6), *schedule, *boluses, *meals]))
    assert not by_hand.automated
    assert by_hand.automatic_insulin_pct == 0.0
    assert by_hand.user_bolus_U.sum() == pytest.approx(30.0)
    looped = gridded_record(record([*readings(6), *automatic, *boluses, *meals]))
    assert looped.automated
    assert looped.user_bolus_U.sum() == pytest.approx(24.0)
    assert looped.automatic_bolus_U.sum() == pytest.approx(6.0)
    share = 100.0 * (looped.basal_U.sum() + 6.0) / looped.insulin_U.sum()
    assert looped.automatic_insulin_pct == pytest.approx(share)


def test_an_unknown_rate_is_the_usual_one_at_that_time_and_said():
    rates = [(720.0 * half, "basal_U_h", 1.0 if half % 2 else 0.5) for half in range(2, 8)]
    rates = [(t, name, np.nan if t == 1440.0 * 2 else rate) for t, name, rate in rates]
    grid = gridded_record(record([*readings(4), *rates]))
    by_half_day = grid.basal_U.reshape(8, -1).sum(axis=1)
    assert by_half_day.tolist() == pytest.approx([6.0, 12.0] * 4)
    assert grid.notes == ("The record tells no basal rate for 36 h; its median at that time of day was taken.",)


def test_the_usual_day_keeps_the_amounts():
    amounts = np.zeros(3 * SAMPLES_PER_DAY)
    amounts[[2, 500, 860]] = 5.0, 7.0, 9.0
    assert smoothed_day(amounts, 3, 120.0).sum() == pytest.approx(7.0)
    grid = gridded_record(record([*readings(3), (2.0, "carbs_g", 60.0), (0.0, "basal_U_h", 1.2)]))
    usual = usual_day(grid)
    assert usual.carbs_g.sum() == pytest.approx(20.0)
    assert usual.basal_U.sum() == pytest.approx(28.8)
    known = usual.future(grid, known=True)
    assert known.carbs_g[0] == 60.0
    assert usual.future(grid, known=False).carbs_g[0] < 2.0


def test_glucagon_of_the_days_used_is_told_and_no_other():
    doses = [(100.0, "glucagon_ug", 150.0), (1500.0, "glucagon_ug", 100.0), (1600.0, "glucagon_ug", 12.5)]
    note = "The record has {} of glucagon, {} ug in all, which no forecast and no twin knows"
    grid = gridded_record(record([*readings(2), *doses]))
    assert any(told.startswith(note.format("3 doses", 262.5)) for told in grid.notes)
    grid = gridded_record(record([*readings(2), *doses]), most_days=1)
    assert any(told.startswith(note.format("2 doses", 112.5)) for told in grid.notes)
    assert not any("glucagon" in told for told in gridded_record(record(readings(2))).notes)
