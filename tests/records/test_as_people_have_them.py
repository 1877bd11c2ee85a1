"""Records as people have them: several clocks, uploaders and people, insulin that apps log, files of every form."""

import csv
import io
import json
import zipfile
from datetime import datetime, timedelta

import polars as pl
import pytest

import glucoloop as gl
from device_files import START, clarity, every, glucose, libre, nightscout_entries, nightscout_treatments
from glucoloop.records import read_people


def entries(device, offset, shift_min=0, count=40, start=START):
    """Nightscout's entries of one uploader, whose readings come so many minutes later."""
    items = json.loads(nightscout_entries(count, start + timedelta(minutes=shift_min), 0))
    return [{**item, "device": device, "utcOffset": offset} for item in items]


def times_of(record):
    return record.frame.filter(pl.col("glucose_mg_dl").is_not_null())["time"].to_list()


def told(record):
    return " ".join(record.notes)


# One clock


def test_an_offset_of_zero_beside_a_true_one_is_unknown(read):
    record = read(json.dumps(entries("xDrip", 540) + entries("share2", 0, 1)))
    assert times_of(record) == [time + timedelta(hours=9) for time in every(5, 40)]
    assert set(record.frame["utc_offset_min"]) == {540}
    assert "40 times are in UTC and tell no offset" in told(record)


def test_an_offset_of_zero_in_winter_is_one(read):
    winter, summer = datetime(2024, 1, 10), datetime(2024, 7, 10)
    items = entries("Loop", 0, start=winter) + entries("Loop", 60, start=summer)
    record = read(json.dumps(items))
    assert times_of(record) == [*every(5, 40, winter), *every(5, 40, summer + timedelta(hours=1))]


def test_two_clocks_that_run_beside_each_other_are_asked_about(read, refused):
    items = json.dumps(entries("xDrip", 540) + entries("Loop", 60, 1))
    assert "different offsets from UTC at the same time, 60 min, 540 min; say the time zone" in refused(items)
    assert read(items, time_zone="Asia/Tokyo").frame["utc_offset_min"].unique().to_list() == [540]


def profile(zone, rates=(0.8,)):
    steps = [{"time": f"{6 * n:02}:00", "value": str(rate)} for n, rate in enumerate(rates)]
    store = {"Default": {"timezone": zone, "basal": steps}}
    return json.dumps([{"startDate": "2020-01-01T00:00:00Z", "defaultProfile": "Default", "store": store}])


@pytest.mark.parametrize("zone", ["ETC/GMT+7", "America/Phoenix"])
def test_the_zone_of_a_profile_holds_for_all_files(read, zone):
    treatments = nightscout_treatments((START, {"eventType": "Bolus", "insulin": 1}), offset=0)
    record = read(nightscout_entries(offset=0), treatments, profile(zone))
    assert set(record.frame["utc_offset_min"]) == {-420}
    assert times_of(record)[0] == START - timedelta(hours=7)
    assert "tells no other" not in told(record)


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


# One sensor, several uploaders


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
    assert "disagree, by 60 mg/dl in the median" in told(record)
    assert record.left_out == {"readings of a second sensor while the first one reads": 30}
    chosen = read(items, device="freestyle libre")
    assert chosen.frame["glucose_mg_dl"].min() >= 160.0
    assert chosen.left_out == {"readings of other devices than the one that is chosen": 40}
    assert "the readings are of" in refused(items, device="Dexcom G5")


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


# People


def table_of(people, name="id", rows=60):
    lines = [f"{name},time,gl"]
    for who in people:
        lines += [f"{who},{time:%Y-%m-%d %H:%M},{glucose(n)}" for n, time in enumerate(every(5, rows))]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("name", ["id", "PtID", "Subject ID", "patient_id", "participant", "USUBJID"])
