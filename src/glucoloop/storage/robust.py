"""The folder of a search: its candidates are kept as they come, and a search that was cut short goes on.

``candidates.parquet`` is put in its place anew after each candidate. At the end the list of digests appears, which
marks a search as finished; one that is given more rounds goes on from there.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

import glucoloop
from glucoloop import arithmetic
from glucoloop.config.robust import HowFar, Robust
from glucoloop.config.toml import read_toml, toml_text
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import kept_text
from glucoloop.storage.resumable import Layout, ResumableFolder, opened
from glucoloop.storage.strict_json import json_text
from glucoloop.storage.tables import TableBounds, parquet, read_parquet
from glucoloop.trials.robust import OBJECTIVES, Candidate, Search

CONFIGURATION: Final = "robust.toml"
ARITHMETIC: Final = "arithmetic.json"
CANDIDATES: Final = "candidates.parquet"
SUMMARY: Final = "robust.json"
FINAL: Final = ("best.toml", "candidates.csv", "check.parquet", "front.pdf", "front.png", "front.svg", SUMMARY)
"""Written when all rounds are done."""
_MOST_CANDIDATES: Final = 1_000_000
_LAYOUT: Final = Layout(
    what="search", first=CONFIGURATION, files=(*FINAL, ARITHMETIC), done=CANDIDATES, done_is_folder=False
)


class RobustFolder(ResumableFolder):
    """The folder of a search that this process may write to; see `robust_folder`."""

    def __init__(self, path: Path, asked: Robust) -> None:
        super().__init__(path, _LAYOUT)
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

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Put the files about the whole search in their places, the digests of all files last."""
        for name, data in files.items():
            self.put_file(name, data)
        names = (CONFIGURATION, ARITHMETIC, CANDIDATES, *files)
        self.put_file(SUMS, disk.sums_text({name: disk.digest(self.path / name) for name in names}))

    def summary(self) -> dict[str, Any]:
        """The summary of a finished search, as it was written."""
        found: dict[str, Any] = json.loads(kept_text(self.path / SUMMARY, "the summary of a search"))
        return found

    def create(self) -> None:
        """Say what the folder is about."""
        self.candidates = []
        self._write_what()

    def load(self) -> None:
        """Take up the candidates of the same search; one that goes further makes anew what rests on how far."""
        place = self.path / CONFIGURATION
        there, version = read_toml(kept_text(place, "a configuration"), str(place))
        self._refuse_another(there, version)
        candidates = self._read_candidates()
        finished = self._is_whole(there)
        if not finished:
            self._refuse_other_arithmetic(anything_done=bool(candidates))
        self.candidates = candidates
        if not finished:
            disk.remove(self.path / SUMS)
            self._write_what()

    def refuse_foreign_parts(self) -> None:
        """Candidates are one file, in which nothing else can be."""

    def _write_what(self) -> None:
        files = {
            CONFIGURATION: toml_text(self.asked.keys(), f"robust --config {CONFIGURATION}").encode(),
            ARITHMETIC: (json_text(arithmetic.identity()) + "\n").encode(),
        }
        for name, data in files.items():
            if not (disk.is_file(self.path / name) and disk.read_bytes(self.path / name) == data):
                disk.put_file(self.path / name, data)

    def _read_candidates(self) -> list[Candidate]:
        if not disk.is_file(self.path / CANDIDATES):
            return []
        rounds, batch = self.asked.far.rounds, self.asked.search.batch
        candidates = read_candidates(self.path / CANDIDATES, self.asked.search)
        if len(candidates) > rounds * batch:
            told = f"{rounds} round of {batch} is" if rounds == 1 else f"{rounds} rounds of {batch} are"
            raise ValueError(
                f"{self.path} holds {len(candidates)} candidates, and {told} fewer; "
                "ask for more rounds, or choose another folder with --out"
            )
        return candidates

    def _refuse_another(self, there: Mapping[str, Any], version: str | None) -> None:
        if version != glucoloop.__version__:
            raise ValueError(
                f"{self.path} was begun by glucoloop {version}, and this is {glucoloop.__version__}; "
                f"go on with {version}, or choose another folder with --out"
            )
        here = {key: value for key, value in self.asked.keys().items() if value is not None}
        for key in dict.fromkeys([*here, *there]):
            if key not in HowFar.model_fields and json_text(here.get(key)) != json_text(there.get(key)):
                before, now = (_shown(keys.get(key)) for keys in (there, here))
                raise ValueError(
                    f"{self.path} holds another search: {key} is {before} there and {now} here; choose another folder "
                    "with --out, or add --overwrite to replace it"
                )

    def _refuse_other_arithmetic(self, *, anything_done: bool) -> None:
        if not anything_done:
            return
        try:
            there = json.loads(kept_text(self.path / ARITHMETIC, "a record of the arithmetic"))
            found = arithmetic.difference({name: str(of) for name, of in there.items()}, arithmetic.identity())
        except (ValueError, AttributeError, RecursionError):
            raise ValueError(
                f"{self.path / ARITHMETIC} is damaged or gone, so it is not known how the candidates were computed; "
                "choose another folder with --out, or add --overwrite to begin again"
            ) from None
        if found is not None:
            name, before, now = found
            raise ValueError(
                f"{self.path} was computed with {name} {before}, and here it is {now}, which does not give the same "
                "bits; go on as before, choose another folder with --out, or add --overwrite to begin again"
            )

    def _is_whole(self, there: Mapping[str, Any]) -> bool:
        """Whether all is there, for as many rounds as are asked for; ValueError if something was changed."""
        if not disk.is_file(self.path / SUMS):
            return False
        sums, far = disk.read_sums(self.path), self.asked.far.model_dump(mode="json")
        self.refuse_changed(sums)
        whole = all(name in _LAYOUT.names and disk.is_file(self.path / name) for name in sums)
        complete = {CONFIGURATION, ARITHMETIC, CANDIDATES} <= sums.keys()
        return whole and complete and all(there.get(key) == value for key, value in far.items())


def _shown(value: object) -> object:
    return "not given" if value is None else value


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
