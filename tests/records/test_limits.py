"""Small files that would take much memory or time are refused before they do."""

import os

import pytest

import glucoloop as gl
from device_files import FILES, clarity
from glucoloop.records import file_text


def test_too_many_columns_are_refused(refused):
    head = "time,glucose_mg_dl," + ",".join(f"x{n}" for n in range(60_000))
    told = refused(head + "\n2024-03-13 00:00,100" + "," * 60_000 + "\n")
    assert told == "it has 60002 columns, and at most 1000 can be read; leave some out, or divide it"


def test_too_many_objects_in_json_are_refused(refused):
    data = b"[" + b"{}," * 11_000_000 + b"{}]"
    assert refused(data) == "it has 11000002 objects and lists, and at most 10000000 can be read; divide it"


@pytest.mark.parametrize(
    ("name", "most", "what"),
    [
        ("_MAX_GROUPS", 10, "objects and lists"),
        ("_MAX_VALUES", 10, "values"),
        ("MAX_ROWS", 10, "entries"),
    ],
)
def test_bounds_of_json(monkeypatch, refused, name, most, what):
    monkeypatch.setattr(file_text, name, most)
    assert f" {what}, and at most {most} can be read; divide it" in refused(FILES["nightscout"])


@pytest.mark.parametrize(("name", "what"), [("MAX_ROWS", "lines"), ("MAX_CELLS", "cells")])
def test_bounds_of_tables(monkeypatch, refused, name, what):
    monkeypatch.setattr(file_text, name, 20)
    assert f" {what}, and at most 20 can be read; leave some out, or divide it" in refused(clarity(30))


def test_too_many_sections_of_carelink_are_refused(refused):
    section = "-------\nIndex,Date,Time,Sensor Glucose (mg/dL)\n1,2024/03/13,00:00:00,100\n"
    assert refused(section * 200) == "it has more than 100 sections of devices; divide it"


def test_too_many_elements_of_xml_are_refused(monkeypatch, refused):
    monkeypatch.setattr(file_text, "_MAX_GROUPS", 10)
    assert refused(FILES["ohio"]).endswith("elements of XML, and at most 10 can be read; divide it")


@pytest.mark.long
def test_two_rows_far_apart_and_a_profile_of_many_steps_are_refused(refused, read):
    steps = ",".join(f'{{"time": "{m // 60:02}:{m % 60:02}", "value": {m % 7}}}' for m in range(1440))
    profile = f'[{{"defaultProfile": "x", "store": {{"x": {{"basal": [{steps}]}}}}}}]'
    meals = '[{"eventType": "Meal Bolus", "created_at": "%s-01-02T00:00:00Z", "insulin": 1}'
    far = "[" + (meals % 1971)[1:] + "," + (meals % 2198)[1:] + "]"
    with pytest.raises(gl.Refusal, match="would change more than 1000000 times"):
        read(far, profile)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders there")
def test_a_pipe_within_a_folder_of_people_is_one_that_was_not_read(tmp_path):
    from glucoloop.studies.record_report import RecordRequest
    from glucoloop.studies.record_report.sources import read, sources_of

    (tmp_path / "people").mkdir()
    (tmp_path / "people" / "a.csv").write_text(clarity(30))
    os.mkfifo(tmp_path / "people" / "b.csv")
    asked = RecordRequest(files=(str(tmp_path / "people"),))
    good, pipe = sources_of(asked)
    assert len(list(read(good, asked))) == 1
    with pytest.raises(gl.Refusal, match="it is a pipe, not a file"):
        list(read(pipe, asked))