def test_a_table_of_people_is_people(tmp_path, name):
    path = tmp_path / "table.csv"
    path.write_text(table_of(("A 1", "A 2", "A 3"), name))
    people = read_people(path, columns="time=time,glucose_mg_dl=gl")
    assert [(who, record.frame.height, record.rows) for who, record in people.items()] == [
        (who, 60, 60) for who in ("A 1", "A 2", "A 3")
    ]
    with pytest.raises(gl.Refusal, match="it is of 3 people"):
        gl.read_record(path, columns="time=time,glucose_mg_dl=gl")


def test_a_column_of_people_that_no_name_tells_is_asked_for(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(table_of(("x", "y"), "wave"))
    with pytest.raises(gl.Refusal, match=r"name the column .* with person_column .*'wave'"):
        read_people(path, columns="time=time,glucose_mg_dl=gl")
    assert len(read_people(path, columns="time=time,glucose_mg_dl=gl", person_column="wave")) == 2


def test_a_table_of_one_person_with_a_number_in_each_row_is_one(read):
    lines = [f"{n},{time:%Y-%m-%d %H:%M},{glucose(n)}" for n, time in enumerate(every(5, 60))]
    assert read("\n".join(["id,time,gl", *lines]), columns="time=time,glucose_mg_dl=gl").rows == 60


# Insulin


def doses(record):
    return [tuple(row) for row in record.frame.filter(pl.col("bolus_U") > 0).select("bolus_U", "bolus_min").rows()]


@pytest.mark.parametrize(
    ("combo", "expected"),
    [
        ({"duration": 30, "splitNow": 0, "splitExt": 100, "enteredinsulin": 7, "relative": 14}, [(7.0, 30.0)]),
        (
            {"duration": 120, "splitNow": 40, "splitExt": 60, "enteredinsulin": 10, "insulin": 4, "relative": 3},
            [(4.0, None), (6.0, 120.0)],
        ),
        ({"duration": "60", "enteredinsulin": "5", "splitNow": "50", "splitExt": "50"}, [(2.5, None), (2.5, 60.0)]),
        ({"durationInMilliseconds": 1_800_000, "relative": 2.0}, [(1.0, 30.0)]),
        ({"duration": 0, "enteredinsulin": 3}, [(3.0, None)]),
    ],
)
def test_combo_boluses(read, combo, expected):
    record = read(nightscout_treatments((START, {"eventType": "Combo Bolus", **combo})))
    assert doses(record) == expected


def test_what_nobody_gets_is_named(read):
    record = read(
        nightscout_treatments(
            (START, {"eventType": "Meal Bolus", "insulin": 5, "carbs": 50, "isValid": False}),
            (START + timedelta(hours=1), {"eventType": "Meal Bolus", "insulin": 2, "carbs": 20, "isValid": True}),
            (START + timedelta(hours=2), {"eventType": "Correction Bolus", "insulin": 1, "type": "PRIMING"}),
            (START + timedelta(hours=3), {"eventType": "Bolus"}),
        )
    )
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (2.0, 20.0)
    assert record.left_out == {
        "entries that were deleted": 1,
        "insulin that fills a tube or a cannula, which nobody gets": 1,
        "entries about insulin without a dose": 1,
    }


def test_pens_of_long_acting_insulin(read):
    pens = json.dumps([{"insulin": "Lantus", "units": 18.0}, {"insulin": "NovoRapid", "units": 4.0}])
    record = read(
        nightscout_treatments(
            (START, {"eventType": "<none>", "insulin": 22, "insulinInjections": pens}),
            (START + timedelta(hours=1), {"eventType": "Long-Acting Insulin", "insulin": 10}),
        )
    )
    assert record.frame["long_acting_U"].drop_nulls().to_list() == [18.0, 10.0]
    assert record.frame["bolus_U"].drop_nulls().to_list() == [4.0]


def rates_of(record):
    return record.frame.filter(pl.col("basal_U_h").is_not_null()).select("time", "basal_U_h").rows()


@pytest.mark.parametrize(
    ("stop", "go"),
    [("Suspend Pump", "Resume Pump"), ("Pump Suspend", "Pump Resume"), ("PumpSuspended", "PumpResumed")],
)
def test_suspensions_in_each_spelling(read, stop, go):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 5, 8)]
    treatments = nightscout_treatments(
        (at[0], meal), (at[1], {"eventType": stop}), (at[2], {"eventType": go}), (at[3], meal), offset=0
    )
    assert rates_of(read(treatments, profile("UTC"))) == [(at[0], 0.8), (at[1], 0.0), (at[2], 0.8)]


