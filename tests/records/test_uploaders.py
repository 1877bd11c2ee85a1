"""One sensor that several uploaders send counts once, and so does a dose that two apps log."""

import json
from datetime import UTC, timedelta

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

from device_files import START, every, glucose, nightscout_treatments
from record_values import entries, notes_of


@pytest.mark.parametrize("shift", [0, 1, 3])
@pytest.mark.parametrize("names", [("share2", "xDrip-DexcomG6"), ("Dexcom A", "Dexcom B"), ("one", "one")])
def test_one_sensor_by_two_uploaders_counts_once(read, names, shift):
    start = START.replace(minute=0)
    one, other = ([*entries(name, 0, late, 300, start)] for name, late in zip(names, (0, shift), strict=True))
    for place, item in enumerate(other):
        item["sgv"] = 100 + place // 10
        one[place]["sgv"] = 100 + place // 10
    record = read(json.dumps(one + other[:200]))
    assert record.frame.height == 300
    assert sum(record.left_out.values()) == 200


@pytest.mark.parametrize("shift", [1, 2])
def test_a_second_uploader_of_the_same_name_for_some_days(read, shift):
    one, other = entries("share2", 0, 0, 900), entries("share2", 0, shift, 900)
    for place, (first, second) in enumerate(zip(one, other, strict=True)):
        first["sgv"] = second["sgv"] = 100 + place // 10 % 60
    record = read(json.dumps(one + other[:200]))
    assert record.frame.height == 900
    assert record.left_out == {"readings of the same sensor by another uploader": 200}


def test_sensors_that_disagree_are_shown_and_chosen(read, refused):
    first, other = entries("Dexcom G7", 0), entries("xDrip-LibreReceiver", 0, 1)
    for place, (one, two) in enumerate(zip(first, other, strict=True)):
        one["sgv"], two["sgv"] = 100 + place // 10, 160 + place // 10
    items = json.dumps(first + other[:30])
    record = read(items)
    assert set(record.frame["device"]) == {"Dexcom G7"}
    assert "disagree, by 60 mg/dl in the median" in notes_of(record)
    assert record.left_out == {"readings of a second sensor while the first one reads": 30}
    chosen = read(items, device="freestyle libre")
    assert chosen.frame["glucose_mg_dl"].min() >= 160.0
    assert chosen.left_out == {"readings of other devices than the one that is chosen": 40}
    assert "the readings are of" in refused(items, device="Dexcom G5")


def at_steps(*parts):
    """Entries of one name that come at each step for a number of readings, one part after the other."""
    result, at = [], START
    for step, count in parts:
        for item in entries("Libre", 0, 0, count):
            time = at + timedelta(minutes=step * (count - 1 - len(result) % count))
            result.append({**item, "sgv": 120, "date": int(time.replace(tzinfo=UTC).timestamp() * 1000)})
        at += timedelta(minutes=step * count)
    return json.dumps(result)


@settings(deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(parts=st.lists(st.tuples(st.sampled_from([1, 3, 5, 10, 15]), st.integers(20, 300)), min_size=1, max_size=3))
def test_one_stream_that_reads_more_often_for_a_while_stays(read, parts):
    record = read(at_steps(*parts))
    assert record.frame.height == sum(count for _, count in parts)
    assert not record.left_out


def test_two_parts_of_a_record_by_two_devices_stay(read):
    record = read(json.dumps(entries("Dexcom G6", 0) + entries("Dexcom G7", 0, 200)))
    assert record.frame.height == 80
    assert not record.left_out


def test_a_dose_in_two_apps_counts_once(read):
    dose = {"eventType": "Meal Bolus", "insulin": 4.5, "carbs": 40}
    at = [START + timedelta(seconds=seconds) for seconds in (0, 20, 600, 640)]
    record = read(
        nightscout_treatments(
            (at[0], {**dose, "enteredBy": "Loop"}),
            (at[1], {**dose, "enteredBy": "xDrip"}),
            (at[2], {**dose, "enteredBy": "Loop"}),
            (at[3], {**dose, "enteredBy": "Loop"}),
        )
    )
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (13.5, 120.0)
    assert sum(record.left_out.values()) == 1


def test_two_sensors_in_a_table_that_names_none_are_told_and_kept(read):
    rows = [(time, glucose(n)) for n, time in enumerate(every(5, 60))]
    rows += [(time + timedelta(minutes=2), glucose(n + 7) + 80) for n, time in enumerate(every(5, 60))]
    lines = [f"{time:%Y-%m-%d %H:%M},{value}" for time, value in sorted(rows)]
    record = read("\n".join(["time,glucose_mg_dl", *lines]))
    assert record.rows_used == 120
    assert "Readings follow two trajectories at the same time for 5 hours" in notes_of(record)
    one = read("\n".join(["time,glucose_mg_dl", *(f"{time:%Y-%m-%d %H:%M},{value}" for time, value in rows[:60])]))
    assert "two trajectories" not in notes_of(one)


def test_two_uploads_in_a_table_that_names_no_source_count_once(read):
    rows = [(time, f"{glucose(n)},{4 if n % 20 == 0 else ''}") for n, time in enumerate(every(5, 200))]
    later = [(time + timedelta(seconds=40), cells) for time, cells in rows[:100]]
    text = "\n".join(["time,glucose_mg_dl,bolus_U", *(f"{time},{cells}" for time, cells in [*rows, *later])])
    record = read(text)
    assert record.frame["time"].to_list() == every(5, 200)
    assert record.frame["bolus_U"].sum() == 4.0 * 10
    assert record.left_out == {"readings that stand there twice, at slightly different times": 100}
    assert any(note.startswith("Readings stand there twice for 8 hours") for note in record.notes)


def test_a_sensor_that_says_nearly_the_same_for_a_while_is_no_second_upload(read):
    rows = [f"{time},{glucose(n)}" for n, time in enumerate(every(5, 200))]
    other = [f"{time + timedelta(seconds=80)},{glucose(n) + 3}" for n, time in enumerate(every(5, 100))]
    assert not read("\n".join(["time,glucose_mg_dl", *rows, *other])).left_out
