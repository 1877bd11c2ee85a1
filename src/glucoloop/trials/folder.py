"""Folder of a trial: its shards appear complete, one after the other, and an interrupted run resumes.

Existing shards are never computed again, and never changed. The record of each, ``shard.json``, names its trial, its
people and its arithmetic, so that no shard is taken for another; other files are refused. At the end the list of
digests appears, which marks a trial as finished. Traces may be in a store instead, see `trials.trace_store`; then the
record of a shard has their size and digest.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import polars as pl

from glucoloop import arithmetic
from glucoloop.refusal import Refusal
from glucoloop.schema.values import ValueBounds
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import json_text, stored_json
from glucoloop.storage.resumable import Origin, ResumableFolder, Work, opened
from glucoloop.trials.people import Shard
from glucoloop.trials.shard import FILES, TRACES, bounds, read_people
from glucoloop.trials.trace_store import (
    MEND,
    StoredTable,
    TraceStore,
    file_system_path,
    read_stored,
    refuse_changed,
    store_address,
)
from glucoloop.trials.trial import FORMAT, PORTABLE, Trial, fingerprint

RECORD: Final = "trial.json"
SHARDS: Final = "shards"
SHARD: Final = "shard.json"
SUMMARY: Final = "summary.json"
BANDS: Final = "bands.parquet"
REPORT: Final = "report.html"
FINAL: Final = (BANDS, "figure.pdf", "figure.png", "figure.svg", REPORT, "tables.tex", SUMMARY)
"""Files that are written when all shards are done."""
_NUMBER: Final = re.compile("[0-9]{5}|[1-9][0-9]{5,18}")
"""Name of the folder of a shard."""


@dataclass(frozen=True, kw_only=True)
class TrialOrigin(Origin):
    """Origin of the shards in a folder."""

    format: str = "glucoloop-trial 6"
    fingerprint: str
    people: Annotated[int, ValueBounds(at_least=1)]
    shards: Annotated[int, ValueBounds(at_least=1)]
    polars: str = pl.__version__
    """Version of the library that writes tables, and computes nothing."""
    traces_at: str | None = None
    """Address of the store of the traces, if they are not in the folder."""

    @classmethod
    def of(cls, trial: Trial, **of_results: Any) -> TrialOrigin:
        """Origin of a trial that begins now, with settings of its results alone."""
        keys = trial.tree(whole=True) | of_results
        return cls.current(keys, fingerprint=fingerprint(trial), people=trial.people, shards=trial.shards)

    @classmethod
    def of_folder(cls, folder: Path) -> TrialOrigin:
        """Origin of the shards in a folder; ValueError if there is none, or glucoloop did not write it."""
        if not folder.is_dir():
            raise Refusal(f"{folder} is not a folder; give the folder that `glucoloop trial --out` wrote")
        if not disk.is_file(folder / RECORD):
            raise Refusal(
                f"{folder} holds no trial, for there is no {RECORD}; give a folder that glucoloop trial wrote"
            )
        return cls.read(folder / RECORD)

    @property
    def libraries(self) -> dict[str, str]:
        """Versions of the libraries that compute and that write tables."""
        return {**{name: self.arithmetic[name] for name in arithmetic.LIBRARIES}, "polars": self.polars}

    def of_store(self, may_change: Collection[str]) -> bytes:
        """Record that ties a store to its trial, without keys of the configuration that may change.

        The bits of all traces depend on it.
        """
        config = {name: value for name, value in self.config.items() if name not in may_change}
        names = ("format", "version", "fingerprint", "people", "shards", "arithmetic")
        return f"{json_text({**{name: getattr(self, name) for name in names}, 'config': config})}\n".encode()

    def of_shard(self, index: int) -> dict[str, Any]:
        """Part of the record of a shard that ties it to its place."""
        return {
            "format": "glucoloop-shard",
            "format_version": FORMAT,
            "fingerprint": self.fingerprint,
            "arithmetic": arithmetic.digest(self.arithmetic),
            "index": index,
        }


@dataclass(frozen=True, kw_only=True)
class _ShardRecord:
    """Record of a shard, as ``shard.json`` holds it."""

    format: str
    format_version: int
    fingerprint: str
    arithmetic: str
    index: int
    first_person: int
    people: int
    rows: dict[str, int]
    """Number of rows of each of its tables in the folder."""
    stored: dict[str, StoredTable] | None = None
    """Tables in the store of the trial, if there are any."""
    processor: str | None = None
    """Processor that computed the shard, if it is of another kind than that of the folder."""


class TrialFolder(ResumableFolder):
    """The folder of a trial that this process may write to; see `trial_folder`."""

    record = RECORD
    in_parts = True
    origin: TrialOrigin
    recorded: TrialOrigin

    def __init__(self, path: Path, trial: Trial, work: Work, traces_at: str | None = None) -> None:
        self.trial = trial
        of_results = {name: work.keys[name] for name in sorted(work.may_change)}
        origin = replace(TrialOrigin.of(trial, **of_results), traces_at=traces_at)
        super().__init__(path, work, origin, results=SHARDS, wanted=trial.shards, unit="shards")
        self.store = None if traces_at is None else TraceStore(traces_at, origin.of_store(work.may_change))
        """Store of the traces, if they are not put into the folder."""
        self._sums: dict[int, dict[str, str]] = {}
        """Digests of the files of each shard that is done."""
        self._others: dict[int, str] = {}
        """Processors of the shards that another kind computed."""
        self._stored: dict[int, Mapping[str, StoredTable]] = {}
        """Tables of each shard that are in the store."""

    @property
    def done(self) -> int:
        """Number of shards that are done."""
        return len(self._sums)

    def missing(self) -> list[int]:
        """Numbers of the shards that are not done."""
        return [index for index in range(self.trial.shards) if index not in self._sums]

    @property
    def other_processors(self) -> tuple[str, ...]:
        """Kinds of processors of finished shards other than that of the folder, in portable arithmetic."""
        return tuple(sorted(set(self._others.values())))

    def people_done(self) -> int:
        """Number of people in the finished shards."""
        return sum(self.trial.shard(index).size for index in self._sums)

    def shard(self, index: int) -> Path:
        """Path of a shard."""
        return _shard_path(self.path, index)

    def put(
        self,
        index: int,
        files: Mapping[str, bytes],
        processor: str | None = None,
        stored: Mapping[str, StoredTable] | None = None,
    ) -> None:
        """Put a shard in its place, computed by a `processor`, that of the folder by default.

        What whoever computed it has `stored` already is not among the files. A ValueError tells that these are not its
        files, or that they cannot be written.
        """
        if stored is None:
            try:
                files, stored = traces_stored(self.store, self.trial, index, files)
            except Refusal as error:
                raise Refusal(
                    f"shard {index}: {error}; {self.progress} are done and kept, run the same command again"
                ) from None
        own = self.recorded.arithmetic[arithmetic.PROCESSOR]
        expected = bounds(self.trial, index)
        if {*files, *stored} != expected.keys():
            raise Refusal(f"shard {index} has the files {', '.join((*files, *stored))}, and not {', '.join(expected)}")
        rows = {name: _rows(self.trial, index, name, data) for name, data in sorted(files.items())}
        person = self.trial.shard(index)
        place = self.origin.of_shard(index)
        record = _ShardRecord(
            **place, first_person=int(person[0]), people=int(person.size), rows=rows, stored=dict(stored) or None
        )
        if processor not in (None, own):
            record = replace(record, processor=processor)
            self._others[index] = processor
        written = {name: value for name, value in vars(record).items() if value is not None}
        with self.unwritten(f"shard {index}"):
            disk.put_folder(self.shard(index), {**files, SHARD: f"{json_text(written, vars)}\n".encode()})
        self._sums[index] = disk.read_sums(self.shard(index))
        self._stored[index] = dict(stored)

    def people(self) -> Iterator[Shard]:
        """People of the finished shards, in order, one shard at a time."""
        for index in sorted(self._sums):
            yield read_people(self.shard(index), self.trial, index)

    def write_pending(self) -> None:
        """Do nothing, since a shard is written as it is put."""

    def _read_done(self) -> None:
        earlier, now = self.recorded, self.origin
        if earlier.polars != now.polars:
            difference = f"{self.path} was begun with polars {earlier.polars}, and this is {now.polars}"
            self.notes = (f"{difference}; tables hold the same, in other bytes.",)
        if any(getattr(earlier, name) != getattr(now, name) for name in ("fingerprint", "people", "shards")):
            raise Refusal(
                f"{self.path / RECORD} was changed since glucoloop wrote it; delete {self.path} and run the trial again"
            )
        whole = _whole_shards(self.path, earlier)
        self._sums = {index: shard.sums for index, shard in whole.items()}
        self._others = {index: shard.processor for index, shard in whole.items() if shard.processor is not None}
        self._stored = {index: shard.stored for index, shard in whole.items()}

    def _part_digests(self) -> dict[str, str]:
        return {
            f"{SHARDS}/{self.shard(index).name}/{name}": value
            for index, sums in self._sums.items()
            for name, value in sums.items()
        }

    def begin(self, *, overwrite: bool) -> bool:
        """Read an existing folder or create a new one; returns whether the work is new."""
        if self.store is not None:
            inside = file_system_path(self.store.address)
            if inside is not None and inside.resolve().is_relative_to(self.path.resolve()):
                raise Refusal(f"{self.store.address} is within {self.path}", "give a place beside it with --traces-at")
            if overwrite:
                self.store.refuse_other()  # which must not cost earlier work
        return super().begin(overwrite=overwrite)

    def _refuse_another(self) -> bool:
        goes_further = super()._refuse_another()
        earlier, now = self.recorded.traces_at, self.origin.traces_at
        if earlier != now:
            raise Refusal(
                f"the traces of {self.path} are in {earlier or 'that folder'}, and not in {now or 'the folder'}",
                "leave --traces-at out" if earlier is None else f"give --traces-at {earlier}",
                "choose another folder with --out",
            )
        return goes_further

    def _describe(self) -> None:
        """Write what the folder begins with, and the store if shards are missing, as far as it is not there."""
        if self.store is not None and self.missing():
            self.store.begin()
            refuse_changed(self.store.address, _by_place(self._stored), MEND)
        super()._describe()

    def clear(self) -> None:
        """Remove earlier work, unless there is a foreign file beside the shards of a trial, or in one of them."""
        _refuse_foreign(self.path)
        super().clear()


def trial_folder(
    path: Path, trial: Trial, *, overwrite: bool = False, work: Work | None = None, traces_at: str | None = None
) -> AbstractContextManager[TrialFolder]:
    """Open the folder of a trial, new or begun, for writing; see `opened`.

    The shards are computed for a work, that of ``glucoloop trial`` by default. Traces are put into the folder, or into
    the store of an address, see `trace_store.store_address`.
    """
    if work is None:
        work = Work(command="trial", what="trial", keys=trial.tree(whole=True), explicit=trial.tree(), final=FINAL)
    return opened(TrialFolder(path, trial, work, traces_at), overwrite=overwrite)


def traces_stored(
    store: TraceStore | None, trial: Trial, index: int, files: Mapping[str, bytes]
) -> tuple[dict[str, bytes], dict[str, StoredTable]]:
    """The files of a shard without those that a store now has, and these; all files where there is no store.

    A Refusal tells that the traces are not those of the shard, or cannot be written.
    """
    if store is None or TRACES not in files:
        return dict(files), {}
    rows = _rows(trial, index, TRACES, files[TRACES])
    stored = store.put(stored_name(index, TRACES), files[TRACES], rows)
    return {name: data for name, data in files.items() if name != TRACES}, {TRACES: stored}


def stored_name(index: int, name: str) -> str:
    """Name in the store of a table of a shard, which is that of the folder."""
    return f"{SHARDS}/{_shard_path(Path(), index).name}/{name}"


class DoneShard(NamedTuple):
    """A finished shard of a trial."""

    path: Path
    stored: dict[str, StoredTable]
    """Tables of it that are in the store of the trial, by their names there."""


def done_shards(folder: Path, origin: TrialOrigin) -> list[DoneShard]:
    """The finished shards of a trial, in order; ValueError if one is damaged, or belongs to another trial."""
    return [
        DoneShard(_shard_path(folder, index), _by_place({index: shard.stored}))
        for index, shard in _whole_shards(folder, origin).items()
    ]


def traces_in_store(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Place and contents of each table of traces that the trial of a folder has in a store, in order.

    A Refusal tells that one cannot be read, or is not as it was written.
    """
    origin = TrialOrigin.of_folder(folder)
    for shard in done_shards(folder, origin):
        for name, table in shard.stored.items():
            address = store_address(str(origin.traces_at))
            yield f"{address}/{name}", read_stored(address, name, table)