@pytest.mark.parametrize(
    ("temporary", "share"),
    [
        ({"percent": -50}, 0.5),
        ({"percent": "50"}, 1.5),
        ({"temp": "percent", "rate": 150}, 1.5),
        ({"percent": -100}, 0.0),
        ({"isAbsolute": False, "rate": 120}, 1.2),
    ],
)
def test_percentages_as_uploaders_write_them(read, temporary, share):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 3, 8)]
    event = {"eventType": "Temp Basal", "duration": 60, **temporary}
    treatments = nightscout_treatments((at[0], meal), (at[1], event), (at[3], meal), offset=0)
    rates = rates_of(read(treatments, profile("UTC")))
    assert rates == [(at[0], 0.8), (at[1], pytest.approx(0.8 * share)), (at[2], 0.8)]


def test_a_switch_by_name_with_a_percentage(read):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 5, 8)]
    switch = {"eventType": "Profile Switch", "profile": "Default", "percentage": 50, "duration": 180}
    treatments = nightscout_treatments((at[0], meal), (at[1], switch), (at[3], meal), offset=0)
    assert rates_of(read(treatments, profile("UTC"))) == [(at[0], 0.8), (at[1], 0.4), (at[2], 0.8)]


def table(rows, names="time,glucose_mg_dl,carbs_g,bolus_U,basal_U_h"):
    return "\n".join([names, *(",".join(map(str, row)) for row in rows)]) + "\n"


def with_basal(rates):
    return table([(f"{time:%Y-%m-%d %H:%M}", 100 + n % 9, "", "", rate) for n, (time, rate) in enumerate(rates)])


def test_a_rate_that_is_refused_is_not_known_from_there_on(read):
    rates = [0.9] * 6 + [5.0] + [1910] * 3 + ["x"] + [0.9] * 6
    text = with_basal(zip(every(60, len(rates)), rates, strict=True))
    record = read(text)
    assert str([rate for _, rate in rates_of(record)]) == str([0.9] * 6 + [5.0] + [float("nan")] * 4 + [0.9] * 6)
    assert "not known from there on" in told(record)
    mixed = [rate for _, rate in rates_of(read(text, file_units="basal=U/h|mU/h"))]
    assert mixed[7] == pytest.approx(1.91)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [("basal", [80] * 20, "a basal rate"), ("bolus", [8400] * 20, "a bolus"), ("carbs", [4000] * 20, "carbohydrate")],
)
def test_amounts_that_nobody_can_mean_are_asked_about(refused, name, values, words):
    place = {"carbs": 2, "bolus": 3, "basal": 4}[name]
    rows = []
    for time, value in zip(every(60, 20), values, strict=True):
        row = [f"{time:%Y-%m-%d %H:%M}", 100, "", "", ""]
        row[place] = value
        rows.append(row)
    sentence = refused(table(rows))
    assert words in sentence
    assert f"file_units='{name}=" in sentence


def test_a_daily_dose_that_nobody_can_mean_is_asked_about(refused):
    rows = [(f"{time:%Y-%m-%d %H:%M}", 100, "", 90, "") for time in every(60, 48)]
    assert "U of boluses on half of its days, which nobody can mean" in refused(table(rows))


