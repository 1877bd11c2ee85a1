"""Order of day and month, time zones, the repeated and the missing hour, gaps and repeated rows."""

import json
from datetime import datetime, timedelta

import polars as pl
import pytest

import glucoloop as gl
from device_files import START, clarity, every, glucose, libre, nightscout_entries
from naming import naming
from record_values import reading_times


def test_dates_that_fit_both_orders_are_asked_about(read, refused):
    start = datetime(2024, 3, 4, 0, 3)
    text = libre(20, start=start)
    assert refused(text) == (
        "its dates fit both orders, for no day is above 12; say which is meant with dates=day-first or "
        "dates=month-first (--dates)"
    )
    assert read(text, dates="day-first").frame["time"][0] == start
    assert read(text, dates="month-first").frame["time"][0] == datetime(2024, 4, 3, 0, 3)


def readings_of(record):
    return record.frame.select("time", "glucose_mg_dl").rows()


@pytest.mark.parametrize("order", ["%d-%m-%Y", "%m-%d-%Y", "%d.%m.%Y", "%m/%d/%Y", "%Y-%m-%d", "%Y/%m/%d"])
def test_dates_that_fit_one_order_are_read_in_it(read, order):
    record = read(libre(200, order=order))
    assert record.frame["time"].to_list() == every(15, 200)


def test_a_year_of_two_digits_stands_where_dates_lie_close_together(read, refused):
    for order in ("%y-%m-%d", "%y/%m/%d", "%d-%m-%y", "%m/%d/%y", "%d.%m.%y"):
        with naming(order):
            assert read(libre(200, order=order)).frame["time"].to_list() == every(15, 200)
    start = datetime(2012, 10, 10, 0, 3)
    for order, name in (("%y-%m-%d", "year-first"), ("%d-%m-%y", "day-first")):
        with naming(order):
            text = libre(20, order=order, start=start)
            assert "which could be the first or the last number" in refused(text)
            assert read(text, dates=name).frame["time"][0] == start
    assert "its dates have the year last" in refused(libre(20, order="%d-%m-%Y"), dates="year-first")


def test_a_clock_of_twelve_hours_without_its_half_is_refused(read, refused):
    message = "its times are of a clock of 12 hours without AM or PM: none is before 01:00"
    for days, newest_first in ((1, False), (1, True), (3, False), (3, True)):
        for form, half in (("%Y-%m-%d %I:%M:%S", ""), ("%m/%d/%Y %I:%M", ""), ("%Y-%m-%d %I:%M", " %p")):
            times = every(5, 288 * days, datetime(2024, 3, 13))
            rows = [f"{time:{form}{half}},{glucose(n)}" for n, time in enumerate(times)]
            text = "\n".join(["time,glucose_mg_dl", *(rows[::-1] if newest_first else rows)])
            with naming(f"{days} days, {form}{half}"):
                if half:
                    assert read(text).frame["time"].to_list() == times
                else:
                    assert refused(text).startswith(message)


def test_a_morning_alone_is_no_clock_of_twelve_hours(read):
    times = [time for time in every(5, 600, datetime(2024, 3, 13)) if 1 <= time.hour <= 12]
    rows = [f"{time:%Y-%m-%d %H:%M},{glucose(n)}" for n, time in enumerate(times)]
    for text in (rows, rows[::-1]):
        assert read("\n".join(["time,glucose_mg_dl", *text])).frame["time"].to_list() == times


def test_dates_in_both_orders_are_refused(refused):
    text = libre(3) + "\n".join(libre(3, order="%m-%d-%Y").splitlines()[2:])
    assert refused(text).startswith("3 of its dates have the day first and 3 the month first; divide the file")


def test_a_wrong_order_leaves_the_rows_out_by_name(read):
    text = libre(3, start=datetime(2024, 3, 4)) + "\n".join(libre(3).splitlines()[2:])
    record = read(text, dates="month-first")
    assert record.left_out == {"rows without a readable time": 3}


