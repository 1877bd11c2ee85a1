"""Folder of a trial: its shards appear complete, one after the other, and an interrupted run resumes.

Existing shards are never computed again, and never changed. Each shard names its trial, its people and its arithmetic;
other files are refused. At the end the list of digests appears, which marks a trial as finished.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from glucoloop import arithmetic
from glucoloop.cohorts.people import Shard
from glucoloop.cohorts.trial import Trial
from glucoloop.config import toml_text
from glucoloop.config.trial import trial_keys
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import kept_text
from glucoloop.storage.resumable import Layout, ResumableFolder, opened
from glucoloop.storage.trials.binding import SHARD, bound, whole_shard
from glucoloop.storage.trials.header import (
    HEADER,
    Header,
    arithmetic_of,
    difference,
    header_of,
    other_arithmetic,
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


@dataclass(frozen=True)
class Kind:
    """Files of a folder beside the shards."""

    configuration: str
    """Name of the file that repeats the work."""
    text: str
    """Text of that file."""
    final: tuple[str, ...]
    """Names of the files that are written when all shards are done."""

    @property
    def layout(self) -> Layout:
        """Names that may be in the folder."""
        return Layout(
            what="trial", first=HEADER, files=(*self.final, self.configuration), done=SHARDS, done_is_folder=True
        )


def plain_trial(trial: Trial) -> Kind:
    """Folder of a plain trial."""
    text = toml_text(trial_keys(trial), f"trial --config {CONFIGURATION}")
    return Kind(configuration=CONFIGURATION, text=text, final=FINAL)


class TrialFolder(ResumableFolder):
    """The folder of a trial that this process may write to; see `trial_folder`."""

    def __init__(self, path: Path, trial: Trial, kind: Kind) -> None:
        super().__init__(path, kind.layout)
        self.trial = trial
        self.kind = kind
        self._header = header_of(trial)
        self._sums: dict[int, dict[str, str]] = {}
        """Digests of the shards that are done."""

    @property
    def done(self) -> int:
        """Number of shards that are done."""
        return len(self._sums)

    @property
    def anything_done(self) -> bool:
        """Whether a shard is done."""
        return bool(self._sums)

    @property
    def kept(self) -> str:
        """Number of finished shards, in words."""
        return f"{self.done} of {self.trial.shards} shards are done and kept"

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

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Write the files about the whole trial, the digests of all files last.

        Raises
        ------
        ValueError
            If one cannot be written; the shards stay.
        """
        for name, data in files.items():
            self.put_file(name, data)
        self.put_file(SUMS, disk.sums_text(self._digests(files)))

    def people(self) -> Iterator[Shard]:
        """People of the finished shards, in order, one shard at a time."""
        from glucoloop.storage.trials.shard import read_people

        for index in sorted(self._sums):
            yield read_people(self.shard(index), self.trial, index)

    def summary(self) -> dict[str, Any]:
        """The summary of a finished trial, as it was written."""
        found: dict[str, Any] = json.loads(kept_text(self.path / SUMMARY, "the summary of a trial"))
        return found

    def create(self) -> None:
        """Write the description of the trial into the folder."""
        self._sums = {}
        disk.put_file(self.path / HEADER, self._header.text().encode())
        self._complete()

    def load(self) -> None:
        """Read the finished shards, and refuse damaged or foreign ones."""
        there = read_header(self.path)
        refused = difference(there, self._header, self.path)
        if refused is not None:
            raise ValueError(refused)
        configuration = self.path / self.kind.configuration
        if disk.is_file(configuration) and disk.read_bytes(configuration) != self.kind.text.encode():
            raise ValueError(
                f"{configuration} was changed since glucoloop wrote it; move it away and run the same command again"
            )
        _refuse_foreign(self.path, self.trial.shards)
        sums = {
            index: whole_shard(self.shard(index), self.path, index, **_binding(there))
            for index in _numbers(self.path, self.trial.shards)
        }
        finished = self._check_finished(sums)
        self._check_arithmetic(there, finished=finished)
        self._sums = sums
        self._complete()
        if not finished and self.finished:
            disk.remove(self.path / SUMS)  # something was taken away, and is made again

    def refuse_foreign_parts(self) -> None:
        """Raise ValueError if there are foreign files beside the shards of a trial, or in one of them."""
        _refuse_foreign(self.path, None)

    def _complete(self) -> None:
        """Create the parts that follow the header and precede the first shard."""
        if not disk.is_file(self.path / self.kind.configuration):
            disk.put_file(self.path / self.kind.configuration, self.kind.text.encode())
        if not disk.is_folder(self.path / SHARDS):
            disk.make_folders(self.path / SHARDS)

    def _check_arithmetic(self, there: Header, *, finished: bool) -> None:
        """Refuse to resume with another arithmetic than that of the finished shards."""
        other = other_arithmetic(there, self._header, self.path)
        if other is not None and not finished:
            raise ValueError(
                f"{other}, which does not give the same bits; go on as before, choose another folder with --out, or "
                "add --overwrite to begin again"
            )
        self.notes = (*([f"{other}."] if other else []), *other_tables(there, self._header, self.path))

    def _check_finished(self, shards: Mapping[int, Mapping[str, str]]) -> bool:
        """Whether all files in the list of digests are there.

        Raises
        ------
        ValueError
            If a file differs from the list, or is not in it.
        """
        if not disk.is_file(self.path / SUMS):
            return False
        sums = disk.read_sums(self.path)
        self.refuse_changed(sums)
        top = {HEADER, *self.layout.files}
        wrong = [name for name in top if name not in sums and disk.is_file(self.path / name)]
        wrong += [name for name in sums if name not in top and _index_of(name, self.trial.shards) is None]
        told = {name: digest for name, digest in sums.items() if _index_of(name, self.trial.shards) in shards}
        if wrong or told != _of_shards(self.path, shards):
            raise ValueError(
                f"{self.path / SUMS} does not list {wrong[0] if wrong else 'the shards'} as it is; "
                "move it away and run the same command again"
            )
        there = all(disk.is_file(self.path / name) for name in sums if name in top)
        return there and len(shards) == self.trial.shards

    def _digests(self, files: Iterable[str]) -> dict[str, str]:
        top = {name: disk.digest(self.path / name) for name in (HEADER, self.kind.configuration, *files)}
        return {**top, **_of_shards(self.path, self._sums)}


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
            raise ValueError(
                f"{folder / name} is gone or was changed since glucoloop wrote it; "
                f"move it away and run the command that made {folder} again"
            )
    return listed