@pytest.mark.parametrize(
    ("unit", "rate"), [("mU/h", 0.0009), ("U/5min", 10.8), ("mU/min", 0.054), ("U/day", 0.0375), ("U/h", 0.9)]
)
def test_units_of_any_table(read, unit, rate):
    text = table([("2024-03-13 00:00", 100, 2, "", 0.9), ("2024-03-13 00:05", 101, "", "", 0.9)])
    record = read(text, file_units=f"basal={unit},carbs=10g")
    assert record.frame["basal_U_h"][0] == pytest.approx(rate)
    assert record.frame["carbs_g"][0] == 20.0


# Files


def zipped(**files):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, text in files.items():
            archive.writestr(f"Export/{name}.csv", text)
    return buffer.getvalue()


GLOOKO = {
    "cgm_data_1": "Name:,X Y\nTimestamp,CGM Glucose Value (mg/dl),Serial Number\n"
    + "".join(f"{time:%Y-%m-%d %H:%M},{glucose(n)},S\n" for n, time in enumerate(every(5, 40))),
    "bolus_data_1": "Name:,X Y\nTimestamp,Insulin Type,Blood Glucose Input (mg/dl),Carbs Input (g),Carbs Ratio,"
    "Insulin Delivered (U),Initial Delivery (U),Extended Delivery (U),Serial Number\n"
    "2024-03-13 01:00,Normal,0,45,10,4.5,4.5,0,S\n2024-03-13 02:00,Normal,0,0,10,1.25,1.25,0,S\n",
    "basal_data_1": "Name:,X Y\nTimestamp,Insulin Type,Duration (minutes),Percentage (%),Rate,Insulin Delivered (U),S\n"
    "2024-03-13 00:00,Scheduled,60,,0.8,0.8,S\n2024-03-13 01:00,Suspend,30,,,0,S\n2024-03-13 01:30,Temp,30,50,,,S\n",
    "readme": "nothing to read here",
}


@pytest.mark.parametrize("folder", [False, True])
def test_an_export_of_glooko_is_one_person(read, tmp_path, folder):
    if folder:
        (tmp_path / "export").mkdir()
        for name, text in GLOOKO.items():
            (tmp_path / "export" / f"{name}.csv").write_text(text)
        record = gl.read_record(tmp_path / "export")
    else:
        record = read(zipped(**GLOOKO))
    assert times_of(record) == every(5, 40)
    assert record.frame["carbs_g"].sum() == 45.0
    assert record.frame["bolus_U"].sum() == 5.75
    assert str([rate for _, rate in rates_of(record)]) == "[0.8, 0.0, nan]"
    assert "1 file or table of the folder, ZIP or workbook that no reader knows: not read." in record.notes


def test_a_folder_of_people_is_people_and_not_merged(tmp_path):
    for number in range(3):
        (tmp_path / f"p{number}.csv").write_text(clarity(20 + number))
    (tmp_path / "p4").mkdir()
    (tmp_path / "p4" / "entries.json").write_text(nightscout_entries())
    treatments = nightscout_treatments((START, {"eventType": "Bolus", "insulin": 1.0}))
    (tmp_path / "p4" / "treatments.json").write_text(treatments)
    people = read_people(tmp_path)
    assert [record.frame["glucose_mg_dl"].count() for record in people.values()] == [20, 21, 22, 40]
    assert people["p4"].frame["bolus_U"].sum() == 1.0
    with pytest.raises(gl.Refusal, match="it is of 4 people"):
        gl.read_record(tmp_path)


def test_a_damaged_zip_and_an_empty_one_are_refused(refused):
    assert "a ZIP that is damaged" in refused(zipped(**GLOOKO)[:-40])
    assert refused(zipped()[:4] + b"xx").startswith(("it is", "no reader"))


def test_date_and_time_in_two_columns_with_bars(read):
    lines = [f"{time:%m/%d/%Y}|{time:%H:%M:%S}|{glucose(n)}" for n, time in enumerate(every(5, 300))]
    text = "\n".join(["DeviceDt|DeviceTm|Value", *lines])
    record = read(text, columns="date=DeviceDt,time=DeviceTm,glucose_mg_dl=Value")
    assert times_of(record) == every(5, 300)


