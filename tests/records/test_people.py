"""Tables of several people, and files of several in one folder."""

import zipfile

import pytest

import glucoloop as gl
from device_files import every, glucose
from glucoloop.records import read_people


def table_of(people, name="id", rows=60):
    lines = [f"{name},time,gl"]
    for who in people:
        lines += [f"{who},{time:%Y-%m-%d %H:%M},{glucose(n)}" for n, time in enumerate(every(5, rows))]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    "name",
    ["id", "PtID", "Subject ID", "patient_id", "participant", "USUBJID", "ID_Patient", "Kennung", "sujeto", "Patiënt"],
)
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


def test_files_of_people_by_the_number_in_their_names(tmp_path):
    for who in (2301, 2302):
        dose, reading = f"2024-03-13 01:00,{who - 2299}", [f"{time:%d/%m/%Y %H:%M},5.5" for time in every(5, 40)]
        (tmp_path / f"Glucose{who}.csv").write_text("\n".join(["bg_ts,value", *reading]))
        (tmp_path / f"Bolus{who}.csv").write_text(f"bolus_ts,bolus_dose\n{dose}\n")
    people = read_people(tmp_path)
    assert {who: (record.rows, record.frame["bolus_U"].sum()) for who, record in people.items()} == {
        "2301": (41, 2.0),
        "2302": (41, 3.0),
    }
    archive = tmp_path / "all.zip"
    with zipfile.ZipFile(archive, "w") as files:
        for path in tmp_path.glob("*.csv"):
            files.write(path, path.name)
    assert {who: record.rows for who, record in read_people(archive).items()} == {"2301": 41, "2302": 41}
    (tmp_path / "Bolus2303.csv").write_text(f"bolus_ts,bolus_dose\n{dose}\n")
    archive.unlink()
    with pytest.raises(gl.Refusal, match="2 of the files have readings and 3 have none"):
        read_people(tmp_path)
