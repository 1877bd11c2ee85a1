"""Files of every form: ZIPs, folders, several files of a person, dates beside times, marks of encodings."""

import gzip
import io
import json
import sqlite3
import zipfile
from datetime import datetime, timedelta
from math import nan

import polars as pl
import pytest

import glucoloop as gl
from device_files import START, clarity, every, glucose, libre, nightscout_entries, nightscout_treatments
from glucoloop.records import read_people
from naming import naming
from record_values import rates_of, reading_times


def zipped(**files):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, text in files.items():
            archive.writestr(f"Export/{name}.csv", text)
    return buffer.getvalue()


def zipped_bytes(data):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("inner.zip", data)
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
    assert reading_times(record) == every(5, 40)
    assert record.frame["carbs_g"].sum() == 45.0
    assert record.frame["bolus_U"].sum() == 5.75
    assert str([rate for _, rate in rates_of(record)]) == "[0.8, 0.0, nan, nan]"
    assert "1 file or table of the folder, ZIP or workbook that no reader knows: not read." in record.notes


GLOOKO_DE = {
    "cgm_data_1": "Name:X Y,Datumsbereich:13.03.2024 - 14.03.2024\nZeitstempel,CGM-Glukosewert (mg/dl),Seriennummer\n"
    '13.03.2024 00:03,"100,0",S\n13.03.2024 00:08,"1,0",S\n13.03.2024 00:13,"2001,0",S\n',
    "bolus_data_1": "Name:X Y\nZeitstempel,Insulin-Typ,Blutzuckereingabe (mg/dl),Kohlenhydrataufnahme (g),"
    "Kohlenhydratverhältnis,Abgegebenes Insulin (E),Anfängliche Abgabe (E),Verzögerte Abgabe (E),Seriennummer\n"
    '13.03.2024 08:00,Normal,,"46,2","10,0","4,55","3,55","1,0",S\n',
    "basal_data_1": "Name:X Y\nZeitstempel,Insulin-Typ,Dauer (Minuten),Prozentsatz (%),Rate,Abgegebenes Insulin (E)\n"
    '13.03.2024 00:00,Basal,60,100,"0,8","0,8"\n13.03.2024 01:00,Basal,30,50,,"0,2"\n'
    '13.03.2024 05:00,Basal,60,100,"1,0","1,0"\n',
    "manual_insulin_data_1": "Name:X Y\nZeitstempel,Name,Wert,Insulin-Typ\n"
    '13.03.2024 09:00,NovoRapid,"2,5",Schnell\n13.03.2024 22:00,Toujeo,"18,0",Lang\n13.03.2024 23:00,X,"3,0",\n',
    "food_data_1": "Name:X Y\nZeitstempel,Name,KH (g),Fett (g),Eiweiß (g),Kalorien,Portionen,Anzahl der Portionen\n"
    '13.03.2024 08:01,Brot,"46,2",,,,,\n13.03.2024 12:00,Apfel,"15,0",,,,,\n',
    "insulin_data_1": "Name:X Y\nZeitstempel,Bolus gesamt (U),Insulin gesamt (U),Basal gesamt (U)\n"
    '13.03.2024 23:59,"12,5","31,2","18,7"\n',
    "bg_data_1": "Name:X Y\nZeitstempel,Glukosewert (mg/dl),Manuelles Lesen\n13.03.2024 08:05,123,Ja\n",
}