@contextlib.contextmanager
def trial_folder(
    path: Path, trial: Trial, *, overwrite: bool = False, kind: Kind | None = None
) -> Iterator[TrialFolder]:
    """Open the folder of a trial, new or begun, for writing.

    Parameters
    ----------
    path : Path
    trial : Trial
    overwrite : bool
        Begin again, whatever trial the folder holds; the same trial, unfinished, is resumed.
    kind : Kind, optional
        Files beside the shards; those of a plain trial by default.

    Raises
    ------
    ValueError
        If the place is taken by something else, by another trial or by another run, if a shard is damaged or belongs
        to something else, or if the folder cannot be written to. A new folder is gone again if the block fails before
        a shard is done.
    """
    with opened(TrialFolder(path, trial, plain_trial(trial) if kind is None else kind), overwrite=overwrite) as folder:
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


def _index_of(name: str, shards: int) -> int | None:
    """Number of the shard to which a file belongs; None if it belongs to none."""
    parts = name.split("/")
    return _number(parts[1], shards) if len(parts) == 3 and parts[0] == SHARDS else None


def _of_shards(folder: Path, shards: Mapping[int, Mapping[str, str]]) -> dict[str, str]:
    """Digests of the files of shards, by their path relative to the folder of the trial."""
    return {
        f"{SHARDS}/{shard_path(folder, index).name}/{name}": value
        for index, sums in shards.items()
        for name, value in sums.items()
    }


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
            raise ValueError(
                f"{folder} holds {SHARDS}/{name}{foreign[0]}, which is no part of a trial; "
                "move that away, or choose another folder with --out"
            )
