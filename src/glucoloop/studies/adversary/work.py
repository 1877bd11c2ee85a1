"""Search for the worst errors in a folder, which keeps the harm of every sequence, generation by generation.

A search depends only on its seed and on these scores, so an interrupted one resumes by reading them again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.storage.resumable import Work
from glucoloop.storage.rows import Rows, RowsFolder
from glucoloop.studies.adversary.keys import Adversary
from glucoloop.studies.adversary.outcome import ErrorSearch, SearchOutcome, search_all
from glucoloop.studies.adversary.search import Generation

SUMMARY: Final = "adversary.json"
FINAL: Final = ("adversary.csv", "worst.parquet", "worst.pdf", "worst.png", "worst.svg", SUMMARY)
"""Written when all searches are done."""
_LONGEST: Final = 1000
"""Characters of the name of a search."""
_BETWEEN_S: Final = 5.0
"""Time between two writings of the scores, whose number grows."""


class Scores(NamedTuple):
    """A generation of a search."""

    search: str
    generation: int
    score: npt.NDArray[Any]
    """(lanes,) harm of each sequence."""


def work_of(asked: Adversary) -> Work:
    """Work of ``glucoloop adversary``."""
    return Work(command="adversary", what="search", keys=asked.keys(), given=asked.given, final=FINAL, summary=SUMMARY)


def rows_of(asked: Adversary) -> Rows[Scores]:
    """Rows that are kept: the scores of each generation."""
    most, lanes = {cell.name: cell.effort.generations for cell in asked.cells()}, asked.lanes

    def row(cells: Mapping[str, Any], before: Sequence[Scores]) -> Scores:
        found = Scores(cells["search"], cells["generation"], np.array(cells["score"], float))
        number = sum(of.search == found.search for of in before)
        if not found.generation == number < most.get(found.search, 0) or found.score.shape != (lanes,):
            raise Refusal("this is no generation of the search")
        return found

    return Rows(
        file="scores.parquet",
        what="generations",
        wanted=asked.generations,
        most=asked.generations,
        schema={"search": pl.String, "generation": pl.Int64, "score": pl.List(pl.Float64)},
        cells=lambda of: {**of._asdict(), "score": of.score.tolist()},
        row=row,
        width=lanes,
        longest_text=_LONGEST,
        every_s=_BETWEEN_S,
    )


def search_on(asked: Adversary, folder: RowsFolder[Scores] | None, done: Callable[[], None]) -> list[SearchOutcome]:
    """Complete the searches from the state of the folder, and keep each generation there.

    Parameters
    ----------
    asked : Adversary
    folder : RowsFolder, optional
    done : callable
        Called after each generation that was not there before.
    """
    before: dict[str, list[npt.NDArray[Any]]] = {}
    for row in () if folder is None else folder.rows:
        before.setdefault(row.search, []).append(row.score)
    known = {search: len(scores) for search, scores in before.items()}

    def told(cell: ErrorSearch, generation: Generation) -> None:
        if generation.number < known.get(cell.name, 0):
            return
        if folder is not None:
            folder.add(Scores(cell.name, generation.number, generation.score))
        done()

    return list(search_all(asked.groups(), asked.own.person, before=before, told=told))