def test_an_export_of_glooko_in_german(read):
    record = read(zipped(**GLOOKO_DE))
    assert record.frame.filter(pl.col("glucose_mg_dl") > 0)["out_of_range"].to_list() == [None, "low", "high"]
    assert [carbs for carbs in record.frame["carbs_g"].drop_nulls()] == [
        46.2,
        15.0,
    ]  # the meal of the bolus counts once
    assert record.frame["bolus_U"].drop_nulls().to_list() == [4.55, 2.5]
    assert record.frame["long_acting_U"].drop_nulls().to_list() == [18.0]
    rates = record.frame.drop_nulls("basal_U_h").select(pl.col("time").dt.strftime("%H:%M"), "basal_U_h").rows()
    assert str(rates) == str([("00:00", 0.8), ("01:00", 0.4), ("01:30", nan), ("05:00", 1.0), ("06:00", nan)])
    assert record.left_out == {
        "finger pricks": 1,
        "daily totals": 1,
        "doses of insulin of an unknown kind": 1,
        "carbohydrate that another app has within 2 min": 1,
    }
    assert any("1 bolus has an extended part" in note for note in record.notes)


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
    assert reading_times(record) == every(5, 300)


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
    assert reading_times(people["8"]) == every(5, 600, datetime(1999, 12, 31, 0, 3))


@pytest.mark.parametrize("clock", ["1900-01-01 %H:%M:%S", "0 days %H:%M:%S", "%H.%M", "%I:%M %p"])
def test_a_clock_beside_a_date_as_spreadsheets_write_it(read, clock):
    rows = [f"13.03.2024;{time:{clock}};{glucose(n)}" for n, time in enumerate(every(5, 40))]
    record = read("\n".join(["Tag;Uhr;BZ", *rows]), columns="date=Tag,time=Uhr,glucose_mg_dl=BZ")
    assert reading_times(record) == every(5, 40)


@pytest.mark.parametrize("sign", [".", ","])
def test_times_as_numbers_of_days_of_a_spreadsheet(read, sign):
    days = [(time - datetime(1899, 12, 30)).total_seconds() / 86400.0 for time in every(5, 40)]
    rows = [f"{day:.6f};{glucose(n)}".replace(".", sign) for n, day in enumerate(days)]
    record = read("\n".join(["Zeit;BZ", *rows]), columns="time=Zeit,glucose_mg_dl=BZ")
    assert reading_times(record) == every(5, 40)
    assert "Its times are numbers of days, as of a spreadsheet." in record.notes


def test_a_clock_as_a_part_of_a_day(read):
    rows = [
        f"13.03.2024;{(time.hour * 60 + time.minute) / 1440:.6f};{glucose(n)}" for n, time in enumerate(every(5, 40))
    ]
    record = read("\n".join(["Tag;Uhr;BZ", *rows]), columns="date=Tag,time=Uhr,glucose_mg_dl=BZ")
    assert reading_times(record) == every(5, 40)


def test_a_midnight_without_its_clock_among_other_times(read):
    times = every(15, 100, START.replace(minute=0))
    rows = [f"{str(time).removesuffix(' 00:00:00')},{glucose(n)}" for n, time in enumerate(times)]
    record = read("\n".join(["time,glucose_mg_dl", *rows]))
    assert reading_times(record) == times
    assert "2 times without a clock among others with one: read as midnight" in " ".join(record.notes)


def test_carbohydrate_in_exchanges_by_the_name_of_its_column(read, refused):
    text = "time,bg,KE (10 g)\n2024-03-13 01:00,100,3.5\n"
    columns = "time=time,glucose_mg_dl=bg,carbs_g=KE (10 g)"
    assert refused(text, columns=columns).startswith("the column 'KE (10 g)' is taken as g, and its name has 'KE'")
    assert read(text, columns=columns, file_units="carbs=10g").frame["carbs_g"].to_list() == [35.0]


def test_two_files_that_disagree_at_the_same_times_are_told(read):
    rows = [[f"{time:%Y-%m-%d %H:%M},{100 + n + apart}" for n, time in enumerate(every(5, 40))] for apart in (0, 50)]
    record = read(*("\n".join(["time,glucose_mg_dl", *one]) for one in rows))
    assert record.left_out == {"readings of a second sensor while the first one reads": 40}
    assert "disagree, by 50 mg/dl in the median" in " ".join(record.notes)


def test_times_in_an_unknown_form_are_shown_without_their_digits(refused):
    text = "time,glucose_mg_dl\nWed Mar 13 07:08:09 2024,100\n"
    assert refused(text) == (
        "none of its times can be read; they look like 'aaa aaa 99 99:99:99 9999'; write them as 2024-03-13 08:05:00"
    )