@pytest.mark.parametrize(
    ("text", "time"),
    [
        ("03/13/2024 1:05 PM", datetime(2024, 3, 13, 13, 5)),
        ("03/13/2024 12:05 AM", datetime(2024, 3, 13, 0, 5)),
        ("13-Mar-2024 07:08:09", datetime(2024, 3, 13, 7, 8, 9)),
        ("13.03.24 07:08", datetime(2024, 3, 13, 7, 8)),
        ("2024-03-13T07:08:09.250", datetime(2024, 3, 13, 7, 8, 9, 250000)),
        ("20240313 07:08", datetime(2024, 3, 13, 7, 8)),
        ("20240313T070809", datetime(2024, 3, 13, 7, 8, 9)),
        ("2024-03-13T070809", datetime(2024, 3, 13, 7, 8, 9)),
        ("March 13, 2024 7:08 PM", datetime(2024, 3, 13, 19, 8)),
        ("13 September 2024 07:08", datetime(2024, 9, 13, 7, 8)),
        ("Mittwoch, 13.03.2024 07:08 Uhr", datetime(2024, 3, 13, 7, 8)),
        ("13. 3. 2024 7.08", datetime(2024, 3, 13, 7, 8)),
        ("13/03/2024 07h08", datetime(2024, 3, 13, 7, 8)),
        ("2024. 03. 13. 07:08", datetime(2024, 3, 13, 7, 8)),
        ("2024年3月13日 07:08", datetime(2024, 3, 13, 7, 8)),
        ("2024-03-13 07:08:09 UTC", datetime(2024, 3, 13, 7, 8, 9)),
        ("2024-03-13 07:08:09+00", datetime(2024, 3, 13, 7, 8, 9)),
        ("2024-03-13 07:08 GMT+1", datetime(2024, 3, 13, 6, 8)),
        ("2024-03-13 07:08:09-0530", datetime(2024, 3, 13, 12, 38, 9)),
        ("2024-03-13 07:60", None),
        ("2024-02-30T07:08:09", None),
        ("2024-13-01T07:08:09", None),
        ("2024-03-13", None),
        ("13.03.2024 24:00", None),
    ],
)
def test_one_time(text, time):
    from glucoloop.records.answers import Answers
    from glucoloop.records.times import times_of

    told, _ = times_of(pl.Series([text]), Answers())
    assert told["time"].to_list() == [time]


AUTUMN = datetime(2024, 10, 27, 0, 3)
"""Night in which clocks in Europe go from 3:00 back to 2:00, written as instants in UTC + 2 h."""


def autumn(newest_first=False):
    """Clarity over the night, with the times that a clock on the wall shows."""
    lines = clarity(60, start=AUTUMN).splitlines()
    told = lines[:5]
    for number, line in enumerate(lines[5:]):
        time = AUTUMN + timedelta(minutes=5 * number)
        shown = time - timedelta(hours=time.hour >= 3)
        told.append(line.replace(f"{time:%Y-%m-%dT%H:%M:%S}", f"{shown:%Y-%m-%dT%H:%M:%S}"))
    return "\n".join([*told[:5], *(told[:4:-1] if newest_first else told[5:])]) + "\n"


@pytest.mark.parametrize("newest_first", [False, True])
def test_the_hour_that_a_clock_repeats_is_kept_and_told(read, newest_first):
    record = read(autumn(newest_first))
    assert record.frame.height == 60
    assert record.frame["time"].is_sorted()
    [note] = [note for note in record.notes if "clock" in note]
    assert note == (
        "The clock went back in 1 place, first at 2024-10-27 02:03: 12 readings of a repeated hour are kept beside "
        "those of the first pass."
    )
    known = read(autumn(newest_first), time_zone="Europe/Berlin").frame
    instants = known.select(at=pl.col("time") - pl.duration(minutes="utc_offset_min"), glucose="glucose_mg_dl").sort(
        "at"
    )
    assert instants["at"].to_list() == every(5, 60, AUTUMN - timedelta(hours=2))
    assert instants["glucose"].to_list() == [float(glucose(number)) for number in range(60)]
    assert not [note for note in record.notes if "gap" in note]


