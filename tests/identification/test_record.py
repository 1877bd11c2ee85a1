"""People's own tables: what is mended is told, what is not is refused."""

import datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.identification import record_from_samples

TIMES = 5.0 * np.arange(145)
INSULIN = 20.0 + 5.0 * np.sin(TIMES / 40)
GLUCOSE = 100.0 + 30.0 * np.sin(TIMES / 70)


def test_a_clean_table_is_used_as_it_is():
    record, notes = record_from_samples(TIMES, INSULIN, GLUCOSE)
    np.testing.assert_array_equal(record.insulin_mU_min, INSULIN[:-1])
    np.testing.assert_array_equal(record.glucose_mg_dl, GLUCOSE)
    assert record.sample_time_min == 5.0
    assert notes == ()


def test_a_clock_that_starts_anywhere_gives_the_same_record():
    record, notes = record_from_samples(TIMES + 1234.567, list(INSULIN), tuple(GLUCOSE))
    np.testing.assert_array_equal(record.insulin_mU_min, INSULIN[:-1])
    np.testing.assert_allclose(record.glucose_mg_dl, GLUCOSE, atol=1e-9)
    assert notes == ()


@pytest.mark.parametrize("missing", [np.nan, None])
def test_missing_readings_are_interpolated_and_counted(missing):
    glucose = list(GLUCOSE)
    for row in (10, 40, 41):
        glucose[row] = missing
    record, notes = record_from_samples(TIMES, INSULIN, glucose)
    assert notes == ("3 of 145 samples were missing and were interpolated.",)
    assert record.glucose_mg_dl[10] == pytest.approx((GLUCOSE[9] + GLUCOSE[11]) / 2)
    np.testing.assert_allclose(record.glucose_mg_dl[40:42], np.interp([200, 205], [195, 210], GLUCOSE[[39, 42]]))
    np.testing.assert_array_equal(record.insulin_mU_min, INSULIN[:-1])


def test_a_masked_reading_is_a_missing_one():
    glucose = np.ma.masked_array(GLUCOSE, mask=np.arange(145) == 7)
    record, notes = record_from_samples(TIMES, INSULIN, glucose)
    assert notes == ("1 of 145 samples were missing and were interpolated.",)
    assert record.glucose_mg_dl[7] == pytest.approx((GLUCOSE[6] + GLUCOSE[8]) / 2)


def test_missing_rows_hold_the_insulin_of_the_row_before():
    keep = np.delete(np.arange(145), [20, 21])
    record, notes = record_from_samples(TIMES[keep], INSULIN[keep], GLUCOSE[keep])
    assert notes == ("2 of 145 samples were missing and were interpolated.",)
    np.testing.assert_array_equal(record.insulin_mU_min[19:23], INSULIN[[19, 19, 19, 22]])


def test_rows_every_minute_are_averaged_for_insulin_and_picked_for_glucose():
    minutes = np.arange(101.0)
    insulin = np.random.default_rng(0).uniform(0, 40, 101)
    record, notes = record_from_samples(minutes, insulin, 100 + minutes)
    np.testing.assert_allclose(record.insulin_mU_min, insulin[:-1].reshape(20, 5).mean(axis=1))
    np.testing.assert_allclose(record.glucose_mg_dl, 100 + minutes[::5])
    assert notes == ("Insulin changed within samples and was averaged over each.",)


def test_readings_every_fifteen_minutes_are_brought_to_five():
    record, notes = record_from_samples(TIMES[::3], INSULIN[::3], GLUCOSE[::3])
    np.testing.assert_array_equal(record.insulin_mU_min, np.repeat(INSULIN[::3][:-1], 3))
    np.testing.assert_allclose(record.glucose_mg_dl, np.interp(TIMES, TIMES[::3], GLUCOSE[::3]))
    assert notes == ("96 of 145 samples were missing and were interpolated.",)


def test_rows_without_a_reading_at_either_end_and_a_part_sample_are_left_out():
    times = np.r_[TIMES[:20], 97.0, 100.0]
    glucose = np.r_[np.nan, np.nan, GLUCOSE[2:20], 120.0, np.nan]
    record, notes = record_from_samples(times, np.r_[INSULIN[:20], 3.0, 4.0], glucose)
    np.testing.assert_array_equal(record.glucose_mg_dl, GLUCOSE[2:20])
    np.testing.assert_array_equal(record.insulin_mU_min, INSULIN[2:19])
    assert notes == (
        "3 of 22 rows come before the first reading or after the last: left out.",
        "The last 2 min do not fill a sample: left out.",
    )


