"""Folders of work without a computation: trials that are made up, and rows that are numbers."""

import dataclasses

import polars as pl
import pytest

from glucoloop.storage.resumable import Work
from glucoloop.storage.rows import Rows, rows_folder
from pretend_trials import _make_trial, _pretend, _tiny  # noqa: F401


@dataclasses.dataclass(frozen=True)
class Numbers:
    """Work whose rows are numbers: what a study hands to the folder of rows, and nothing computed."""

    wanted: int = 3
    keys: dict = dataclasses.field(default_factory=lambda: {"seed": 1, "controller": [{"label": "a", "gain": 1.0}]})

    def work(self):
        return Work(
            command="count",
            what="count",
            keys={**self.keys, "rounds": self.wanted},
            final=("count.json",),
            may_change=frozenset({"rounds"}),
        )

    def rows(self):
        def row(cells, before):
            if cells["number"] != len(before):
                raise ValueError("not in order")
            return cells["number"]

        return Rows(
            file="numbers.parquet",
            what="numbers",
            wanted=self.wanted,
            most=100,
            schema={"number": pl.Int64},
            cells=lambda number: {"number": number},
            row=row,
        )

    def opened(self, path, *, overwrite=False):
        return rows_folder(path, self.work(), self.rows(), overwrite=overwrite)

    def run(self, path, *, overwrite=False):
        """What a command does."""
        with self.opened(path, overwrite=overwrite) as folder:
            if folder.finished:
                return
            for number in range(len(folder.rows), self.wanted):
                folder.add(number)
            folder.finish({"count.json": b"{}"})


@pytest.fixture(scope="session")
def counting():
    """Work whose rows are numbers; called with what differs."""
    return Numbers


@pytest.fixture
def _quick_disk(monkeypatch):
    """Nobody cuts the power in a test."""
    monkeypatch.setattr("os.fsync", lambda descriptor: None)