def test_what_comes_after_a_repeated_hour_does_not_stand_beside_it(read):
    instants = every(5, 150, AUTUMN)
    walls = [time - timedelta(hours=time.hour >= 3) for time in instants]
    rows = [f"{time:%Y-%m-%d %H:%M},{100 + n}" for n, time in enumerate(walls)]
    notes = " ".join(read("\n".join(["time,glucose_mg_dl", *rows])).notes)
    assert "12 readings of a repeated hour" in notes
    assert "two trajectories" not in notes


def test_a_meal_in_the_repeated_hour_has_no_known_offset(read):
    meal = "99,2024-10-27T02:30:00,Carbs,,,,iPhone G6,,,45,,,,\n"
    told = read(autumn() + meal, time_zone="Europe/Berlin").frame
    assert told.filter(pl.col("carbs_g").is_not_null())["utc_offset_min"].to_list() == [None]
    assert told["utc_offset_min"].null_count() == 1


def test_a_repeated_hour_with_one_pass_has_no_known_offset(read):
    record = read(clarity(12, start=datetime(2024, 10, 27, 2, 3)), time_zone="Europe/Berlin")
    assert record.frame["utc_offset_min"].null_count() == 12
    assert "12 rows lie in an hour that Europe/Berlin has twice" in " ".join(record.notes)


def test_the_hour_that_a_clock_skips(read):
    record = read(clarity(24, start=datetime(2024, 3, 31, 1, 3)), time_zone="Europe/Berlin")
    assert record.frame["utc_offset_min"].to_list() == [60] * 12 + [None] * 12
    assert "12 rows lie in an hour that Europe/Berlin skips" in " ".join(record.notes)
    shown = clarity(12, start=datetime(2024, 3, 31, 1, 3)) + "\n".join(
        clarity(12, start=datetime(2024, 3, 31, 3, 3)).splitlines()[5:]
    )
    assert "gap" not in " ".join(read(shown, time_zone="Europe/Berlin").notes)


def test_times_in_utc_are_told_as_such_and_brought_to_a_zone(read):
    record = read(nightscout_entries(offset=0))
    assert record.frame["time"][0] == START
    assert "Times are in UTC, for the file tells no other" in record.notes[0]
    record = read(nightscout_entries(offset=0), time_zone="America/New_York")
    assert record.frame["time"][0] == START - timedelta(hours=4)
    assert set(record.frame["utc_offset_min"]) == {-240}


def test_an_offset_in_the_text_of_a_time_is_known(read):
    entries = json.loads(nightscout_entries(3))
    for entry in entries:
        del entry["date"], entry["utcOffset"]
        entry["dateString"] = entry["dateString"].replace("Z", "+0000")
    assert read(json.dumps(entries)).frame["time"][0] == START - timedelta(hours=1)
    for entry in entries:
        entry["dateString"] = entry["dateString"].replace("+0000", "-0530")
    told = read(json.dumps(entries)).frame
    assert told["time"][0] == START - timedelta(hours=1)
    assert set(told["utc_offset_min"]) == {-330}


def test_a_few_rows_of_a_clock_that_was_not_set_are_left_out(read):
    rows = [f"{time:%Y-%m-%d %H:%M},100" for time in every(5, 300)]
    far = [f"{year}-01-01 00:0{n},300" for year in (1970, 2044) for n in range(1, 2)]
    record = read("\n".join(["time,glucose_mg_dl", far[0], *rows, far[1]]))
    assert reading_times(record) == every(5, 300)
    assert record.left_out == {"rows that lie a quarter of a year from all others, as by a wrong clock or year": 2}
    assert any("1970-01-01 00:01, 2044-01-01 00:01" in note for note in record.notes)