def test_a_unit_behind_each_number(read):
    rows = [f"{time:%Y-%m-%d %H:%M};5,5 mmol/L;12 g;1,5 IE;0,9 U/h" for time in every(5, 3)]
    frame = read("\n".join(["time;glucose_mmol_l;carbs_g;bolus_U;basal_U_h", *rows])).frame
    assert frame.select("carbs_g", "bolus_U", "basal_U_h").rows() == [(12.0, 1.5, 0.9)] * 3
    assert frame["glucose_mg_dl"].to_list() == pytest.approx([99.0858] * 3)
    record = read("time;glucose_mg_dl;carbs_g\n2024-03-13 01:00;100;12 oz\n")
    assert record.frame["carbs_g"].null_count() == 1
    assert "1 cell of carbohydrate holds no number." in record.notes


@pytest.mark.parametrize(
    ("name", "unit", "value", "rate"),
    [("Basal (mU/h)", "mU/h", 900, 0.9), ("rate IE/min", "IE/min", 0.01, 0.6), ("mU/min", "mU/min", 15, 0.9)],
)
def test_a_name_with_another_unit_asks_for_it(read, refused, name, unit, value, rate):
    text, columns = f"time,bg,{name}\n2024-03-13 01:00,100,{value}\n", f"time=time,glucose_mg_dl=bg,basal_U_h={name}"
    assert refused(text, columns=columns).endswith(f"say its unit, as file_units='basal={unit}' (--file-units)")
    record = read(text, columns=columns, file_units=f"basal={unit}")
    assert record.frame["basal_U_h"].to_list() == pytest.approx([rate])


def test_glucagon_of_a_table_is_kept_in_its_unit_and_refused_where_nobody_can_mean_it(read, refused):
    header = "time,glucose_mg_dl,glucagon_ug\n"
    rows = ["01:00,90,100", "01:05,80,0", "01:10,75,20 mcg", "01:15,70,-3", "01:20,71,nan", "01:25,72,6000"]
    rows += [f"02:{minute},90,{amount}" for minute, amount in ((10, 5), (20, 15.5), (30, 30))]
    record = read(header + "".join(f"2024-03-13 {row}\n" for row in rows))
    assert record.frame["glucagon_ug"].to_list() == [100.0, None, 20.0, None, None, None, 5.0, 15.5, 30.0]
    assert any("2 values of glucagon outside of 0 to 5000 (from -3 to 6000" in note for note in record.notes)
    assert "4 of its values of glucagon are outside of 0 to 5000 ug" in refused(
        header + "".join(f"2024-03-13 01:{minute},90,9000\n" for minute in (10, 20, 30, 40))
    )
    assert "10400 ug of glucagon on half of its days" in refused(
        header + "".join(f"2024-03-13 {hour}:00,90,4000\n2024-03-13 {hour}:30,90,1200\n" for hour in (10, 12))
    )
    text, columns = "time,bg,Glucagon (mg)\n2024-03-13 01:00,90,0.1\n", "time=time,glucose_mg_dl=bg,glucagon_ug="
    columns += "Glucagon (mg)"
    assert refused(text, columns=columns).endswith("say its unit, as file_units='glucagon=mg' (--file-units)")
    assert read(text, columns=columns, file_units="glucagon=mg").frame["glucagon_ug"].to_list() == [100.0]
    assert "give one like ug or mg" in refused(text, columns=columns, file_units="glucagon=U")


def test_compressed_files_and_utf_16_without_a_mark(read, refused):
    expected = read(clarity(40)).frame
    assert read(gzip.compress(clarity(40).encode())).frame.equals(expected)
    assert read(clarity(40).encode("utf-16-le")).frame.equals(expected)
    assert read(clarity(40).encode("utf-16-be")).frame.equals(expected)
    assert "compressed by gzip and damaged" in refused(b"\x1f\x8b" + bytes(60))
    assert "a ZIP within another file" in refused(zipped_bytes(zipped(a=clarity(3))))


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


