"""Findings that were read back are those of the study, or are refused in a sentence."""

import json
from types import SimpleNamespace

import pytest
from rich.table import Table

from glucoloop import Refusal
from glucoloop.cli.study_command import StudyOutcome, _StudyRun
from glucoloop.storage.results import Results


def tables(config, results):
    table = Table("Name", "Value")
    for row in results.rows:
        table.add_row(row["name"], f"{row['value']:.1f}")
    yield table


RUN = _StudyRun(
    study=SimpleNamespace(name="test"),
    output=SimpleNamespace(json=False, out=None),
    module=SimpleNamespace(tables=tables, sentences=lambda config, results: [f"{len(results.rows)} rows."]),
    config=None,
    without_effect=(),
)
WHOLE = {"version": "0", "rows": [{"name": "a", "value": 1.5}], "notes": ["A note."]}


def read(tmp_path, plain):
    place = tmp_path / "test.json"
    place.write_text(plain if isinstance(plain, str) else json.dumps(plain))
    return Results.read(place)


def test_whole_findings_are_shown_again(tmp_path, capsys):
    StudyOutcome(RUN, read(tmp_path, WHOLE), {}, "").print()
    assert "1.5" in capsys.readouterr().out


@pytest.mark.parametrize(
    "changed",
    [
        {"rows": None},
        {"rows": [1]},
        {"rows": [{}]},
        {"rows": [{"name": "a", "value": "x"}]},
        {"rows": [{"name": 1, "value": "1.5"}]},
        {"notes": 1},
        {"notes": [1]},
    ],
)
def test_findings_of_another_form_are_refused(tmp_path, capsys, changed):
    with pytest.raises(Refusal, match=r"test\.json does not hold what this study finds; move it away"):
        StudyOutcome(RUN, read(tmp_path, {**WHOLE, **changed}), {}, "").print()


@pytest.mark.parametrize("text", ["", "[]", "[" * 5000, '{"rows": NaN}', '{"rows": 1, "rows": 2}', '{"a": "\\ud800"}'])
def test_a_file_of_no_findings_is_refused(tmp_path, text):
    with pytest.raises(Refusal, match=r"test\.json is damaged"):
        read(tmp_path, text)


def test_a_bug_stays_a_bug(capsys):
    with pytest.raises(KeyError):
        StudyOutcome(RUN, Results({"rows": [{}]}), {}, "").print()
