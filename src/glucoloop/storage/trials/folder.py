"""The folder of a trial: its shards appear whole, one after the other, and a run that was cut short goes on.

What is there is never computed again, and never changed. What a killed run left in the making is removed. At the end
the list of digests appears, which marks a trial as finished.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from glucoloop.config import toml_text
from glucoloop.config.trial import trial_keys
from glucoloop.storage.folder import SUMS
from glucoloop.storage.trials.durable import digest, in_the_making, put_file, put_folder, read_sums, remove, sums_text
from glucoloop.storage.trials.header import HEADER, difference, header_of, other_libraries, read_header
from glucoloop.storage.trials.lock import LOCK, locked
from glucoloop.trials.people import Shard
from glucoloop.trials.trial import Trial

SHARDS: Final = "shards"
CONFIGURATION: Final = "trial.toml"
SUMMARY: Final = "summary.json"
BANDS: Final = "bands.parquet"
REPORT: Final = "report.html"
FINAL: Final = (BANDS, "figure.pdf", "figure.png", "figure.svg", REPORT, SUMMARY)
"""Written when all shards are done."""
_DIGITS: Final = 20
"""Of the number of a shard."""


@dataclass(frozen=True)
class Kind:
    """What a folder holds beside the shards."""

    configuration: str
    """File from which the same is done again."""
    text: str
    """What stands in it."""
    final: tuple[str, ...]
    """Files that are written when all shards are done."""

    @property
    def names(self) -> tuple[str, ...]:
        """All that may be in the folder."""
        return (HEADER, self.configuration, SHARDS, SUMS, LOCK, *self.final)


def plain_trial(trial: Trial) -> Kind:
    """The folder of a trial."""
    text = toml_text(trial_keys(trial), f"trial --config {CONFIGURATION}")
    return Kind(configuration=CONFIGURATION, text=text, final=FINAL)


class TrialFolder:
    """The folder of a trial that this process may write to; see `trial_folder`."""

    def __init__(self, path: Path, trial: Trial, kind: Kind) -> None:
        self.path = path
        self.trial = trial
        self.kind = kind
        self.notes: tuple[str, ...] = ()
        """What else is worth knowing, one sentence each."""
        self._sums: dict[int, dict[str, str]] = {}
        """Of the shards that are done."""

    @property
    def done(self) -> int:
        """Shards that are done."""
        return len(self._sums)

    @property
    def finished(self) -> bool:
        """Whether all that the trial writes is there."""
        return (self.path / SUMS).exists()

    def missing(self) -> list[int]:
        """Shards that are not done."""
        return [index for index in range(self.trial.shards) if index not in self._sums]

    def people_done(self) -> int:
        """People of the shards that are done."""
        return sum(self.trial.shard(index).size for index in self._sums)

    def shard(self, index: int) -> Path:
        """Where a shard is."""
        return shard_path(self.path, index)

    def put(self, index: int, files: Mapping[str, bytes]) -> None:
        """Put a shard in its place.

        Raises
        ------
        ValueError
            If it cannot be written; those that are done stay.
        """
        try:
            put_folder(self.shard(index), files)
        except OSError as error:
            raise self._unwritten(f"shard {index}", error) from None
        self._sums[index] = read_sums(self.shard(index))

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Put the files about the whole trial in their places, the digests of all files last.

        Raises
        ------
        ValueError
            If one cannot be written; the shards stay.
        """
        name = SUMS
        try:
            for name, data in files.items():
                put_file(self.path / name, data)
            name = SUMS
            put_file(self.path / SUMS, sums_text(self._digests(files)))
        except OSError as error:
            raise self._unwritten(name, error) from None

    def people(self) -> Iterator[Shard]:
        """The shards that are done, in order, one at a time."""
        from glucoloop.storage.trials.shard import read_people

        for index in sorted(self._sums):
            yield read_people(self.shard(index), self.trial)

    def summary(self) -> dict[str, Any]:
        """The summary of a finished trial, as it was written."""
        found: dict[str, Any] = json.loads((self.path / SUMMARY).read_text(encoding="utf-8"))
        return found

    def _digests(self, files: Iterable[str]) -> dict[str, str]:
        top = {name: digest(self.path / name) for name in (HEADER, self.kind.configuration, *files)}
        of_shards = {
            f"{SHARDS}/{self.shard(index).name}/{name}": value
            for index, sums in self._sums.items()
            for name, value in sums.items()
        }
        return {**top, **of_shards}

    def _unwritten(self, what: str, error: OSError) -> ValueError:
        return ValueError(
            f"{what} cannot be written to {self.path}: {error.strerror}; {self.done} of {self.trial.shards} shards are "
            "done and kept, free some space and run the same command again"
        )

    def _begin(self) -> None:
        """Write what the folder is about, unless it says so already."""
        header, text = header_of(self.trial), self.kind.text
        if not (self.path / HEADER).exists():
            put_file(self.path / HEADER, header.text().encode())
        there = read_header(self.path)
        refused = difference(there, header, self.path)
        if refused is not None:
            raise ValueError(refused)
        self.notes = tuple(other_libraries(there, header, self.path))
        configuration = self.path / self.kind.configuration
        if not configuration.exists():
            put_file(configuration, text.encode())
        elif configuration.read_bytes() != text.encode():
            raise ValueError(
                f"{configuration} was changed since glucoloop wrote it; move it away and run the same command again"
            )
        (self.path / SHARDS).mkdir(exist_ok=True)

    def _check(self) -> None:
        """Remove what a killed run left, and refuse what is damaged."""
        for folder in (self.path, self.path / SHARDS):
            for entry in folder.iterdir():
                if in_the_making(entry.name):
                    remove(entry)
        for index in range(self.trial.shards):
            if self.shard(index).exists():
                self._sums[index] = _whole_shard(self.shard(index), self.path)
        sums = read_sums(self.path)
        for name in self.kind.final:
            if name in sums and (self.path / name).exists() and digest(self.path / name) != sums[name]:
                raise ValueError(
                    f"{self.path / name} was changed since glucoloop wrote it; "
                    "move it away and run the same command again"
                )
        if sums and (self.missing() or not all((self.path / name).exists() for name in sums)):
            remove(self.path / SUMS)  # something was taken away, and is made again


