"""Tables of several people."""

import pytest

import glucoloop as gl
from device_files import every, glucose
from glucoloop.records import read_people


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
