"""``glucoloop league``."""

import json
import re

import polars as pl
import pytest

from glucoloop.studies.league import study

SMALL = (
    *("--people", 4, "--patient", "kanderian-2009", "--scenario", "plain-day"),
    *("--sensor", "white-noise, variance=1.45", "--controller", "mpc", "--controller", "imc"),
)
WITHOUT = (*SMALL, "--rescue", "none")  # as the best doses are searched


@pytest.mark.long
def test_interrupted_or_not_and_from_its_file_a_league_is_the_same_to_the_bit(glucoloop, monkeypatch, tmp_path):
    first = glucoloop("league", *SMALL, "--out", "a")
    assert first.code == 0, first.err
    names = {"SHA256SUMS", "origin.json", "summary.json", "people.parquet", "league.toml"}
    drawn = {"league.html", "figure.pdf", "figure.png", "figure.svg", "tables.tex"}
    assert {file.name for file in (tmp_path / "a").iterdir()} == {*names, *drawn, "league.csv", "league.parquet"}
    assert re.search(r"3 loops to design and compile, and \d+ patient-days; if that takes long", first.err)
    # a pair that does not go together is named with its reason, and the others are there
    assert "mpc takes no part on kanderian-2009 in 1 cell (white-noise, variance=1.45, plain-day)" in first.out
    assert "it cannot be distinguished from 0" in first.out
    table = pl.read_parquet(tmp_path / "a/league.parquet")
    assert table["people"].to_list() == [0, 4, 4] * 2
    assert pl.read_csv(tmp_path / "a/league.csv").height == table.height
    assert table.filter(controller="basal-bolus")["gri_difference"].to_list() == [0.0, 0.0]

    calls = []

    def interrupted(*arguments, **others):
        calls.append(arguments)
        if len(calls) > 1:
            raise KeyboardInterrupt
        return run_people(*arguments, **others)

    run_people = study.run_people
    with monkeypatch.context() as patch:
        patch.setattr(study, "run_people", interrupted)
        cut = glucoloop("league", *SMALL, "--out", "b")
    assert cut.code == 130
    assert "2 of 3 shards are kept, the same command goes on" in cut.err  # one of them a refusal
    again = glucoloop("league", *SMALL, "--out", "b")
    assert again.code == 0
    assert "2 of 3 shards of b are there already; going on." in again.err
    given_up = []
    with monkeypatch.context() as patch:  # after each loop the programs are given up
        patch.setattr(study, "_KEPT_LOOPS", 1)
        give_up = study._give_up_programs
        patch.setattr(study, "_give_up_programs", lambda: given_up.append(give_up()))
        assert glucoloop("league", "--config", "a/league.toml", "--out", "c").code == 0
    assert len(given_up) == 2
    sums = [(tmp_path / name / "SHA256SUMS").read_text() for name in "abc"]
    assert sums[0] == sums[1] == sums[2]

    read = glucoloop("league", *SMALL, "--out", "a", "--json")
    assert "nothing is computed again" in read.err
    kept = json.loads((tmp_path / "a/summary.json").read_text())
    assert {key: value for key, value in read.json.items() if key != "files"} == kept
    assert [of["family"] for of in kept["rankings"]] == ["kanderian-2009"]


@pytest.mark.long
def test_best_doses_are_added_to_a_finished_league_with_nothing_computed_again(glucoloop, tmp_path):
    assert glucoloop("league", *WITHOUT, "--out", "a").code == 0
    more = glucoloop("league", *WITHOUT, "--bound", 1, "--out", "a")
    assert more.code == 0, more.err
    assert "and the best doses of 1 patient-days to search for" in more.err
    assert "3 of 5 shards of a are there already; going on." in more.err
    assert glucoloop("league", *WITHOUT, "--bound", 1, "--out", "b", "--json").code == 0
    assert (tmp_path / "a/SHA256SUMS").read_text() == (tmp_path / "b/SHA256SUMS").read_text()
    table = pl.read_csv(tmp_path / "a/league.csv")
    assert table["same_people"].to_list() == [0, 1, 1] * 2
    assert table.filter(table["same_people"] > 0)["gri_above_advance"].min() >= 0.0
    assert "Distance to what could be reached" in (tmp_path / "a/league.html").read_text()
    assert "is fewer; ask for more" in glucoloop("league", *WITHOUT, "--out", "a").err


def test_a_league_is_kept_in_a_folder_and_refuses_in_a_sentence(refused):
    assert refused("league").startswith("--out is missing; a league is kept in a folder")
    assert "unknown controller 'nobody'" in refused("league", "--controller", "nobody", "--out", "a")
    assert "--patient 'hovorka-2004' is given twice" in refused(
        "league", "--patient", "hovorka-2004", "--patient", "hovorka-2004", "--out", "a"
    )
    assert refused("league", "--people", 1, "--out", "a").startswith("--people is 1")