@pytest.mark.long
@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(0.5, 14.5), min_size=3, max_size=60), st.integers(0, 1000))
def test_uneven_rows_keep_the_insulin_delivered_and_readings_on_a_line(gaps, seed):
    times = np.r_[0.0, np.cumsum(gaps)]
    insulin = np.random.default_rng(seed).uniform(0, 60, times.size)
    if times[-1] < 5:
        return
    record, notes = record_from_samples(times, insulin, 80 + 0.1 * times, allow_unusual=True)
    end = 5.0 * len(record.insulin_mU_min)
    assert times[-1] - 5 < end <= times[-1] + 1e-5
    delivered = sum(u * max(0.0, min(b, end) - a) for u, a, b in zip(insulin, times, times[1:], strict=False))
    assert float(record.insulin_mU_min.sum()) * 5.0 == pytest.approx(delivered, rel=1e-6)
    np.testing.assert_allclose(record.glucose_mg_dl, 80 + 0.1 * 5.0 * np.arange(len(record.glucose_mg_dl)), atol=1e-5)
    assert (np.asarray(record.insulin_mU_min) >= 0).all()
    assert all(note.endswith(".") for note in notes)


def test_readings_off_the_grid_are_told_with_their_distance():
    times = TIMES[:10].copy()
    times[4] += 0.5
    _, notes = record_from_samples(times, np.full(10, 20.0), GLUCOSE[:10])
    assert "1 of 10 samples had their reading up to 0.5 min away and were interpolated." in notes


def replaced(column, row, value):
    column = list(column)
    column[row] = value
    return column


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (
            {"t": replaced(TIMES, 3, 10.0)},
            "time in row 3 .counted from 0. is 10: it must be later than the row before; sort",
        ),
        ({"t": replaced(TIMES, 3, 9.0)}, "time in row 3 .counted from 0. is 9: it must be later"),
        (
            {"t": replaced(TIMES, 3, np.nan)},
            "time in row 3 .counted from 0. is missing: it must be a finite number of minutes",
        ),
        ({"t": replaced(TIMES, 3, "08:15")}, "time in row 3 .counted from 0. is '08:15': it must be a number"),
        ({"t": [datetime.datetime(2020, 1, 1)] * 145}, "time in row 0 .counted from 0. is datetime"),
        ({"t": np.arange(145).astype("datetime64[m]")}, "time column holds dates: .*minutes"),
        ({"t": TIMES[:-1]}, "144 times, 145 insulin rates and 145 readings do not pair up"),
        ({"t": TIMES.reshape(5, 29)}, r"time column has shape \(5, 29\)"),
        ({"u": replaced(INSULIN, 8, -1.0)}, "insulin rate in row 8 .counted from 0. is -1: it must be .* at least 0"),
        ({"u": replaced(INSULIN, 8, np.inf)}, "insulin rate in row 8 .counted from 0. is inf"),
        ({"u": replaced(INSULIN, 8, None)}, "insulin rate in row 8 .counted from 0. is missing: .*leave the row out"),
        ({"u": replaced(INSULIN, 8, 2j)}, "insulin in row 8 .counted from 0. is 2j: it must be a number"),
        (
            {"y": replaced(GLUCOSE, 9, 0.0)},
            "reading in row 9 .counted from 0. is 0: it must be above 0 and at most 2000",
        ),
        ({"y": replaced(GLUCOSE, 9, -4.0)}, "reading in row 9 .counted from 0. is -4"),
        ({"y": replaced(GLUCOSE, 9, 2001.0)}, "reading in row 9 .counted from 0. is 2001"),
        ({"y": replaced(GLUCOSE, 9, np.inf)}, "reading in row 9 .counted from 0. is inf"),
        ({"y": replaced(GLUCOSE, 9, "LOW")}, "glucose in row 9 .counted from 0. is 'LOW': .*NaN"),
        ({"y": GLUCOSE / 18.0}, "median of glucose_mg_dl is .* looks like mmol/l. Multiply the column by 18.02"),
        ({"y": np.full(145, np.nan)}, "reading: 0 of 145, which span 0 min"),
        ({"t": TIMES[:1], "u": INSULIN[:1], "y": GLUCOSE[:1]}, "reading: 1 of 1, .* At least 2 readings"),
        ({"t": [], "u": [], "y": []}, "reading: 0 of 0"),
        ({"t": [0.0, 4.0], "u": [1.0, 1.0], "y": [90.0, 90.0]}, "span 4 min.* one sample of 5 min apart"),
        ({"sample_time_min": 0.0}, "sample time is 0.0 min"),
        ({"max_gap_min": 4.0}, "longest gap is 4.0 min: it must be at least the sample time, 5 min"),
        ({"max_gap_min": np.nan}, "longest gap is nan"),
    ],
)
def test_bad_rows_are_refused_by_name(columns, sentence):
    columns = {"t": TIMES, "u": INSULIN, "y": GLUCOSE, **columns}
    with pytest.raises(ValueError, match=sentence):
        record_from_samples(columns.pop("t"), columns.pop("u"), columns.pop("y"), **columns)


