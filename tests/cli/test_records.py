"""``glucoloop records``: files in, a record out, and everything told that was changed or left out."""

from datetime import datetime

import pytest

import glucoloop as gl
from device_files import NAME, SERIAL, START, SURNAME, clarity, libre, nightscout_entries, nightscout_treatments


@pytest.fixture
def put(tmp_path):
    """Names of files with these texts."""

    def put(*texts):
        names = [f"export-{number}" for number in range(len(texts))]
        for name, text in zip(names, texts, strict=True):
            (tmp_path / name).write_text(text, encoding="utf-8")
        return names

    return put


def test_a_record_is_told_written_and_read_back(glucoloop, put, tmp_path):
    answer = glucoloop("records", *put(clarity(20)), "--out", "record.parquet")
    assert answer.code == 0
    assert answer.out.startswith("20 of 24 rows are used, from 2024-03-13 00:03:00 to 2024-03-13 01:38:00.")
    assert "Left out: rows about the patient and the devices (4)." in answer.out
    assert answer.out.endswith("Wrote record.parquet.\n")
    assert not [secret for secret in (NAME, SURNAME, SERIAL) if secret in answer.out + answer.err]
    assert gl.read_record(tmp_path / "record.parquet").frame.height == 20
    again = glucoloop("records", "record.parquet", "--json").json
    assert (again["rows"], again["rows_used"], again["values"]["glucose_mg_dl"]) == (24, 20, 20)


def test_files_of_one_person_are_read_together(glucoloop, put):
    treatments = nightscout_treatments((START, {"eventType": "Bolus", "insulin": 1.5}))
    told = glucoloop("records", *put(nightscout_entries(12), treatments), "--time-zone", "Europe/Berlin", "--json").json
    none = dict.fromkeys(("carbs_g", "long_acting_U", "basal_U_h", "glucagon_ug"), 0)
    assert told["values"] == {"glucose_mg_dl": 12, "bolus_U": 1, **none}
    assert (told["sums"], told["ranges"]["bolus_U"]) == ({"bolus_U": 1.5}, [1.5, 1.5])
    assert told["first"] == "2024-03-13 00:03:00"


def test_what_a_file_leaves_open_is_asked_for(glucoloop, refused, put):
    [name] = put(libre(5, start=datetime(2024, 3, 4)))
    assert refused("records", name).endswith("dates=day-first or dates=month-first (--dates).")
    assert glucoloop("records", name, "--dates", "day-first").code == 0


def test_mistakes_are_sentences(refused, put):
    assert refused("records") == "FILE... is missing; see glucoloop records --help."
    assert refused("records", "nothing.csv").startswith("nothing.csv: it cannot be read: No such file or directory")
    [name] = put(clarity(5))
    assert refused("records", name, "--reader", "dexcom").startswith("unknown reader 'dexcom'; did you mean")
    assert refused("records", name, "--columns", "time").startswith("columns are 'time'; give them like time=Zeit")
    assert refused("records", name, "--out", name).startswith(f"{name} is there already; choose another file")


def test_readers_are_listed(glucoloop):
    told = glucoloop("list", "readers").out
    for name in ("dexcom-clarity", "libreview", "carelink", "nightscout", "tidepool", "ohio-t1dm", "table"):
        assert f"  {name} " in told
