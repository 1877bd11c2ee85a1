"""Commands made from declarations: a search that resumes, and a study that is carried out in one go."""

import dataclasses
import functools
import json
import sys
import tomllib
import types
from typing import Annotated, ClassVar

import polars as pl
import pytest

from glucoloop.cli import app
from glucoloop.cli.study_command import study_options
from glucoloop.component.base import Component
from glucoloop.component.setting import Option
from glucoloop.reporting.columns import Column, terminal_table, whole
from glucoloop.storage.results import Results
from glucoloop.storage.rows import Rows
from glucoloop.studies.catalogue import SAFETY, CommandEntry
from glucoloop.studies.study import PlainStudy, SearchStudy
from glucoloop.trials.trial import Trial

_search = functools.partial(Option, panel="Search")


class ExternalDoses(Component):
    """What the study asks for."""

    kind: ClassVar = "squares"

    factor: Annotated[int, _search("Factor of the squares.", at_least=1)] = 2
    steps: Annotated[int, _search("Number of steps.", at_least=1, at_most=100)] = 3


class Tried(Trial):
    """A trial of other people."""

    kind: ClassVar = "trial of others"
    refused: ClassVar = ("meals",)

    people: int = 7


FILES = ("squares.csv", "page.html")
WRITTEN = (*FILES, "tables.tex")
SEARCH = SearchStudy(
    name="squares", what="a search for squares", help="Squares.", module="a_study", request=ExternalDoses,
    extent=("steps",), results="rows.parquet", files=FILES, summary="squares.json",
)  # fmt: skip
PLAIN = PlainStudy(
    name="squares", what="squares", help="Squares.", module="a_study", request=ExternalDoses, unit="squares",
    files=FILES,
)  # fmt: skip
COLUMNS = (Column(name="square", short="Square", text=whole),)


class Squares(types.ModuleType):
    """The module of both studies; `made` counts the squares that were computed."""

    def __init__(self):
        super().__init__("a_study")
        self.made, self.stop_after, self.holds = [], None, True

    def notes(self, asked):
        return ("A square of a large factor is large.",) if asked.factor > 5 else ()

    def rows(self, asked):
        return Rows(
            file=SEARCH.results, what="squares", wanted=asked.steps, most=1000, schema={"square": pl.Int64},
            cells=lambda square: {"square": square}, row=lambda cells, before: cells["square"],
        )  # fmt: skip

    def search(self, asked):
        def missing(rows):
            for number in range(len(rows), asked.steps):
                if number == self.stop_after:
                    raise KeyboardInterrupt
                self.made.append(number)
                yield asked.factor * number**2

        return types.SimpleNamespace(missing=missing, results_of=lambda rows: self.summed(asked, rows))

    def amount(self, asked):
        return asked.steps

    def results_of(self, asked, progress):
        rows = []
        for row in self.search(asked).missing([]):
            rows.append(row)
            progress(1)
        return self.summed(asked, rows)

    def summed(self, asked, rows):
        table = pl.DataFrame({"square": list(rows)})
        told = {"rows": table.to_dicts(), "sum": sum(rows), "mean": float("nan"), "squares": len(rows)}
        return Results({**told, "holds": self.holds}, {"squares.csv": table})

    def tables(self, asked, found):
        yield terminal_table("Number", [("", [(str(n), [row]) for n, row in enumerate(found.rows)])], COLUMNS)

    def sentences(self, asked, found):
        yield f"The sum is {found.plain['sum']} and the mean {found.plain['mean']}."

    def files_of(self, asked, found):
        return {"page.html": b"<!doctype html>"}


@pytest.fixture
def squares(monkeypatch):
    """The module, at the place that the declarations name."""
    module = Squares()
    monkeypatch.setitem(sys.modules, "a_study", module)
    return module


@pytest.fixture
def made(squares, monkeypatch):
    """A function that makes the command of a study one of the program."""

    def make(study):
        monkeypatch.setattr(squares, "STUDY", study, raising=False)
        monkeypatch.setitem(app.STUDIES, study.name, CommandEntry("a_study:STUDY", SAFETY, study.help))
        return squares

    return make


