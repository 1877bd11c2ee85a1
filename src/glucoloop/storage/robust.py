"""The folder of a search: its candidates are kept as they come, and a search that was cut short goes on.

``candidates.parquet`` is put in its place anew after each candidate. At the end the list of digests appears, which
marks a search as finished; one that is given more rounds goes on from there.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

import glucoloop
from glucoloop.config.robust import HowFar, Robust
from glucoloop.config.toml import read_toml, toml_text
from glucoloop.storage.files import read_text
from glucoloop.storage.folder import SUMS
from glucoloop.storage.strict_json import json_text
from glucoloop.storage.tables import parquet
from glucoloop.storage.trials.durable import digest, in_the_making, put_file, read_sums, remove, sums_text
from glucoloop.storage.trials.lock import LOCK, locked
from glucoloop.trials.robust import OBJECTIVES, Candidate, Search

CONFIGURATION: Final = "robust.toml"
CANDIDATES: Final = "candidates.parquet"
SUMMARY: Final = "robust.json"
FINAL: Final = ("best.toml", "candidates.csv", "check.parquet", "front.pdf", "front.png", "front.svg", SUMMARY)
"""Written when all rounds are done."""
_NAMES: Final = (CONFIGURATION, CANDIDATES, SUMS, LOCK, *FINAL)


class RobustFolder:
    """The folder of a search that this process may write to; see `robust_folder`."""

    def __init__(self, path: Path, asked: Robust) -> None:
        self.path = path
        self.asked = asked
        self.notes: tuple[str, ...] = ()
        """What else is worth knowing, one sentence each."""
        self.candidates: list[Candidate] = []

    @property
    def finished(self) -> bool:
        """Whether all that was asked for is there."""
        return (self.path / SUMS).exists()

    def add(self, candidate: Candidate) -> None:
        """Keep a candidate.

        Raises
        ------
        ValueError
            If it cannot be written; those that are there stay.
        """
        self.candidates.append(candidate)
        self._put(CANDIDATES, parquet(candidate_table(self.asked.search, self.candidates)))

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Put the files about the whole search in their places, the digests of all files last."""
        for name, data in files.items():
            self._put(name, data)
        names = (CONFIGURATION, CANDIDATES, *files)
        self._put(SUMS, sums_text({name: digest(self.path / name) for name in names}))

    def summary(self) -> dict[str, Any]:
        """The summary of a finished search, as it was written."""
        found: dict[str, Any] = json.loads(read_text(self.path / SUMMARY, "the summary of a search"))
        return found

    def _put(self, name: str, data: bytes) -> None:
        try:
            put_file(self.path / name, data)
        except OSError as error:
            raise ValueError(
                f"{name} cannot be written to {self.path}: {error.strerror}; {len(self.candidates)} candidates are "
                "kept, free some space and run the same command again"
            ) from None

    def _begin(self) -> None:
        """Say what the folder is about, or check that it is the same search."""
        for entry in self.path.iterdir():
            if in_the_making(entry.name):
                remove(entry)
        text = toml_text(self.asked.keys(), f"robust --config {CONFIGURATION}")
        place = self.path / CONFIGURATION
        if place.exists():
            there, version = read_toml(read_text(place, "a configuration"), str(place))
            self._refuse_another(there, version)
            self._read_candidates()
            self._check_finished(there)
        if not place.exists() or place.read_bytes() != text.encode():
            put_file(place, text.encode())

    def _read_candidates(self) -> None:
        if not (self.path / CANDIDATES).exists():
            return
        self.candidates = read_candidates(self.path / CANDIDATES, self.asked.search)
        rounds, batch = self.asked.far.rounds, self.asked.search.batch
        if len(self.candidates) > rounds * batch:
            told = f"{rounds} round of {batch} is" if rounds == 1 else f"{rounds} rounds of {batch} are"
            raise ValueError(
                f"{self.path} holds {len(self.candidates)} candidates, and {told} fewer; "
                "ask for more rounds, or choose another folder with --out"
            )

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

    def _check_finished(self, there: Mapping[str, Any]) -> None:
        """Make anew what rests on how far the search goes, if that has changed, or if something is gone."""
        sums, far = read_sums(self.path), self.asked.far.model_dump(mode="json")
        whole = all(digest(self.path / name) == value for name, value in sums.items())
        if sums and not (whole and all(there.get(key) == value for key, value in far.items())):
            remove(self.path / SUMS)


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
        Begin again, whatever search the folder holds.

    Raises
    ------
    ValueError
        If the place is taken by something else, by another search or by another run, or cannot be written to. A new
        folder is gone again if the block fails before a candidate is done.
    """
    made = not path.exists()
    with contextlib.ExitStack() as stack:
        try:
            path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(path))
            _refuse_foreign(path)
            if overwrite:
                _clear(path)
            new = not (path / CONFIGURATION).exists()
            folder = RobustFolder(path, asked)
            folder._begin()
        except (FileExistsError, NotADirectoryError):
            raise ValueError(f"{path} is not a folder and cannot be one; choose another place with --out") from None
        except OSError as error:
            stack.close()
            _leave(path, made)
            raise ValueError(
                f"the output folder {path} cannot be written: {error.strerror}; choose another with --out"
            ) from None
        try:
            yield folder
        except BaseException:
            if new and not folder.candidates:
                _clear(path)
                stack.close()
                _leave(path, made)
            raise


def _leave(path: Path, made: bool) -> None:
    """Take away a folder that was made in vain."""
    if made:
        with contextlib.suppress(OSError):
            path.rmdir()


def _refuse_foreign(path: Path) -> None:
    holds = sorted(entry.name for entry in path.iterdir() if entry.name != LOCK and not in_the_making(entry.name))
    foreign = [name for name in holds if name not in _NAMES]
    if foreign:
        raise ValueError(f"{path} holds {foreign[0]}, which is no part of a search; choose another folder with --out")
    if holds and CONFIGURATION not in holds:
        raise ValueError(f"{path} is not empty and holds no search; choose another folder with --out")


def _clear(path: Path) -> None:
    """Take an earlier search away: the list of digests first, what it is about last."""
    sums = read_sums(path)
    for name in (*FINAL, CANDIDATES):
        if name in sums and (path / name).exists() and digest(path / name) != sums[name]:
            raise ValueError(
                f"{path} holds {name}, which was changed since glucoloop wrote it, so it is not replaced; "
                "move that away, or choose another folder with --out"
            )
    for name in (SUMS, *FINAL, CANDIDATES, CONFIGURATION):
        remove(path / name)


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
    try:
        table = pl.read_parquet(io.BytesIO(place.read_bytes()))
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