def _by_place(stored: Mapping[int, Mapping[str, StoredTable]]) -> dict[str, StoredTable]:
    """Tables of shards by their names in the store."""
    return {stored_name(index, name): table for index, of in stored.items() for name, table in of.items()}


def _rows(trial: Trial, index: int, name: str, data: bytes) -> int:
    """Number of rows of a table of a shard; Refusal if it is too large, or has others."""
    try:
        return bounds(trial, index)[name].check(data)
    except ValueError as error:
        raise Refusal(f"{name} of shard {index} is not as it must be: {error}") from None


def final_files(folder: Path) -> list[str]:
    """Names of the existing bands and summary of a trial; ValueError if one differs from the list of digests."""
    sums = disk.read_sums(folder)
    listed: list[str] = [name for name in (BANDS, SUMMARY) if name in sums]
    for name in listed:
        if disk.digest(folder / name) != sums[name]:
            raise Refusal(
                f"{folder / name} is gone or was changed since glucoloop wrote it; "
                f"move it away and run the command that made {folder} again"
            )
    return listed


def _shard_path(folder: Path, index: int) -> Path:
    return folder / SHARDS / f"{index:05d}"


class _WholeShard(NamedTuple):
    """A finished shard."""

    sums: dict[str, str]
    """Digest of each file."""
    processor: str | None
    """Processor that computed it, if it is of another kind than that of the folder."""
    stored: dict[str, StoredTable]
    """Tables that are in the store of the trial."""