def test_a_search_goes_on_where_it_was_and_farther(glucoloop, made, tmp_path):
    module = made(SEARCH)
    module.stop_after = 2
    first = glucoloop("squares", "--out", "a")
    assert first.code == 130
    assert "2 of 3 squares are kept, the same command goes on" in first.err
    module.stop_after = None
    again = glucoloop("squares", "--out", "a")
    assert again.code == 0
    assert "2 of 3 squares of a are there already; going on." in again.err
    assert module.made == [0, 1, 2]
    assert "The sum is 10 and the mean None." in again.out
    assert "Wrote squares.csv, page.html, tables.tex, squares.json, rows.parquet, squares.toml to a." in again.out
    names = {"SHA256SUMS", "origin.json", *WRITTEN, "squares.json", "rows.parquet", "squares.toml"}
    assert {file.name for file in (tmp_path / "a").iterdir()} == names

    finished = glucoloop("squares", "--out", "a", "--json")
    assert "nothing is computed again" in finished.err
    kept = json.loads((tmp_path / "a/squares.json").read_text())
    assert {key: value for key, value in finished.json.items() if key != "files"} == kept
    assert glucoloop("squares", "--out", "a").out == again.out
    assert module.made == [0, 1, 2]

    assert glucoloop("squares", "--config", "a/squares.toml", "--steps", 5, "--out", "a").code == 0
    assert module.made == [0, 1, 2, 3, 4]


def test_another_search_in_its_folder_is_refused(glucoloop, refused, made):
    made(SEARCH)
    assert glucoloop("squares", "--out", "a").code == 0
    assert "factor" in refused("squares", "--factor", 3, "--out", "a")
    assert glucoloop("squares", "--factor", 3, "--out", "a", "--overwrite").code == 0


def test_a_search_without_a_folder_keeps_nothing(glucoloop, refused, made, tmp_path):
    made(SEARCH)
    assert refused("squares").startswith("--out is missing; a search for squares is kept in a folder")
    made(dataclasses.replace(SEARCH, needs_folder=False))
    answer = glucoloop("squares", "--factor", 7)
    assert "The sum is 35" in answer.out
    assert "A square of a large factor is large." in answer.err
    assert "Nothing was written" in answer.out
    assert not list(tmp_path.iterdir())


def test_a_plain_study_writes_its_folder_whole_or_not_at_all(glucoloop, made, tmp_path):
    module = made(PLAIN)
    assert glucoloop("squares", "--out", "a").code == 0
    assert {file.name for file in (tmp_path / "a").iterdir()} == {
        "SHA256SUMS",
        *WRITTEN,
        "summary.json",
        "squares.toml",
    }
    assert glucoloop("squares", "--config", "a/squares.toml", "--json").json["sum"] == 10
    (tmp_path / "a/squares.toml").write_text("steps = 2\n[used]\nsteps = 2\nfactor = 5\n")
    other = glucoloop("squares", "--config", "a/squares.toml", "--out", "c")
    assert "a/squares.toml leaves out was filled in otherwise when it was written: factor was 5 and is 2." in other.err
    written = tomllib.loads((tmp_path / "c/squares.toml").read_text())
    assert {key: value for key, value in written.items() if key != "glucoloop"} == {
        "steps": 2,
        "used": {"factor": 2, "steps": 2},
    }
    module.stop_after = 1
    assert glucoloop("squares", "--out", "b").code == 130
    assert not (tmp_path / "b").exists()


def test_what_does_not_hold_leaves_with_1(glucoloop, made):
    module = made(PLAIN)
    module.holds = False
    assert glucoloop("squares").code == 1


def test_a_mistake_names_the_option(refused, made):
    made(SEARCH)
    assert refused("squares", "--steps", 0, "--out", "a").startswith("--steps is 0; ")


def test_options_are_those_of_the_settings_and_of_what_is_shared():
    for study in (PLAIN, SEARCH):
        assert {option.key for option in study_options(study)} == {
            *("factor", "steps", "config", "allow_code", "out", "overwrite", "json", "units")
        }
    trial = dataclasses.replace(
        SEARCH, request=Tried, option_texts={"help": {"seed": "A seed."}, "rare": {"days": True}}
    )
    options = {option.key: option for option in study_options(trial)}
    assert options.keys() >= {"people", "seed", "out"}
    assert "meals" not in options
    assert (options["people"].default, options["seed"].help) == ("7", "A seed.")
    assert (options["days"].rare, options["people"].rare) == (True, False)
    assert options.keys() >= {"noise", "dead_time", "sensor", "set"}
