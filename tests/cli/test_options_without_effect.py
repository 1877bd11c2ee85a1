"""An option that changes nothing is noted on the terminal, in JSON and in the folder, once in each."""

import json

import pytest

MEAL = ("--meal", "50g@10min")


def test_the_note_is_on_the_terminal_in_json_and_in_the_folder(glucoloop, tmp_path):
    answer = glucoloop("run", "--announce-meals", "--duration", 60, *MEAL, "--out", "out", "--json")
    [note] = [text for text in answer.json["notes"] if "no effect" in text]
    assert note.startswith("--announce-meals has no effect: the controller mpc")
    assert answer.err.count(note) == 1
    assert note in json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))["notes"]
    shown = glucoloop("run", "--config", "out/run.toml")
    assert shown.err.count(note) == 1
    assert note not in shown.out


@pytest.mark.long
def test_an_exported_controller_has_the_note_in_its_manifest(glucoloop, tmp_path):
    answer = glucoloop("export", "--controller", "pid", "--announce-meals", "--samples", 6, "--out", "out", "--json")
    [note] = answer.json["notes"]
    assert note.startswith("--announce-meals has no effect: the controller pid")
    assert answer.err.count(note) == 1
    assert note in json.loads((tmp_path / "out" / "manifest.json").read_text(encoding="utf-8"))["notes"]