def shard_path(folder: Path, index: int) -> Path:
    """Where a shard of a trial is."""
    return folder / SHARDS / f"{index:05d}"


def done_shards(folder: Path, shards: int) -> list[Path]:
    """The shards of a trial that are done, in order."""
    there = folder / SHARDS
    names = (entry.name for entry in there.iterdir() if entry.is_dir()) if there.is_dir() else ()
    numbers = sorted(int(name) for name in names if name.isascii() and name.isdecimal() and len(name) < _DIGITS)
    return [shard_path(folder, number) for number in numbers if number < shards]


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
        Begin again, whatever trial the folder holds.
    kind : Kind, optional
        What it holds beside the shards; a plain trial by default.

    Raises
    ------
    ValueError
        If the place is taken by something else, by another trial or by another run, if a shard is damaged, or if the
        folder cannot be written to. A new folder is gone again if the block fails before a shard is done.
    """
    made, kind = not path.exists(), plain_trial(trial) if kind is None else kind
    with contextlib.ExitStack() as stack:
        try:
            path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(path))
            _refuse_foreign(path, kind)
            if overwrite:
                _clear(path, kind)
            new = not (path / HEADER).exists()
            folder = TrialFolder(path, trial, kind)
            folder._begin()
            folder._check()
        except (FileExistsError, NotADirectoryError):
            raise ValueError(f"{path} is not a folder and cannot be one; choose another place with --out") from None
        except OSError as error:
            stack.close()
            _leave(path, made)
            raise ValueError(
                f"the output folder {path} cannot be written: {error.strerror}; "
                "free some space and run the same command again, or choose another with --out"
            ) from None
        try:
            yield folder
        except BaseException:
            if new and not folder.done:
                _clear(path, kind)
                stack.close()
                _leave(path, made)
            raise


def _leave(path: Path, made: bool) -> None:
    """Take away a folder that was made in vain."""
    if made:
        with contextlib.suppress(OSError):
            path.rmdir()


def _refuse_foreign(path: Path, kind: Kind) -> None:
    """Refuse a folder that holds something that is no part of a trial."""
    holds = [entry.name for entry in path.iterdir() if entry.name != LOCK and not in_the_making(entry.name)]
    foreign = sorted(name for name in holds if name not in kind.names)
    if foreign:
        raise ValueError(f"{path} holds {foreign[0]}, which is no part of a trial; choose another folder with --out")
    if holds and HEADER not in holds:
        raise ValueError(f"{path} is not empty and holds no trial; choose another folder with --out")


def _clear(path: Path, kind: Kind) -> None:
    """Take an earlier trial away: the list of digests first, its header last."""
    shards = path / SHARDS
    for entry in sorted(shards.iterdir()) if shards.is_dir() else ():
        if not (entry.name.isdecimal() or in_the_making(entry.name)):
            raise ValueError(
                f"{path} holds {SHARDS}/{entry.name}, which is no part of a trial, so it is not replaced; "
                "move that away, or choose another folder with --out"
            )
    sums = read_sums(path)
    for name in (*kind.final, kind.configuration):
        if name in sums and (path / name).exists() and digest(path / name) != sums[name]:
            raise ValueError(
                f"{path} holds {name}, which was changed since glucoloop wrote it, so it is not replaced; "
                "move that away, or choose another folder with --out"
            )
    for name in (SUMS, *kind.final, kind.configuration, SHARDS, HEADER):
        remove(path / name)


def _whole_shard(place: Path, folder: Path) -> dict[str, str]:
    """Digests of a shard that is as it was written.

    Raises
    ------
    ValueError
        If it is not.
    """
    sums = read_sums(place)
    unlisted = {entry.name for entry in place.iterdir()} - {SUMS} != sums.keys()
    damaged = [name for name, value in sums.items() if digest(place / name) != value] or [SUMS] * unlisted
    if damaged:
        raise ValueError(
            f"shard {place.name} of {folder} is damaged: {damaged[0]} is not as it was written; "
            f"delete {place} and run the same command again"
        )
    return sums
