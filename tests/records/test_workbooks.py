"""Workbooks: the tables that readers know, and those that would take more memory than there is."""

import sys
import zipfile
from datetime import timedelta

import polars as pl
import pytest

import glucoloop as gl
from device_files import START, diasend, every, glucose, shanghai, tidepool_table
from glucoloop.records import read_people
from workbook_files import workbook

pytest.importorskip("python_calamine")


def values(record, column):
    return record.frame.filter(pl.col(column).is_not_null()).select("time", column).rows()


def minutes(number):
    return START + timedelta(minutes=number)


def test_shanghai(read):
    record = read(workbook({"Sheet1": shanghai(20)}))
    assert values(record, "glucose_mg_dl") == [(time, glucose(n)) for n, time in enumerate(every(15, 20))]
    assert values(record, "bolus_U") == [(minutes(30), 2.0), (minutes(45), 3.0), (minutes(75), 4.5)]
    assert values(record, "long_acting_U") == [(minutes(30), 14.0), (minutes(45), 7.0)]
    assert values(record, "basal_U_h") == [(START, 0.8), (minutes(90), 0.0), (minutes(120), 0.9)]
    assert record.rows == record.rows_used == 20
    notes = " ".join(record.notes)
    assert "1 meal told as foods" in notes
    assert "1 infusion of insulin into a vein" in notes
    assert "1 dose of premixed insulin" in notes


def test_diasend(read):
    record = read(workbook(diasend(20)))
    assert any(
        note.endswith("1 bolus is given over a time, in part or as a whole; bolus_min has that time.")
        for note in record.notes
    )
    sensor = record.frame.filter(pl.col("glucose_mg_dl").is_not_null())
    assert sensor["time"].to_list() == every(5, 20)
    assert sensor["glucose_mg_dl"].to_list() == pytest.approx([glucose(n) for n in range(20)], rel=2e-3)
    assert values(record, "bolus_U") == [(minutes(5), 4.5), (minutes(9), 2.0), (minutes(9), 4.0)]
    assert values(record, "bolus_min") == [(minutes(9), 120.0)]
    assert values(record, "carbs_g") == [(minutes(5), 45.0)]
    assert values(record, "basal_U_h") == [(START, 0.75)]
    assert record.left_out == {"finger pricks": 1}
    assert "1 file or table of the folder, ZIP or workbook that no reader knows: not read." in record.notes


def test_tidepool(read):
    head = ["Zulu Time", "Tidepool Data Type", "Local Time", "Timezone Offset", "Duration (mins)"]
    zulu = f"{START + timedelta(minutes=420):%Y-%m-%d %H:%M:%S}"
    sheets = {
        "EXPORT ERROR": [["An error occurred"]],
        "CGM": [line.split(",") for line in tidepool_table(20).splitlines()],
        "Bolus": [[*head, "Extended", "Normal"], [zulu, "bolus", None, -420, 90, 3.0, 2.0]],
        "Basal": [
            [*head, "Delivery Type", "Rate", "Percent", "Suppressed Rate"],
            [zulu, "basal", None, -420, 60, "temp", None, 0.5, 1.6],
        ],
    }
    record = read(workbook(sheets))
    assert values(record, "glucose_mg_dl") == [(time, glucose(n)) for n, time in enumerate(every(5, 20))]
    assert sorted(values(record, "bolus_U")) == [(START, 2.0), (START, 3.0)]
    assert values(record, "bolus_min") == [(START, 90.0)]
    assert values(record, "basal_U_h")[0] == (START, pytest.approx(0.8))


def test_a_zip_of_workbooks_and_a_folder_of_people(tmp_path):
    people = {name: workbook({"Sheet1": shanghai(count)}) for name, count in (("1001_0", 20), ("1002_0", 12))}
    folder = tmp_path / "people"
    folder.mkdir()
    for name, data in people.items():
        (folder / f"{name}.xlsx").write_bytes(data)
    (folder / "Summary.xlsx").write_bytes(workbook({"Sheet1": [["Patient Number", "Age (years)"], ["1001_0", 70]]}))
    records = read_people(folder)
    assert {name: record.rows for name, record in records.items()} == {"1001_0.xlsx": 20, "1002_0.xlsx": 12}
    packed = tmp_path / "packed.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("1001_0.xlsx", people["1001_0"])
    assert gl.read_record(packed).rows == 20


CORNERS = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
    '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>2</v></c></row>'
    "</sheetData></worksheet>"
)


@pytest.mark.parametrize(
    "data",
    [
        workbook({"Sheet1": CORNERS}),  # two cells, and a table of 17 thousand millions between them
        workbook({"Sheet1": shanghai(12)})[:900],
        workbook({"Sheet1": "<worksheet"}),
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600),
    ],
)
def test_a_workbook_that_cannot_be_opened_is_refused(refused, data):
    told = refused(data)
    assert "damaged, encrypted or too large" in told or "damaged or encrypted" in told


def test_without_the_library_the_extra_is_named(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    assert "install it with: pip install 'glucoloop[xlsx]'" in refused(workbook({"Sheet1": shanghai(12)}))


def test_signs_within_cells_divide_nothing(read):
    rows = shanghai(12)
    rows[3][4] = 'a\ttab, a "quote"\nand a line'
    assert read(workbook({"Sheet1": rows})).rows == 12


def test_a_table_whose_columns_are_named(read):
    rows = [["Zeit", "BZ"], *([time, glucose(n)] for n, time in enumerate(every(15, 12)))]
    record = read(workbook({"Tagebuch": rows}), columns="time=Zeit,glucose_mg_dl=BZ")
    assert values(record, "glucose_mg_dl") == [(time, glucose(n)) for n, time in enumerate(every(15, 12))]