def test_two_parts_of_a_record_that_lie_years_apart_stay(read):
    later = [time.replace(year=2026) for time in every(5, 30)]
    rows = [f"{time:%Y-%m-%d %H:%M},100" for time in [*every(5, 300), *later]]
    assert reading_times(read("\n".join(["time,glucose_mg_dl", *rows]))) == [*every(5, 300), *later]


def test_gaps_are_told(read):
    text = clarity(20) + "\n".join(clarity(20, start=START + timedelta(hours=6)).splitlines()[5:])
    assert read(text).notes[-1] == (
        "Readings come every 5 min; 1 gap of 4.4 h in all, the longest from 2024-03-13 01:38 to 2024-03-13 06:03."
    )


def test_repeated_rows_are_left_out_and_others_at_the_same_time_are_told_apart(read):
    text = clarity(20) + "\n".join(clarity(20).splitlines()[5:15]) + "\n"
    record = read(text.replace("iPhone G6", "Dexcom G6"))
    assert record.left_out["rows that repeat another one"] == 10
    other = [line.replace("iPhone G6,1", "iPhone G6,2") for line in clarity(20).splitlines()[5:15]]
    changed = sum("iPhone G6,2" in line for line in other)
    told = read(clarity(20) + "\n".join(other) + "\n")
    assert changed > 3
    assert told.left_out["readings at the time of another reading of the same device"] == changed
    assert readings_of(told) == readings_of(read(clarity(20)))


def test_a_part_that_is_there_twice_is_no_repeated_hour(read):
    lines = clarity(40).splitlines()
    record = read("\n".join([*lines[:25], *lines[15:]]))
    assert record.left_out["rows that repeat another one"] == 10
    assert record.frame.height == 40
    assert not [note for note in record.notes if "clock" in note]


def test_two_files_of_one_person_are_joined(read):
    whole = clarity(40)
    lines = whole.splitlines()
    first, second = "\n".join(lines[:30]), "\n".join([*lines[:5], *lines[20:]])
    record = read(first, second)
    assert record.frame.equals(read(whole).frame)
    assert record.left_out["rows that repeat another one"] == 10
    assert record.rows == len(lines) + 13


def test_one_sensor_under_two_names_counts_once(read):
    lines = clarity(40).splitlines()
    other = [line.replace("iPhone G6", "iPhone G7").replace(":03:00", ":04:00") for line in lines[15:]]
    record = read("\n".join([*lines, *other]))
    assert readings_of(record) == readings_of(read(clarity(40)))
    assert record.left_out["readings of the same sensor by another uploader"] == 30
    assert "say the same glucose" in " ".join(record.notes)


def test_an_unknown_time_zone_and_an_unknown_order_are_refused(refused):
    assert refused(clarity(), time_zone="Mars/Olympus") == (
        "time_zone is 'Mars/Olympus'; give the name of one, like Europe/Berlin"
    )
    with pytest.raises(gl.Refusal, match="dates is 'sideways'; give day-first, month-first or year-first"):
        gl.read_record("no file", dates="sideways")


@pytest.mark.parametrize("year", ["024", "24", "0024", "0999", "9999"])
def test_a_year_that_no_study_has_is_no_time(read, tmp_path, year):
    lines = [f"{time:%Y-%m-%d %H:%M:%S},{100 + n}" for n, time in enumerate(every(5, 20))]
    lines[3] = f"{year}{lines[3][4:]}"
    record = read("\n".join(["time,glucose_mg_dl", *lines]))
    assert (record.rows_used, record.left_out) == (19, {"rows without a readable time": 1})
    record.write_parquet(tmp_path / "record.parquet")
    assert gl.read_record(tmp_path / "record.parquet").frame.equals(record.frame)