def test_a_zip_of_people_is_people_and_not_merged(tmp_path):
    path = tmp_path / "people.zip"
    for names in (("1.csv", "2.csv"), ("a/1.csv", "a/2.csv"), ("a/1/x.csv", "a/2/x.csv"), ("/1.csv", "/2.csv")):
        path.write_bytes(zipped(**{names[0]: clarity(40), names[1]: clarity(30)}))
        assert sorted(record.rows_used for record in read_people(path).values()) == [30, 40]
    with pytest.raises(gl.Refusal, match="read them with read_people"):
        gl.read_record(path)


@pytest.mark.parametrize("folder", [False, True])
def test_an_export_with_insulin_in_a_folder_of_its_own_is_one_person(tmp_path, folder):
    inner = {name if "cgm" in name else f"Insulin data/{name}": text for name, text in GLOOKO.items()}
    path = tmp_path / "export.zip"
    path.write_bytes(zipped(**inner))
    if folder:
        zipfile.ZipFile(path).extractall(tmp_path / "export")
        path = tmp_path / "export"
    record = gl.read_record(path)
    assert record.frame["bolus_U"].sum() > 0.0
    assert record.frame["glucose_mg_dl"].is_not_null().any()


def test_the_database_of_xdrip(tmp_path):
    path = tmp_path / "export.sqlite"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE BgReadings (_id INTEGER, timestamp REAL, calculated_value REAL, dg_mgdl REAL)")
        database.execute(
            "CREATE TABLE Treatments (timestamp INTEGER, eventType, carbs REAL, insulin REAL, insulinJSON)"
        )
        database.execute("CREATE TABLE BloodTest (timestamp INTEGER, mgdl REAL)")
        at = [int((time - datetime(1970, 1, 1)).total_seconds() * 1000) for time in every(5, 40)]
        database.executemany(
            "INSERT INTO BgReadings VALUES (?, ?, ?, 0)", [(n, t, glucose(n)) for n, t in enumerate(at)]
        )
        database.executemany(
            "INSERT INTO Treatments VALUES (?, ?, ?, ?, ?)",
            [
                (at[1], "<none>", 40.0, 3.5, None),
                (at[2], "<none>", 0.0, 14.0, '[{"insulin": "Lantus", "units": 14.0}]'),
                (at[3], "Note", 0.0, 0.0, None),
            ],
        )
        database.execute("INSERT INTO BgReadings VALUES (99, ?, 38, 0)", (at[-1] + 300_000,))  # an error
        database.execute("INSERT INTO BloodTest VALUES (?, 118)", (at[4],))
    database.close()
    record = gl.read_record(path)
    assert reading_times(record) == every(5, 40)
    sums = [record.frame[name].sum() for name in ("carbs_g", "bolus_U", "long_acting_U")]
    assert sums == [40.0, 3.5, 14.0]
    assert record.left_out == {
        "readings without a value": 1,
        "finger pricks": 1,
        "rows without glucose, carbohydrate, insulin or glucagon": 1,
    }


@pytest.mark.parametrize("data", [b"SQLite format 3\0", b"SQLite format 3\0" + bytes(5000)])
def test_a_database_of_no_known_app_is_refused(refused, data):
    assert "it is a database" in refused(data)


def test_a_view_that_never_ends_is_not_asked(tmp_path, refused):
    path = tmp_path / "export.sqlite"
    with sqlite3.connect(path) as database:
        endless = "WITH RECURSIVE n(timestamp) AS (SELECT 1 UNION ALL SELECT timestamp FROM n) SELECT * FROM n"
        database.execute(f"CREATE VIEW BgReadings AS {endless}")
    database.close()
    assert "without a table of xDrip" in refused(path.read_bytes())


