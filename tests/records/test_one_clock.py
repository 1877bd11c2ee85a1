"""One clock for all files: offsets, zones, the hour that a clock repeats, dates that a study shifted."""

import json
from datetime import datetime, timedelta

import polars as pl
import pytest

import glucoloop as gl
from device_files import START, clarity, every, libre, nightscout_entries, nightscout_treatments
from record_values import entries, notes_of, profile, reading_times


def test_an_offset_of_zero_beside_a_true_one_is_unknown(read):
    record = read(json.dumps(entries("xDrip", 540) + entries("share2", 0, 1)))
    assert reading_times(record) == [time + timedelta(hours=9) for time in every(5, 40)]
    assert set(record.frame["utc_offset_min"]) == {540}
    assert "40 times are in UTC and tell no offset" in notes_of(record)


def test_an_offset_of_zero_in_winter_is_one(read):
    winter, summer = datetime(2024, 1, 10), datetime(2024, 7, 10)
    items = entries("Loop", 0, start=winter) + entries("Loop", 60, start=summer)
    record = read(json.dumps(items))
    assert reading_times(record) == [*every(5, 40, winter), *every(5, 40, summer + timedelta(hours=1))]


def test_two_clocks_that_run_beside_each_other_are_asked_about(read, refused):
    items = json.dumps(entries("xDrip", 540) + entries("Loop", 60, 1))
    assert "different offsets from UTC at the same time, 60 min, 540 min; say the time zone" in refused(items)
    assert read(items, time_zone="Asia/Tokyo").frame["utc_offset_min"].unique().to_list() == [540]


@pytest.mark.parametrize("zone", ["ETC/GMT+7", "America/Phoenix"])
def test_the_zone_of_a_profile_holds_for_all_files(read, zone):
    treatments = nightscout_treatments((START, {"eventType": "Bolus", "insulin": 1}), offset=0)
    record = read(nightscout_entries(offset=0), treatments, profile(zone))
    assert set(record.frame["utc_offset_min"]) == {-420}
    assert reading_times(record)[0] == START - timedelta(hours=7)
    assert "tells no other" not in notes_of(record)


def test_a_zone_that_offsets_contradict_is_asked_about(tmp_path):
    for name, text in (("e", json.dumps(entries("xDrip", 540))), ("p", profile("ETC/GMT+7"))):
        (tmp_path / name).write_text(text)
    with pytest.raises(gl.Refusal, match=r"tells the time zone Etc/GMT\+7, and 40 of its times tell another offset"):
        gl.read_record(tmp_path / "e", tmp_path / "p")


def test_utc_beside_a_clock_on_the_wall_is_asked_about(read):
    with pytest.raises(gl.Refusal, match="some of its times are in UTC and others on the clock on the wall; say the"):
        read(nightscout_entries(offset=0), libre())
    assert read(nightscout_entries(offset=0), libre(), time_zone="Europe/Berlin").rows == 80


def night(step, newest_first=False, drop=(), zone=True):
    """LibreView over the night in which clocks in Berlin go back, sorted by the clock on the wall."""
    begin = datetime(2024, 10, 27, 0, 3)
    rows = []
    for number in range(int(300 / step)):
        at = begin + timedelta(minutes=step * number)
        rows.append((at - timedelta(hours=at.hour >= 3), 100 + 2 * number, number))
    rows = [row for row in rows if row[2] not in drop]
    rows.sort(key=lambda row: (row[0], row[1]), reverse=newest_first)
    header = libre(0).split("\n")[1]
    lines = [f"FreeStyle Libre 3,X,{at:%d-%m-%Y %H:%M},0,{value},,,,,,,,,,,,,," for at, value, _ in rows]
    return "\n".join(["Glucose Data", header, *lines]) + "\n", begin


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
@pytest.mark.parametrize(("step", "drop"), [(15, ()), (5, ()), (15, (10,)), (5, (30,))])
def test_both_passes_of_a_repeated_hour_that_are_interleaved(read, step, drop, zone):
    text, begin = night(step, drop=drop)
    record = read(text, time_zone=zone)
    expected = [100.0 + 2 * number for number in range(int(300 / step)) if number not in drop]
    if zone is None:
        assert sorted(record.frame["glucose_mg_dl"]) == expected
        return
    shown = record.frame.select(at=pl.col("time") - pl.duration(minutes="utc_offset_min"), of="glucose_mg_dl").sort(
        "at"
    )
    assert shown["of"].to_list() == expected
    times = [begin - timedelta(hours=2) + timedelta(minutes=step * (value - 100) / 2) for value in expected]
    assert shown["at"].to_list() == times


def test_dates_that_a_study_shifted_are_dates(read):
    record = read(clarity(20, start=datetime(2083, 5, 1)))
    assert record.frame["time"][0].year == 2083
    old = "time,glucose_mg_dl\n1926-01-01T00:00,100\n1926-01-01T00:05,101\n"
    assert read(old).frame["time"][0].year == 1926
