"""Metrics of a record in closed form, and what holds for any readings."""

import datetime as dt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.metrics.formulas import gmi_pct
from glucoloop.metrics.readings.catalogue import MEASURES, numbers_of
from glucoloop.metrics.readings.distribution import gri_zone
from glucoloop.metrics.readings.excursions import amplitude, turning_points
from glucoloop.metrics.readings.profile import by_day, by_time_of_day, day_profile, percentiles
from glucoloop.metrics.readings.series import Readings
from glucoloop.refusal import Refusal
from monitor_records import on_edges, with_gaps


@st.composite
def records(draw):
    """Readings at any times of some days, 20 to 600 mg/dl."""
    t_min = draw(st.lists(st.integers(0, 5000), min_size=2, max_size=120, unique=True))
    glucose = draw(st.lists(st.floats(20.0, 600.0), min_size=len(t_min), max_size=len(t_min)))
    return Readings.of(t_min, glucose)


@given(records())
def test_what_holds_for_any_readings(readings):
    of = numbers_of(readings)
    assert list(of) == [result.name for measure in MEASURES for result in measure.results]
    assert of["time_below_70_pct"] + of["time_70_180_pct"] + of["time_above_180_pct"] == pytest.approx(100.0)
    assert of["time_below_54_pct"] + of["time_54_70_pct"] == pytest.approx(of["time_below_70_pct"])
    assert of["time_180_250_pct"] + of["time_above_250_pct"] == pytest.approx(of["time_above_180_pct"])
    assert of["time_below_63_pct"] + of["time_63_140_pct"] + of["time_above_140_pct"] == pytest.approx(100.0)
    assert 0.0 < of["active_pct"] <= 100.0
    assert 0.0 <= of["gri"] <= 100.0
    assert of["bgri"] == of["lbgi"] + of["hbgi"]
    assert of["very_low_events"] == 0 or of["low_events"] > 0
    assert max(of["extended_low_events"], of["nocturnal_low_events"]) <= of["low_events"]
    assert all(np.isnan(value) or value >= 0.0 for value in of.values())


@given(records(), st.randoms(use_true_random=False))
def test_the_order_of_the_rows_means_nothing(readings, random):
    order = list(range(readings.t_min.size))
    random.shuffle(order)
    again = Readings.of(readings.t_min[order], readings.glucose_mg_dl[order])
    assert numbers_of(again) == pytest.approx(numbers_of(readings), nan_ok=True)


def test_a_reading_at_each_bound_is_in_the_range_that_it_ends():
    of = numbers_of(Readings.of(5.0 * np.arange(4), [54.0, 70.0, 180.0, 250.0]))
    assert (of["time_below_54_pct"], of["time_54_70_pct"], of["time_70_180_pct"]) == (0.0, 25.0, 50.0)
    assert (of["time_180_250_pct"], of["time_above_250_pct"]) == (25.0, 0.0)


def test_days_that_repeat_have_no_difference_from_day_to_day():
    t_min = 5.0 * np.arange(288 * 5)
    of = numbers_of(Readings.of(t_min, 130.0 - 50.0 * np.cos(2.0 * np.pi * t_min / 1440.0)))
    assert of["modd_mg_dl"] == pytest.approx(0.0, abs=1e-9)
    assert of["conga_24h_mg_dl"] == pytest.approx(0.0, abs=1e-9)
    # SD of the difference of a sine and the same sine 1 h later, of whole days
    assert of["conga_1h_mg_dl"] == pytest.approx(50.0 * np.sqrt(2.0) * np.sin(np.pi / 24.0), rel=2e-2)
    assert of["mean_mg_dl"] == pytest.approx(130.0)
    assert of["mage_mg_dl"] == pytest.approx(100.0, rel=0.01)
    assert of["gmi_pct"] == gmi_pct(of["mean_mg_dl"])


def test_swings_of_one_standard_deviation_or_less_are_passed_over():
    values = [100.0, 160.0, 150.0, 200.0, 190.0, 195.0, 90.0, 100.0]
    assert turning_points(np.array(values), 20.0).tolist() == [100.0, 200.0, 90.0]
    assert np.isnan(amplitude(Readings.of(5.0 * np.arange(100), np.full(100, 120.0)))["mage_mg_dl"])


def test_zones_of_the_glycemia_risk_index():
    assert [gri_zone(of) for of in (0.0, 20.0, 20.1, 40.0, 60.0, 80.0, 80.1, 100.0)] == list("AABBCDEE")


def test_sufficiency_counts_what_is_missing():
    t_min, glucose = on_edges(14, 5)
    of = numbers_of(Readings.of(t_min, glucose))
    assert (of["days"], of["active_pct"], of["readings"]) == (14.0, 100.0, 4032.0)
    half = np.arange(t_min.size) % 4 < 2
    assert numbers_of(Readings.of(t_min[half], glucose[half]))["active_pct"] == pytest.approx(50.0, abs=0.1)


def test_percentiles_are_those_of_numpy_near_a_time_of_day():
    t_min, glucose = with_gaps(14, 7)
    profile = day_profile(Readings.of(t_min, glucose))
    for place in (0, 1, 37, 95, 96):
        distance = np.abs((t_min - profile.t_min[place] + 720.0) % 1440.0 - 720.0)
        before = (t_min - profile.t_min[place]) % 1440.0 == 15.0  # the end of the time belongs to the next
        near = glucose[(distance <= 15.0) & ~before]
        assert near.size == profile.readings[place]
        for percentage, values in profile.percentiles_mg_dl.items():
            assert values[place] == np.percentile(near, percentage)
    assert all(values[0] == values[-1] for values in profile.percentiles_mg_dl.values())