def test_days_of_a_study_and_its_clock_by_people(tmp_path):
    lines = [
        f"{who}|{(time - START.replace(minute=0)).days - 1}|{time:%I:%M:%S %p}|{glucose(n)}"
        for who in (7, 8)
        for n, time in enumerate(every(5, 600))
    ]
    path = tmp_path / "cgm.txt"
    path.write_text("\n".join(["PtID|DaysFromEnroll|DeviceTm|Value", *lines]))
    people = read_people(path, columns="date=DaysFromEnroll,time=DeviceTm,glucose_mg_dl=Value")
    assert list(people) == ["7", "8"]
    assert times_of(people["8"]) == every(5, 600, datetime(1999, 12, 31, 0, 3))


def test_a_clock_alone_asks_for_its_date(refused):
    text = "Tag,Uhr,BZ\n13.03.2024,07:00,100\n13.03.2024,07:05,101\n"
    assert "name the column of dates too" in refused(text, columns="time=Uhr,glucose_mg_dl=BZ")


def test_files_with_columns_of_their_own_are_one_person(read):
    first = "Zeit,BZ\n2024-03-13 07:00,100\n2024-03-13 07:05,101\n"
    second = "Uhrzeit,KH\n2024-03-13 07:00,45\n"
    record = read(first, second, columns="time=Zeit|Uhrzeit,glucose_mg_dl=BZ,carbs_g=KH")
    assert (record.frame["glucose_mg_dl"].count(), record.frame["carbs_g"].sum()) == (2, 45.0)
    with pytest.raises(gl.Refusal, match="none of them has the column 'IE'"):
        read(first, second, columns="time=Zeit|Uhrzeit,glucose_mg_dl=BZ,carbs_g=KH,bolus_U=IE")


@pytest.mark.parametrize("mark", ["\ufeff", "\ufeff\ufeff", "\u00ef\u00bb\u00bf"])
def test_a_mark_of_the_encoding_that_is_doubled_or_damaged(read, mark):
    assert read((mark + clarity(20)).encode()).frame.equals(read(clarity(20)).frame)
    assert read((mark + libre(20)).encode()).frame.height == 20


def test_a_line_that_tells_a_spreadsheet_the_separator(read):
    assert read("sep=;\n" + clarity(20).replace(",", ";")).frame.height == 20


def test_lines_of_mongoexport_and_answers_of_version_3(read):
    items = json.loads(nightscout_entries())
    expected = read(json.dumps(items)).frame
    lines = "\n".join(
        json.dumps(
            {
                **item,
                "_id": {"$oid": "1"},
                "date": {"$numberLong": str(item["date"])},
                "sgv": {"$numberInt": str(item["sgv"])},
            }
        )
        for item in items
    )
    assert read(lines).frame.equals(expected)
    assert read(json.dumps({"status": 200, "result": items})).frame.equals(expected)


# Languages


FRENCH = (
    "Appareil,Numéro de série,Horodatage de l'appareil,Type d'enregistrement,Historique de la glycémie mg/dL,"
    "Numérisation de la glycémie mg/dL,a,Insuline à action rapide (unités),b,Glucides (grammes),c,d,"
    "Insuline à action lente (unités),e,f"
)


def test_libreview_in_a_language_that_is_not_known(read):
    lines = [
        f"FreeStyle Libre 2,X,{time:%d-%m-%Y %H:%M},0,{glucose(n)},,,,,,,,,," for n, time in enumerate(every(15, 40))
    ]
    more = ["FreeStyle Libre 2,X,13-03-2024 00:10,4,,,,5,,,,,,,", "FreeStyle Libre 2,X,13-03-2024 00:11,5,,,,,,40,,,,,"]
    record = read("\n".join(["Données", FRENCH, *lines, *more]) + "\n")
    assert times_of(record) == every(15, 40)
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (5.0, 40.0)
    assert "columns were taken by their place" in told(record)


