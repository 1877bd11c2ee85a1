"""``glucoloop adversary``."""

import json

import polars as pl
import pytest

from glucoloop.studies.adversary import study

SMALL = (
    *("adversary", "--controller", "pid", "--guards", "without", "--error", 30, "--duration", 120, "--people", 3),
    *("--generations", 3, "--starts", 1, "--sequences", 4),
)


class Once:
    """A search that is carried out once for all tests; `stop_after` generations it is interrupted."""

    known, stop_after = {}, None

    def __init__(self, asked):
        self.key = repr(asked)
        if self.key not in self.known:
            whole = SEARCH(asked)
            self.known[self.key] = list(whole.missing([])), whole

    def missing(self, rows):
        for number, row in enumerate(self.known[self.key][0]):
            if number == self.stop_after:
                raise KeyboardInterrupt
            if number >= len(rows):
                yield row

    def results_of(self, rows):
        return self.known[self.key][1].results_of(rows)


SEARCH = study._AdversarySearch


@pytest.fixture(autouse=True)
def _search_once(monkeypatch):
    monkeypatch.setattr(study, "search", Once)


def test_a_folder_holds_the_worst_loops_and_repeats_the_search(glucoloop, tmp_path):
    answer = glucoloop(*SMALL, "--out", "worst")
    assert answer.code == 0
    assert "Wrote" in answer.out
    told = json.loads((tmp_path / "worst" / "adversary.json").read_text())
    (row,) = told["searches"]
    assert (row["controller"], row["guarded"], row["error_pct"], row["sequences_tried"]) == ("pid", False, 30.0, 12)
    assert row["lowest_mg_dl"] <= row["lowest_without_errors_mg_dl"]
    assert told["engines"] == {"pid": {"engine": "native"}}
    assert "Engine: native code." in answer.out
    loop = pl.read_parquet(tmp_path / "worst" / "worst.parquet")
    assert loop.height == 24
    assert (loop["error_of_reading_pct"].abs() <= 30.0 + 1e-9).all()
    again = glucoloop("adversary", "--config", "worst/adversary.toml", "--json")
    assert again.json["searches"] == told["searches"]
    finished = glucoloop(*SMALL, "--out", "worst")
    assert "finished before" in finished.err
    assert finished.out == answer.out


def test_a_search_that_was_cut_short_goes_on_to_the_same_files(glucoloop, monkeypatch, tmp_path):
    glucoloop(*SMALL, "--out", "whole")
    monkeypatch.setattr(Once, "stop_after", 2)
    answer = glucoloop(*SMALL, "--out", "cut")
    assert answer.code == 130
    assert "2 of 3 generations are kept, the same command goes on" in answer.err
    monkeypatch.setattr(study, "search", SEARCH)
    answer = glucoloop(*SMALL, "--out", "cut")
    assert "2 of 3 generations of cut are there already; going on." in answer.err
    for name in ("adversary.csv", "adversary.toml", "scores.parquet", "worst.parquet"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--error", "100"), "--error"),
        (("--guards", "some"), "--guards"),
        (("--hold", "7"), "a time for which an error holds of 7 min"),
        (("--overwrite",), "--overwrite is about an output folder"),
    ],
)
def test_mistakes_are_told_in_a_sentence(refused, arguments, told):
    assert told in refused("adversary", "--controller", "pid", *arguments)
