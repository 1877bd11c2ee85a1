"""The folder of a search: its candidates are kept as they come, and a search that was cut short goes on.

``candidates.parquet`` is put in its place anew after each candidate. At the end the list of digests appears, which
marks a search as finished; one that is given more rounds goes on from there.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

from glucoloop.storage import disk
from glucoloop.storage.configured import ARITHMETIC, ConfiguredFolder
from glucoloop.storage.resumable import Layout, opened
from glucoloop.storage.tables import TableBounds, parquet, read_parquet
from glucoloop.studies.robust import OBJECTIVES, Candidate, Search
from glucoloop.studies.robust.keys import HowFar, Robust

CONFIGURATION: Final = "robust.toml"
CANDIDATES: Final = "candidates.parquet"
SUMMARY: Final = "robust.json"
FINAL: Final = ("best.toml", "candidates.csv", "check.parquet", "front.pdf", "front.png", "front.svg", SUMMARY)
"""Written when all rounds are done."""
_MOST_CANDIDATES: Final = 1_000_000
_LAYOUT: Final = Layout(
    what="search", first=CONFIGURATION, files=(*FINAL, ARITHMETIC), done=CANDIDATES, done_is_folder=False
)


class RobustFolder(ConfiguredFolder):
    """The folder of a search that this process may write to; see `robust_folder`."""

    def __init__(self, path: Path, asked: Robust) -> None:
        super().__init__(
            path, _LAYOUT, command="robust", keys=asked.keys(), summary=SUMMARY, may_change=HowFar.model_fields
        )
        self.asked = asked
        self.candidates: list[Candidate] = []

    @property
    def anything_done(self) -> bool:
        """Whether there is a candidate."""
        return bool(self.candidates)

    @property
    def kept(self) -> str:
        """How many candidates there are."""
        return f"{len(self.candidates)} candidates are kept"

    def add(self, candidate: Candidate) -> None:
        """Keep a candidate.

        Raises
        ------
        ValueError
            If it cannot be written; those that are there stay.
        """
        together = [*self.candidates, candidate]
        self.put_file(CANDIDATES, parquet(candidate_table(self.asked.search, together)))
        self.candidates = together

    def create(self) -> None:
        """Say what the folder is about."""
        self.candidates = []
        super().create()

    def read_done(self) -> None:
        """Take up the candidates."""
        if not disk.is_file(self.path / CANDIDATES):
            return
        rounds, batch = self.asked.far.rounds, self.asked.search.batch
        candidates = read_candidates(self.path / CANDIDATES, self.asked.search)
        if len(candidates) > rounds * batch:
            told = f"{rounds} round of {batch} is" if rounds == 1 else f"{rounds} rounds of {batch} are"
            raise ValueError(
                f"{self.path} holds {len(candidates)} candidates, and {told} fewer; "
                "ask for more rounds, or choose another folder with --out"
            )
        self.candidates = candidates


@contextlib.contextmanager
def robust_folder(path: Path, asked: Robust, *, overwrite: bool = False) -> Iterator[RobustFolder]:
    """Open the folder of a search, new or begun, for writing.

    Parameters
    ----------
    path : Path
    asked : Robust
    overwrite : bool
        Begin again, whatever search the folder holds; the very same one that is not finished goes on.

    Raises
    ------
    ValueError
        If the place is taken by something else, by another search or by another run, or cannot be written to. A new
        folder is gone again if the block fails before a candidate is done.
    """
    with opened(RobustFolder(path, asked), overwrite=overwrite) as folder:
        yield folder


def candidate_table(search: Search, candidates: Sequence[Candidate]) -> pl.DataFrame:
    """One row per candidate: its number and round, its tuning, and its objectives, null where they are no numbers."""
    columns: dict[str, Any] = {
        "candidate": [of.number for of in candidates],
        "round": [of.number // search.batch for of in candidates],
        **{tuned.name: [of.tuning[tuned.name] for of in candidates] for tuned in search.space},
    }
    told = {o.column: [of.scores[name] for of in candidates] for name, o in OBJECTIVES.items()}
    schema = dict.fromkeys((*(tuned.name for tuned in search.space), *told), pl.Float64)
    table = pl.DataFrame({**columns, **told}, schema_overrides=schema)
    return table.with_columns(pl.col(list(told)).fill_nan(None))


def read_candidates(place: Path, search: Search) -> list[Candidate]:
    """The candidates of a table.

    Raises
    ------
    ValueError
        If it is not what was written.
    """
    bounds = TableBounds(least_rows=0, most_rows=_MOST_CANDIDATES, columns=len(search.space) + len(OBJECTIVES) + 2)
    try:
        table = read_parquet(place, bounds)
        rows = table.select(candidate_table(search, ()).columns).rows(named=True)
        if [row["candidate"] for row in rows] != list(range(len(rows))):
            raise ValueError
    except (pl.exceptions.PolarsError, ValueError, OSError):
        raise ValueError(f"{place} is damaged; delete it and run the same command again") from None
    return [
        Candidate(
            number=row["candidate"],
            tuning={of.name: row[of.name] for of in search.space},
            scores={name: _number(row[o.column]) for name, o in OBJECTIVES.items()},
        )
        for row in rows
    ]


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