def test_a_program_in_a_form_that_is_not_known_is_named(refused):
    told = refused("Name:,X\nGlooko-Bericht\nZeitpunkt,Messwert\n13.03.2024 00:03,110\n")
    assert "it names Glooko, and has a form or a language that is not known here" in told
    assert "--columns" in told


def test_a_text_beside_a_table_in_a_zip_is_left_out_and_counted(tmp_path):
    lines = [f"{5 * k // 60:02d}:{5 * k % 60:02d};{100 + k % 40}" for k in range(200)]
    table = "\n".join(["Zeit;BZ", *(f"01.01.2026 {line}" for line in lines)])
    with zipfile.ZipFile(tmp_path / "export.zip", "w") as archive:
        archive.writestr("export.csv", table)
        archive.writestr("readme.txt", "This is an export of your data.\nThank you.\n")
    named = {"dates": "day-first", "glucose_unit": "mg/dl"}
    record = gl.read_record(tmp_path / "export.zip", columns="time=Zeit,glucose_mg_dl=BZ", **named)
    assert record.frame.height == 200
    assert any("1 file or table" in note and "not read" in note for note in record.notes)
    with pytest.raises(gl.Refusal, match=r"export\.csv: no line of its beginning has all of the columns Zeit, Zucker"):
        gl.read_record(tmp_path / "export.zip", columns="time=Zeit,glucose_mg_dl=Zucker", **named)


def test_names_of_columns_with_a_delimiter_in_quotes(read):
    text = 'time,"Carbs (Grams, Factor 1)",g\n2024-03-13 08:00,45,120\n'
    columns = "time=time,carbs_g=Carbs (Grams, Factor 1),glucose_mg_dl=g"
    [row] = read(text, columns=columns).frame.select("carbs_g", "glucose_mg_dl").rows()
    assert row == (45.0, 120.0)


def test_each_cell_of_glucose_is_in_its_own_unit(read):
    both = "time,BZ\n2024-03-13 08:00,180 mg/dl\n2024-03-13 08:05,10.0 mmol/L\n2024-03-13 08:10,90\n"
    record = read(both, columns="time=time,glucose_mg_dl=BZ")
    assert record.frame["glucose_mg_dl"].to_list() == pytest.approx([180.0, 180.156, 90.0])
    assert "1 cell of glucose in mmol/l, as the cell says." in record.notes
    alone = "time,BZ\n2024-03-13 08:00,180 mg/dl\n2024-03-13 08:05,90 mg/dl\n"
    record = read(alone, columns="time=time,glucose_mmol_l=BZ")
    assert record.frame["glucose_mg_dl"].to_list() == [180.0, 90.0]
    assert record.notes == ()


def test_the_insulin_of_a_day_is_no_rate_of_an_hour(read, refused):
    rows = [f"{START + n * timedelta(days=1):%Y-%m-%d %H:%M},{24 + n}" for n in range(4)]
    for name, words in (
        ("Basal (U/day)", "its name has 'U/day'"),
        ("Total basal", "its name has 'Total'"),
        ("Basal", "its basal rates make 600 U a day in the mean"),
    ):
        with naming(name):
            text = "\n".join([f"time,{name}", *rows])
            columns = f"time=time,basal_U_h={name}"
            assert words in refused(text, columns=columns)
            record = read(text, columns=columns, file_units="basal=U/day")
            assert [rate for _, rate in rates_of(record)] == pytest.approx([1.0, 25 / 24, 26 / 24, 27 / 24])


def test_columns_of_insulin_that_are_not_named_are_told(read):
    text = "time,glucose_mg_dl,Insulin,KH,note,Bolus\n2024-03-13 08:00,120,4,45,x,\n"
    assert read(text).notes == ("Not used, for they are not named: the columns 'Insulin', 'KH'.",)


def test_a_document_for_reading_is_called_so(refused):
    assert refused(b"%PDF-1.7\n%\xe2\xe3\n").startswith("it is a PDF, made for reading; export the data themselves")
    assert refused(r"{\rtf1\ansi a}").startswith("it is a document in RTF")
