"""Entries, treatments and tables of Nightscout, against the values that were written into them."""

import json
from datetime import datetime

import polars as pl
import pytest

from device_files import (
    START,
    every,
    glucose,
    nightscout_entries,
    nightscout_text,
    nightscout_treatments,
)
from record_values import expected, minutes, readings, values


def test_nightscout(read):
    treatments = nightscout_treatments(
        (minutes(2), {"eventType": "Meal Bolus", "insulin": 4, "carbs": 45}),
        (minutes(10), {"eventType": "Temp Basal", "absolute": 0.5, "duration": 30}),
        (minutes(20), {"eventType": "Temp Basal", "rate": 1.5, "duration": 30}),
        (minutes(90), {"eventType": "Temp Basal", "absolute": 2.0, "duration": 30}),
        (minutes(100), {"eventType": "Temp Basal", "duration": 0}),
        (minutes(110), {"eventType": "Temporary Target", "targetTop": 160, "duration": 60}),
    )
    record = read(nightscout_entries(), treatments)
    assert readings(record) == expected(5)
    assert set(record.frame["utc_offset_min"]) == {60}
    assert record.frame.filter(pl.col("bolus_U").is_not_null())["carbs_g"].to_list() == [45.0]
    rates = values(record, "basal_U_h")
    assert [time for time, _ in rates] == [minutes(n) for n in (10, 20, 50, 90, 100)]
    assert str([rate for _, rate in rates]) == "[0.5, 1.5, nan, 2.0, nan]"
    assert record.left_out == {"treatments without carbohydrate or insulin": 1}
    assert record.rows == 46
    assert "The basal rate is not known from 2 times on" in " ".join(record.notes)


def test_nightscout_codes_of_low_high_and_errors(read):
    entries = json.loads(nightscout_entries(4))
    for entry, code in zip(entries, (39, 401, 5, "?"), strict=True):
        entry["sgv"] = code
    record = read(json.dumps(entries))
    assert dict(record.frame.select("glucose_mg_dl", "out_of_range").iter_rows()) == {39.0: "low", 401.0: "high"}
    assert record.left_out == {"rows with values that are no number or not possible": 2}


MEAL = (minutes(2), {"eventType": "Meal Bolus", "insulin": 4, "carbs": 45})


@pytest.mark.parametrize("delimiter", ["\t", ","])
def test_nightscout_as_text(read, delimiter):
    record = read(nightscout_text(40, delimiter), nightscout_treatments(MEAL))
    assert [value for _, value in sorted(readings(record).items())] == [glucose(n) for n in range(40)]
    assert record.rows == record.rows_used == 41
    assert set(record.frame["device"].drop_nulls()) == {"Dexcom G6"}


TREATMENTS = (
    "_id,absolute,carbs,created_at,duration,enteredBy,eventType,insulin,isSMB,isValid,percent,raw_rate/amount\n"
    "a,,45,{0}T01:00:00.000Z,,Loop,Meal Bolus,4.5,False,True,,\n"
    "b,0.5,,{0}T02:00:00Z,30,openaps,Temp Basal,,,,,0.5\n"
    'c,,10,{0}T03:00:00Z,,"x, y",Carb Correction,,,false,,\n'
    "d,,,{0}T04:00:00Z,,x,Note,NaN,,,,\n"
).format("2024-03-13")


def test_treatments_of_nightscout_as_a_table(read, refused):
    record = read(TREATMENTS)
    assert record.frame.select("carbs_g", "bolus_U", "bolus_type").drop_nulls().rows() == [(45.0, 4.5, "manual")]
    assert str(values(record, "basal_U_h")) == str([(minutes(117), 0.5), (minutes(147), float("nan"))])
    assert record.left_out == {"entries that were deleted": 1, "treatments without carbohydrate or insulin": 1}
    local = TREATMENTS.replace("T0", " 0").replace(".000Z", "").replace("Z,", ",")
    assert refused(local).startswith("its times tell no offset from UTC; say the time zone of their clock")
    assert values(read(local, time_zone="Europe/Berlin"), "carbs_g") == [(minutes(57), 45.0)]


def test_entries_of_nightscout_as_pairs_and_as_a_table(read, refused):
    pairs = [f"{time:%Y-%m-%dT%H:%M:%S.000Z}, {glucose(n)}" for n, time in enumerate(every(5, 40))]
    assert readings(read("\n".join(pairs))) == expected(5)
    rows = [f"{glucose(n) / 18.0156:.9f},{line.split(',')[0]},xDrip" for n, line in enumerate(pairs)]
    table = "\n".join(["sgv,dateString,device", *rows])
    assert "it looks like mmol/l" in refused(table)
    assert list(readings(read(table, glucose_unit="mmol/l"))) == every(5, 40)


def test_seconds_since_1970_are_no_milliseconds(read):
    entries = json.loads(nightscout_entries())
    seconds = [{**entry, "date": entry["date"] // 1000, "dateString": None} for entry in entries]
    assert read(json.dumps(seconds)).frame.equals(read(json.dumps(entries)).frame)


def test_times_without_an_offset_are_asked_about(read, refused):
    meals = json.dumps([{"eventType": "Meal Bolus", "created_at": "2024-07-01T08:00:00", "insulin": 4}])
    assert "its times tell no offset from UTC" in refused(meals)
    [row] = read(meals, time_zone="Europe/Berlin").frame.select("time", "utc_offset_min").rows()
    assert row == (datetime(2024, 7, 1, 8), 120)


def test_the_zone_of_a_profile_in_other_letters(read):
    profile = {
        "defaultProfile": "A",
        "store": {"A": {"timezone": "europe/berlin", "basal": [{"time": "00:00", "value": 1}]}},
    }
    record = read(nightscout_treatments((START, {"eventType": "Meal Bolus", "insulin": 4})), json.dumps([profile]))
    assert "Europe/Berlin is the time zone that the files tell" in " ".join(record.notes)


def test_what_carbohydrate_and_notes_do_not_say_is_told(read):
    treatments = nightscout_treatments(
        (START, {"eventType": "Carb Correction", "carbs": 60, "duration": 180}),
        (START, {"eventType": "Carb Correction", "carbs": 8, "isFPU": True}),
        (START, {"eventType": "Correction Bolus", "insulin": 20, "notes": "Tresiba"}),
        (START, {"eventType": "Combo Bolus", "insulin": 2, "carbs": 30, "duration": 60}),
    )
    told = " ".join(read(treatments).notes)
    assert "1 entry of carbohydrate over a time: the whole stands at the beginning." in told
    assert "1 entry of carbohydrate that an app counts for fat and protein" in told
    assert "1 bolus has the name of a long-acting insulin in the note, and counts as rapid-acting" in told