def test_days_and_parts_of_the_day_make_the_whole():
    readings = Readings.of(*with_gaps(5, 8))
    whole = numbers_of(readings)
    days = [of for _, of in by_day(readings)]
    assert sum(of["readings"] for of in days) == whole["readings"]
    weighted = sum(of["readings"] * of["time_70_180_pct"] for of in days) / whole["readings"]
    assert weighted == pytest.approx(whole["time_70_180_pct"])
    assert [name for name, _ in by_time_of_day(readings)] == ["0 to 6 h", "6 to 12 h", "12 to 18 h", "18 to 24 h"]


def test_dates_of_a_table():
    times = np.array(["2025-01-06T23:55", "2025-01-07T00:00", "2025-01-07T00:05"], "datetime64[us]")
    readings = Readings.of_times(times, [100.0, np.nan, 110.0])
    assert readings.day_0 == dt.date(2025, 1, 6)
    assert readings.t_min.tolist() == [1435.0, 1445.0]
    assert [readings.date(int(day)) for day in readings.day] == ["2025-01-06", "2025-01-07"]
    assert readings.moment(1445.0) == "2025-01-07 00:05"


def test_equal_times_are_averaged():
    assert Readings.of([0.0, 5.0, 5.0], [100.0, 110.0, 120.0]).glucose_mg_dl.tolist() == [100.0, 115.0]


@pytest.mark.parametrize(
    ("t_min", "glucose", "sentence"),
    [
        ([], [], "14 days with 70 %"),
        ([0.0, 5.0], [100.0, np.nan], "has 1 reading of"),
        ([0.0, 5.0], [100.0, 0.0], "0 mg/dl is not possible"),
        ([0.0, 1e9], [100.0, 100.0], "century"),
        ([0.0, 5.0], [100.0], "do not match"),
    ],
)
def test_readings_that_cannot_be_used_are_refused(t_min, glucose, sentence):
    with pytest.raises(Refusal, match=sentence):
        Readings.of(t_min, glucose)


@pytest.mark.long
def test_a_million_readings_take_seconds():
    """All metrics, and the profile; measured 1 s, and the aim is 5 s with the page."""
    import time

    rng = np.random.default_rng(1)
    t_min = 5.0 * np.arange(1_000_000)
    glucose = np.clip(150.0 + 60.0 * np.sin(t_min / 120.0) + 15.0 * rng.normal(size=t_min.size), 40.0, 400.0)
    begun = time.process_time()
    readings = Readings.of(t_min, glucose)
    numbers_of(readings)
    day_profile(readings)
    assert time.process_time() - begun < 5.0


def test_each_reading_counts_for_its_time():
    """A week every 15 min and a week every 5 min weigh alike, as their means over the time do."""
    slow, quick = 15.0 * np.arange(672), 672 * 15.0 + 5.0 * np.arange(2016)
    glucose = np.concatenate([np.tile([240.0, 260.0], 336), np.tile([110.0, 120.0, 130.0], 672)])
    readings = Readings.of(np.concatenate([slow, quick]), glucose)
    of = numbers_of(readings)
    assert (of["time_above_180_pct"], of["active_pct"]) == (pytest.approx(50.0), 100.0)
    assert (of["mean_mg_dl"], of["gmi_pct"]) == (pytest.approx(185.0), pytest.approx(gmi_pct(185.0)))
    variance = np.mean([240.0**2, 260.0**2]) / 2.0 + np.mean([110.0**2, 120.0**2, 130.0**2]) / 2.0 - 185.0**2
    assert of["sd_mg_dl"] == pytest.approx(np.sqrt(variance), rel=1e-3)
    assert numbers_of(readings.by_count)["time_above_180_pct"] == 25.0
    profile = day_profile(readings)
    assert np.all((profile.percentiles_mg_dl[50] > 120.0) & (profile.percentiles_mg_dl[50] < 250.0))
    active = [day["active_pct"] for _, day in by_day(readings)]
    assert active == pytest.approx([100.0] * 14)


@pytest.mark.parametrize("interval_min", [1.0, 5.0, 15.0])
@pytest.mark.parametrize("seed", range(8))
def test_readings_at_equal_steps_count_alike_whatever_is_missing(interval_min, seed):
    t_min, glucose = with_gaps(7, seed, interval_min)
    late = np.random.default_rng(seed).uniform(0.0, 0.1 * interval_min, t_min.size)
    for times in (t_min, t_min + late):
        assert Readings.of(times, glucose).weight_min is None


def test_percentiles_with_weights_are_those_of_repeated_values():
    rng = np.random.default_rng(3)
    values, weights = rng.normal(120.0, 30.0, 4000), rng.choice([5.0, 15.0], 4000)
    repeated = np.repeat(values, (weights / 5.0).astype(int))
    assert percentiles(values, weights) == pytest.approx(np.percentile(repeated, [5, 25, 50, 75, 95]), abs=0.2)
    assert percentiles(values, np.full(4000, 5.0)).tolist() == np.percentile(values, [5, 25, 50, 75, 95]).tolist()


def test_a_clock_that_is_set_moves_times_of_day_and_no_durations():
    wall = np.datetime64("2024-10-26T00:00") + np.arange(0, 48 * 60, 5).astype("timedelta64[m]")
    night = wall >= np.datetime64("2024-10-27T03:00")
    shown = np.where(night, wall - np.timedelta64(60, "m"), wall)
    readings = Readings.of_times(shown, np.full(wall.size, 100.0), np.where(night, 60, 120))
    assert readings.t_min.size == wall.size
    assert np.all(np.diff(readings.t_min) == 5.0)
    assert readings.time_of_day_min[-1] == 22 * 60 + 55
    assert readings.moment(readings.t_min[-1]) == "2024-10-27 22:55"
