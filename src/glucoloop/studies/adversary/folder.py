"""The folder of a search for the worst errors: what each generation did is kept, and a search goes on to the same bits.

``scores.parquet`` holds the harm of every sequence that was tried. A search rests on its seed and on these scores
alone, so one that was cut short is told them again and goes on.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.storage import disk
from glucoloop.storage.configured import ARITHMETIC, ConfiguredFolder
from glucoloop.storage.resumable import Layout, opened
from glucoloop.storage.tables import TableBounds, parquet, read_parquet
from glucoloop.studies.adversary.keys import Adversary

CONFIGURATION: Final = "adversary.toml"
SCORES: Final = "scores.parquet"
SUMMARY: Final = "adversary.json"
FINAL: Final = ("adversary.csv", "worst.parquet", "worst.pdf", "worst.png", "worst.svg", SUMMARY)
"""Written when all searches are done."""
_LAYOUT: Final = Layout(
    what="search", first=CONFIGURATION, files=(*FINAL, ARITHMETIC), done=SCORES, done_is_folder=False
)
_LONGEST: Final = 1000
"""Characters of the name of a search."""
_BETWEEN_S: Final = 5.0
"""Between two writings of the scores, of which more and more are written."""


class AdversaryFolder(ConfiguredFolder):
    """The folder of a search that this process may write to; see `adversary_folder`."""

    def __init__(self, path: Path, asked: Adversary) -> None:
        super().__init__(path, _LAYOUT, command="adversary", keys=asked.keys(), summary=SUMMARY)
        self._asked = asked
        self._scores: dict[str, list[npt.NDArray[Any]]] = {}
        self._written = time.monotonic()

    @property
    def scores(self) -> Mapping[str, list[npt.NDArray[Any]]]:
        """Harm of the sequences of each generation, by the name of the search."""
        return self._scores

    @property
    def done(self) -> int:
        """Generations that are done."""
        return sum(map(len, self._scores.values()))

    @property
    def anything_done(self) -> bool:
        """Whether there is a generation."""
        return bool(self._scores)

    @property
    def kept(self) -> str:
        """How many generations there are."""
        return f"{self.done} generations are kept"

    def add(self, search: str, score: npt.NDArray[Any]) -> None:
        """Keep the next generation of a search; what is kept is written every few seconds, and by `keep`.

        Raises
        ------
        ValueError
            If it cannot be written; those that are there stay.
        """
        self._scores.setdefault(search, []).append(score)
        if time.monotonic() - self._written > _BETWEEN_S:
            self.keep()

    def keep(self) -> None:
        """Write all scores."""
        self.put_file(SCORES, parquet(_table(self._scores)))
        self._written = time.monotonic()

    def create(self) -> None:
        """Say what the folder is about."""
        self._scores = {}
        super().create()

    def read_done(self) -> None:
        """Take up the scores."""
        place = self.path / SCORES
        if not disk.is_file(place):
            return
        most, lanes = {cell.name: cell.effort.generations for cell in self._asked.cells()}, self._asked.lanes
        bounds = TableBounds(least_rows=0, most_rows=sum(most.values()), columns=2 + lanes, longest_text=_LONGEST)
        try:
            table = read_parquet(place, bounds)
            found: dict[str, list[npt.NDArray[Any]]] = {}
            for row in table.select("search", "generation", "score").rows(named=True):
                score = np.array(row["score"], float)
                of_search = found.setdefault(row["search"], [])
                if not row["generation"] == len(of_search) < most.get(row["search"], 0) or score.shape != (lanes,):
                    raise ValueError
                of_search.append(score)
        except (pl.exceptions.PolarsError, ValueError, TypeError):
            raise ValueError(f"{place} is damaged; delete it and run the same command again") from None
        self._scores = found


def _table(scores: Mapping[str, list[npt.NDArray[Any]]]) -> pl.DataFrame:
    rows = [
        {"search": name, "generation": number, "score": score.tolist()}
        for name, of_search in scores.items()
        for number, score in enumerate(of_search)
    ]
    return pl.DataFrame(rows, schema={"search": pl.String, "generation": pl.Int64, "score": pl.List(pl.Float64)})


@contextlib.contextmanager
def adversary_folder(path: Path, asked: Adversary, *, overwrite: bool = False) -> Iterator[AdversaryFolder]:
    """Open the folder of a search, new or begun, for writing.

    Parameters
    ----------
    path : Path
    asked : Adversary
    overwrite : bool
        Begin again, whatever search the folder holds; the very same one that is not finished goes on.

    Raises
    ------
    ValueError
        If the place is taken by something else, by another search or by another run, or cannot be written to. A new
        folder is gone again if the block fails before a generation is done.
    """
    with opened(AdversaryFolder(path, asked), overwrite=overwrite) as folder:
        yield folder
