"""No name and no serial number leaves a file, wherever in it they stand: in cells, names of columns, or the file's."""

import json
import re

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

import glucoloop as gl
from device_files import FILES, NAME, SERIAL, SURNAME
from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.series import Readings
from glucoloop.reporting.record_groups import GOALS, ReportedRecord
from glucoloop.reporting.record_page import record_page

PLANTED = "Vorderbrandner"
SECRETS = (PLANTED, NAME, SURNAME, SERIAL)
PARTS = {"nightscout": r'"[^"]*"', "tidepool": r'"[^"]*"', "ohio": r"'[^']*'|\"[^\"]*\"", "carelink": r"[^;\n]+"}
"""Pattern of a part of a file in whose place, or at whose end, a name may stand; by default a cell between commas."""


def planted(text, pattern, places, whole):
    """A text with the name in some of its parts, in place of them or after what they hold."""
    parts = list(re.finditer(pattern, text))
    for number in sorted({place % len(parts) for place in places}, reverse=True):
        start, end = parts[number].span()
        quote = text[start] if text[start] in "\"'" else ""
        kept = "" if whole else text[start:end].strip(quote or None)
        text = f"{text[:start]}{quote}{kept}{PLANTED}{quote}{text[end:]}"
    return text


def told_of(record, path):
    """Everything that a record, and the report on it, tell."""
    record.write_parquet(path)
    told = [record.frame.write_csv(), json.dumps([record.left_out, record.notes]), path.read_bytes().decode("latin-1")]
    read = record.frame.drop_nulls("glucose_mg_dl")
    if read["time"].n_unique() > 1:
        readings = Readings.of_times(read["time"].to_numpy(), read["glucose_mg_dl"].to_numpy())
        told.append(record_page([ReportedRecord("x", readings, numbers_of(readings), record.notes)], GOALS["adult"]))
    return "".join(told)


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(places=st.sets(st.integers(0, 5000), min_size=1, max_size=6), whole=st.booleans())
def test_no_name_or_serial_number_leaves_a_file(tmp_path, name, places, whole):
    path = tmp_path / "export"
    path.write_text(planted(FILES[name], PARTS.get(name, r"[^,\n]+"), places, whole), encoding="utf-8")
    assert any(secret in path.read_text() for secret in SECRETS)
    try:
        told = told_of(gl.read_record(path), tmp_path / "record.parquet")
    except gl.Refusal as refusal:
        told = str(refusal)
    assert not [secret for secret in SECRETS if secret in told]


def test_a_refusal_for_the_report_has_no_name_of_a_file(tmp_path):
    path = tmp_path / f"{NAME}.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(gl.records.FileRefusal) as refusal:
        gl.read_record(path)
    assert NAME in str(refusal.value)
    assert NAME not in refusal.value.why