def test_clarity_in_a_language_that_is_not_known(read):
    head = (
        "Índice,Marca,Tipo de evento,Subtipo,Paciente,Dispositivo,Origen,Nivel de glucosa (mg/dL),Insulina,HC,D,T,L,ID"
    )
    rows = [
        line.replace("EGV", "NGS").replace("Fast-Acting", "Acción r\u00e1pida") for line in clarity(40).splitlines()[1:]
    ]
    rows += [
        "90,2024-03-13T01:00:00,Insulina,Acción r\u00e1pida,,,iPhone G6,,4,,,,,",
        "91,2024-03-13T01:01:00,HC,,,,iPhone G6,,,30,,,,",
    ]
    record = read("\n".join([head, *rows]) + "\n")
    assert times_of(record) == every(5, 40)
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (4.0, 30.0)


# Published data sets


def azt1d(rows):
    names = (
        "EventDateTime,DeviceMode,BolusType,Basal,CorrectionDelivered,TotalBolusInsulinDelivered,FoodDelivered,CarbSize,"
        "CGM"
    )
    lines = [f"{at:%Y-%m-%d %H:%M:%S},,,{rate},,{bolus},,{carbs},{cgm}" for at, rate, bolus, carbs, cgm in rows]
    return "\n".join([names, *lines]) + "\n"


def test_azt1d_with_rates_in_two_units(read):
    rates = [0.9, 0.8, 900, 12, 800, 1200, 0.9, 2.0, 0.7]
    rows = [(time, rate, "", "", 100) for time, rate in zip(every(5, 9), rates, strict=True)]
    rows[3] = (*rows[3][:2], 2.5, 30, "")
    record = read(azt1d(rows))
    assert [rate for _, rate in rates_of(record)] == pytest.approx([0.9, 0.8, 0.9, 0.012, 0.8, 1.2, 0.9, 2.0, 0.7])
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (2.5, 30.0)


def test_a_second_reading_of_a_time_does_not_take_its_bolus(read):
    record = read(azt1d([(START, "", "", "", 100), (START, "", 2.5, "", 101), (every(5, 2)[1], "", "", "", 102)]))
    assert record.frame["bolus_U"].sum() == 2.5
    assert record.frame["glucose_mg_dl"].drop_nulls().to_list() == [100.0, 102.0]


def test_t1d_uom_of_four_files(read):
    record = read(
        "bg_ts,value\n13/03/2024 00:00,5.5\n13/03/2024 00:05,6.0\n",
        "\ufeffbolus_ts,bolus_dose\n13/03/2024 00:01,4\n",
        "\ufeffbasal_ts,basal_dose,insulin_kind\n13/03/2024 00:00,0.9,R\n13/03/2024 00:02,12,L\n",
        "\ufeffmeal_ts,meal_type,meal_tag,carbs_g,prot_g,fat_g,fibre_g\n13/03/2024 00:01,Lunch,x,45,1,2,3\n",
    )
    sums = record.frame.select(pl.col("carbs_g", "bolus_U", "long_acting_U", "basal_U_h").sum()).row(0)
    assert sums == (45.0, 4.0, 12.0, 0.9)


def test_hupa_ucm_in_its_units(read):
    names = "time;glucose;calories;heart_rate;steps;basal_rate;bolus_volume_delivered;carb_input"
    record = read(f"{names}\n2024-03-13T00:00:00;100;5;70;0;0.075;2;4\n2024-03-13T00:05:00;101;5;70;0;0.075;0;0\n")
    sums = record.frame.select(pl.col("carbs_g", "bolus_U").sum(), pl.col("basal_U_h").first()).row(0)
    assert sums == (40.0, 2.0, pytest.approx(0.9))


def test_a_csv_writer_s_quotes_do_no_harm(read):
    buffer = io.StringIO()
    csv.writer(buffer, quoting=csv.QUOTE_ALL).writerows([line.split(",") for line in clarity(20).splitlines()])
    assert read(buffer.getvalue()).frame.equals(read(clarity(20)).frame)