def _whole_shards(folder: Path, origin: TrialOrigin) -> dict[int, _WholeShard]:
    """Each finished shard, in order; ValueError if one is damaged, or of another trial."""
    _refuse_foreign(folder, origin.shards)
    indices = (int(name) for name in disk.names(folder / SHARDS) if not disk.is_part(name))
    return {index: _whole_shard(folder, origin, index) for index in sorted(indices)}


def _whole_shard(folder: Path, origin: TrialOrigin, index: int) -> _WholeShard:
    place = _shard_path(folder, index)
    shard, mend = f"shard {place.name} of {folder}", f"delete {place} and run the same command again"
    try:
        sums = disk.read_sums(place)
        digests = {name: disk.digest(place / name) for name in disk.names(place) if name != SUMS}
    except ValueError as error:
        raise Refusal(f"{shard} is damaged: {str(error).partition(';')[0]}; {mend}") from None
    if sums != digests or SHARD not in sums:
        changed = next((name for name in sums if digests.get(name) != sums[name]), SUMS)
        raise Refusal(f"{shard} is damaged: {changed} is not as it was written; {mend}")
    record = stored_json(place / SHARD, mend, _ShardRecord)
    for name, value in origin.of_shard(index).items():
        if getattr(record, name) != value:
            raise Refusal(
                f"{shard} belongs to something else: its {name} is {getattr(record, name)}, and that of its place is "
                f"{value}; {mend}"
            )
    if record.processor is not None and origin.config.get("arithmetic") != PORTABLE:
        raise Refusal(
            f"{shard} was computed by another processor ({record.processor}), without portable arithmetic; {mend}"
        )
    if {SHARD, *record.rows} != digests.keys():
        raise Refusal(f"{shard} is damaged: {SHARD} does not list its files; {mend}")
    if record.stored and origin.traces_at is None:
        raise Refusal(f"{shard} is damaged: {SHARD} lists what is in a store, and {RECORD} has no store; {mend}")
    return _WholeShard(sums, record.processor, record.stored or {})


def _refuse_foreign(folder: Path, shards: float = math.inf) -> None:
    """Refuse any name that is neither a shard, out of so many or of any, nor a file of a shard."""
    known = (*FILES, SHARD, SUMS)
    for name in disk.names(folder / SHARDS):
        if disk.is_part(name):
            continue
        of_shard = _NUMBER.fullmatch(name) is not None and int(name) < shards
        foreign = [f"/{file}" for file in disk.names(folder / SHARDS / name) if file not in known] if of_shard else [""]
        if foreign:
            raise Refusal(
                f"{folder} holds {SHARDS}/{name}{foreign[0]}, which is no part of a trial; "
                "move that away, or choose another folder with --out"
            )