BOLUSES = np.where(np.arange(145) % 40 == 3, 6.0, 0.0)


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (
            {"u": INSULIN * 0.06},
            r"values from 0.9 to 1.5, on average 1\.\d+ mU/min, .*looks like U/h. Multiply .* by 16.67",
        ),
        ({"u": INSULIN * 60.0}, "looks like mU/h. Multiply the column by 0.01667"),
        ({"u": BOLUSES}, "looks like boluses in U, each over the 5 min of its row. Multiply the column by 200"),
        ({"u": INSULIN * 1e-5}, "usual is from 4 to 500 mU/min"),
        ({"t": TIMES / 60.0}, "rows of t_min are 0.0833 min apart as a rule; that looks like h. Multiply .* by 60"),
        ({"t": TIMES * 60.0, "max_gap_min": 900.0}, "300 min apart as a rule; that looks like s"),
        ({"t": TIMES / 1440.0}, "looks like days. Multiply the column by 1440"),
        ({"y": GLUCOSE / 18.0}, "looks like mmol/l"),
    ],
)
def test_a_column_in_another_unit_is_asked_about_and_taken_if_it_is_meant(columns, sentence):
    columns = {"t": TIMES, "u": INSULIN, "y": GLUCOSE, "max_gap_min": 15.0, "sample_time_min": 5.0, **columns}
    table, gap = [columns[name] for name in ("t", "u", "y")], columns["max_gap_min"]
    with pytest.raises(ValueError, match=f"(?s){sentence}.*, or pass allow_unusual=True"):
        record_from_samples(*table, max_gap_min=gap)
    finer = {"sample_time_min": 0.05} if columns["t"][-1] < 60 else {}
    record, _ = record_from_samples(*table, max_gap_min=gap, allow_unusual=True, **finer)
    assert record.glucose_mg_dl.shape[0] > 1


def test_a_basal_rate_with_pauses_and_no_insulin_at_all_are_not_asked_about():
    record_from_samples(TIMES, np.where(np.arange(145) % 3 == 0, 20.0, 0.0), GLUCOSE)
    record_from_samples(TIMES, np.zeros(145), GLUCOSE)


def test_meals_are_added_up_over_each_sample():
    carbs = np.full(145, np.nan)
    carbs[[0, 20, 144]] = [10.0, 50.0, 7.0]  # no reading follows the last row
    record, _ = record_from_samples(TIMES, INSULIN, GLUCOSE, carbs)
    np.testing.assert_array_equal(np.flatnonzero(record.carbs_g), [0, 20])
    assert float(record.carbs_g[20]) == 50.0
    longer, _ = record_from_samples(TIMES, INSULIN, GLUCOSE, carbs, sample_time_min=15.0)
    np.testing.assert_array_equal(np.flatnonzero(longer.carbs_g), [0, 6])
    assert record_from_samples(TIMES, INSULIN, GLUCOSE)[0].carbs_g is None


@pytest.mark.parametrize(
    ("carbs", "sentence"),
    [
        (np.full(145, -1.0), "carbohydrate in row 0 .counted from 0. is -1: it must be from 0 to 1000 g"),
        (np.full(145, np.inf), "carbohydrate in row 0 .counted from 0. is inf"),
        (["lunch"] * 145, "carbohydrate in row 0 .counted from 0. is 'lunch': it must be a number"),
        (np.zeros(3), "3 amounts of carbohydrate and 145 times do not pair up"),
    ],
)
def test_bad_meals_are_refused(carbs, sentence):
    with pytest.raises(ValueError, match=sentence):
        record_from_samples(TIMES, INSULIN, GLUCOSE, carbs)


@pytest.mark.parametrize("drop_rows", [True, False])
def test_a_gap_longer_than_the_bound_is_refused_and_a_higher_bound_bridges_it(drop_rows):
    lost = np.arange(50, 53)
    if drop_rows:
        columns = [np.delete(c, lost) for c in (TIMES, INSULIN, GLUCOSE)]
    else:
        columns = [TIMES, INSULIN, np.where(np.isin(np.arange(145), lost), np.nan, GLUCOSE)]
    with pytest.raises(ValueError, match=r"between 245 and 265 min: the gap of 20 min is longer than 15 min\..*raise"):
        record_from_samples(*columns)
    _, notes = record_from_samples(*columns, max_gap_min=20.0)
    assert notes == ("3 of 145 samples were missing and were interpolated.",)
