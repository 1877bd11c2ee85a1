"""Folder of a trial: its shards appear complete, one after the other, and an interrupted run resumes.

Existing shards are never computed again, and never changed. Each shard names its trial, its people and its arithmetic;
other files are refused. At the end the list of digests appears, which marks a trial as finished.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from glucoloop import arithmetic
from glucoloop.cohorts.people import Shard
from glucoloop.cohorts.trial import Trial
from glucoloop.refusal import Refusal
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.origin import Origin
from glucoloop.storage.resumable import ResumableFolder, Work, opened
from glucoloop.storage.trials.binding import SHARD, bound, whole_shard
from glucoloop.storage.trials.header import (
    HEADER,
    Header,
    arithmetic_of,
    header_of,
    origin_of,
    other_tables,
    read_header,
)

SHARDS: Final = "shards"
CONFIGURATION: Final = "trial.toml"
SUMMARY: Final = "summary.json"
BANDS: Final = "bands.parquet"
REPORT: Final = "report.html"
FINAL: Final = (BANDS, "figure.pdf", "figure.png", "figure.svg", REPORT, SUMMARY)
"""Files that are written when all shards are done."""
_DIGITS: Final = 20
"""Number of digits from which a name is never taken for the number of a shard."""


def plain_trial(trial: Trial) -> Work:
    """Work of ``glucoloop trial``."""
    return Work(
        command="trial", what="trial", keys=trial.tree(whole=True), given=trial.tree(), final=FINAL, summary=SUMMARY
    )


class TrialFolder(ResumableFolder):
    """The folder of a trial that this process may write to; see `trial_folder`."""

    def __init__(self, path: Path, trial: Trial, work: Work) -> None:
        super().__init__(path, work, first=HEADER, others=(work.configuration,), done=SHARDS, done_is_folder=True)
        self.trial = trial
        self._header = self._there = header_of(trial)
        self.here = origin_of(self._header)
        self._sums: dict[int, dict[str, str]] = {}
        """Digests of the files of each shard that is done."""

    @property
    def done(self) -> int:
        """Number of shards that are done."""
        return len(self._sums)

    @property
    def anything_done(self) -> bool:
        """Whether a shard is done."""
        return bool(self._sums)

    @property
    def all_done(self) -> bool:
        """Whether every shard is done."""
        return self.done == self.trial.shards

    @property
    def progress(self) -> str:
        """Number of finished shards, in words."""
        return f"{self.done} of {self.trial.shards} shards"

    def missing(self) -> list[int]:
        """Numbers of the shards that are not done."""
        return [index for index in range(self.trial.shards) if index not in self._sums]

    def people_done(self) -> int:
        """Number of people in the finished shards."""
        return sum(self.trial.shard(index).size for index in self._sums)

    def shard(self, index: int) -> Path:
        """Path of a shard."""
        return shard_path(self.path, index)

    def put(self, index: int, files: Mapping[str, bytes]) -> None:
        """Put a shard in its place.

        Raises
        ------
        ValueError
            If its files are not those of the shard, or cannot be written; finished shards stay.
        """
        binding = bound(self.trial, index, files, **_binding(self._header))
        with self.unwritten(f"shard {index}"):
            disk.put_folder(self.shard(index), {**files, SHARD: binding})
        self._sums[index] = disk.read_sums(self.shard(index))

    def people(self) -> Iterator[Shard]:
        """People of the finished shards, in order, one shard at a time."""
        from glucoloop.storage.trials.shard import read_people

        for index in sorted(self._sums):
            yield read_people(self.shard(index), self.trial, index)

    def forget(self) -> None:
        """Begin without any shards."""
        self._sums, self._there = {}, self._header

    def settle(self) -> None:
        """Do nothing, since each shard is written as soon as it is done."""

    def first_files(self) -> dict[str, bytes]:
        """Header and configuration."""
        return {HEADER: self._there.text().encode(), self.work.configuration: self.work.text.encode()}

    def read_origin(self) -> Origin:
        """Read the header."""
        self._there = read_header(self.path)
        return origin_of(self._there)

    def read_done(self) -> None:
        """Read the finished shards, and refuse damaged or foreign ones."""
        same = [(of.fingerprint, of.people, of.shards) for of in (self._there, self._header)]
        if same[0] != same[1]:
            raise Refusal(
                f"{self.path / HEADER} was changed since glucoloop wrote it; delete {self.path} and run the trial again"
            )
        configuration = self.path / self.work.configuration
        if disk.is_file(configuration) and disk.read_bytes(configuration) != self.work.text.encode():
            raise Refusal(
                f"{configuration} was changed since glucoloop wrote it; move it away and run the same command again"
            )
        _refuse_foreign(self.path, self.trial.shards)
        self._sums = {
            index: whole_shard(self.shard(index), self.path, index, **_binding(self._there))
            for index in _numbers(self.path, self.trial.shards)
        }

    def load(self) -> None:
        """Read the results that the folder holds; see `ResumableFolder.load`."""
        super().load()
        self.notes = (*self.notes, *other_tables(self._there, self._header, self.path))

    def parts(self) -> dict[str, str]:
        """Digests of the files of all shards."""
        return {
            f"{SHARDS}/{self.shard(index).name}/{name}": value
            for index, sums in self._sums.items()
            for name, value in sums.items()
        }

    def part_of(self, name: str) -> int | None:
        """Number of the shard to which a file belongs; None for another file."""
        parts = name.split("/")
        return _number(parts[1], self.trial.shards) if len(parts) == 3 and parts[0] == SHARDS else None

    def refuse_foreign_parts(self) -> None:
        """Raise ValueError if there are foreign files beside the shards of a trial, or in one of them."""
        _refuse_foreign(self.path, None)


def shard_path(folder: Path, index: int) -> Path:
    """Path of a shard of a trial."""
    return folder / SHARDS / f"{index:05d}"


def done_shards(folder: Path, header: Header) -> list[Path]:
    """Paths of the finished shards of a trial, in order.

    Raises
    ------
    ValueError
        If one is damaged, or belongs to another trial.
    """
    _refuse_foreign(folder, header.shards)
    numbers = _numbers(folder, header.shards)
    for index in numbers:
        whole_shard(shard_path(folder, index), folder, index, **_binding(header))
    return [shard_path(folder, index) for index in numbers]


def final_files(folder: Path) -> list[str]:
    """Names of the bands and the summary of a finished trial, as far as they exist.

    Raises
    ------
    ValueError
        If one differs from the list of digests.
    """
    sums = disk.read_sums(folder)
    listed: list[str] = [name for name in (BANDS, SUMMARY) if name in sums]
    for name in listed:
        if disk.digest(folder / name) != sums[name]:
            raise Refusal(
                f"{folder / name} is gone or was changed since glucoloop wrote it; "
                f"move it away and run the command that made {folder} again"
            )
    return listed


@contextlib.contextmanager
def trial_folder(
    path: Path, trial: Trial, *, overwrite: bool = False, work: Work | None = None
) -> Iterator[TrialFolder]:
    """Open the folder of a trial, new or begun, for writing.

    Parameters
    ----------
    path : Path
    trial : Trial
    overwrite : bool
        Begin again, whatever trial the folder holds; the very same one that is not finished goes on.
    work : Work, optional
        Work for which the shards are computed; a plain trial by default.

    Raises
    ------
    ValueError
        If the place is taken by something else, by another trial or by another run, if a shard is damaged or belongs
        to something else, or if the folder cannot be written to. A new folder is gone again if the block fails before
        a shard is done.
    """
    with opened(TrialFolder(path, trial, plain_trial(trial) if work is None else work), overwrite=overwrite) as folder:
        yield folder


def _binding(header: Header) -> dict[str, str]:
    return {"fingerprint": header.fingerprint, "arithmetic": arithmetic.digest(arithmetic_of(header))}


def _numbers(folder: Path, shards: int) -> list[int]:
    """Numbers of the shards in a folder."""
    there = (_number(name, shards) for name in disk.names(folder / SHARDS))
    return sorted(number for number in there if number is not None)


def _number(name: str, shards: int | None) -> int | None:
    """Number of the shard of this name, out of so many or of any; None if it is not the name of a shard."""
    if not (name.isascii() and name.isdecimal() and len(name) < _DIGITS) or name != f"{int(name):05d}":
        return None
    return int(name) if shards is None or int(name) < shards else None


def _refuse_foreign(folder: Path, shards: int | None) -> None:
    """Refuse any name that is neither a shard, out of so many or of any, nor a file of a shard."""
    from glucoloop.storage.trials.shard import BANDS, PEOPLE, TRACES

    known = (PEOPLE, BANDS, TRACES, SHARD, SUMS)
    for name in disk.names(folder / SHARDS):
        if disk.is_part(name):
            continue
        place = folder / SHARDS / name
        foreign = [""] if _number(name, shards) is None else [f"/{of}" for of in disk.names(place) if of not in known]
        if foreign:
            raise Refusal(
                f"{folder} holds {SHARDS}/{name}{foreign[0]}, which is no part of a trial; "
                "move that away, or choose another folder with --out"
            )
