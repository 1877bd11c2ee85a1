"""Folder of a long computation: results stay, an interrupted run resumes, and damaged results are refused.

The first file describes the work; the list of digests, written last, marks it as finished. A process may die between
any two operations on the disk; the next one reads the results, removes unfinished files, and resumes.

The results are either one file with a row for each unit of work, see `storage.rows`, or a folder of parts that are put
in their places whole, see `storage.trials.folder`.
"""

from __future__ import annotations

import contextlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from glucoloop.refusal import Refusal
from glucoloop.situations.toml import toml_text
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import kept_text
from glucoloop.storage.lock import LOCK, locked
from glucoloop.storage.origin import Origin, other_arithmetic, refuse_another

_MOVE: Final = "move that away, or choose another folder with --out"


@dataclass(frozen=True, kw_only=True)
class Work:
    """Work of a command that may take long, and the files that it leaves."""

    command: str
    """Name of the command, and of its configuration file."""
    what: str
    """Name of the work in messages: ``"trial"``."""
    keys: Mapping[str, Any]
    """Configuration as flat keys, with the values that are used."""
    given: Mapping[str, Any] | None = None
    """Flat keys from which they follow, if it was read from fewer."""
    final: tuple[str, ...]
    """Names of the files that are written when everything is done."""
    summary: str
    """Name of the one among them that summarises the work, as JSON."""
    may_change: frozenset[str] = frozenset()
    """Keys for how far the work goes, which may differ when it is resumed."""

    @property
    def configuration(self) -> str:
        """Name of the file that repeats the work."""
        return f"{self.command}.toml"

    @property
    def text(self) -> str:
        """Text of that file."""
        return toml_text(self.keys, f"{self.command} --config {self.configuration}", self.given)


class ResumableFolder(ABC):
    """A folder that this process may write to; see `opened`.

    Parameters
    ----------
    path : Path
    work : Work
    first : str
        Name of the file that describes the work: written first, removed last.
    others : tuple of str
        Names of further files that stand in the folder from the beginning.
    done : str
        Name of the results so far: a file that is written anew as it grows, or a folder of parts.
    done_is_folder : bool
    """

    def __init__(
        self, path: Path, work: Work, *, first: str, others: tuple[str, ...], done: str, done_is_folder: bool
    ) -> None:
        self.path, self.work = path, work
        self.first, self.done_name, self.done_is_folder = first, done, done_is_folder
        self.files = (*work.final, *others)
        """Further files, in the order of their removal."""
        self.names = (first, *self.files, done, SUMS, LOCK)
        """All names that may be in the folder."""
        self.here = Origin.here(work.keys)
        self.notes: tuple[str, ...] = ()
        """Further notes, one sentence each."""

    @property
    def finished(self) -> bool:
        """Whether all results asked for are there."""
        return disk.is_file(self.path / SUMS)

    @property
    @abstractmethod
    def anything_done(self) -> bool:
        """Whether there are results that would be lost with the folder."""

    @property
    @abstractmethod
    def progress(self) -> str:
        """Extent of the results, for messages: ``"3 of 5 shards"``."""

    @abstractmethod
    def first_files(self) -> dict[str, bytes]:
        """Contents of the files that stand in the folder from the beginning, that of `first` before the others."""

    @abstractmethod
    def read_origin(self) -> Origin:
        """Read the origin of the folder; ValueError if its record is damaged."""

    @abstractmethod
    def read_done(self) -> None:
        """Read the results so far; ValueError if they are damaged, foreign, or more than was asked for."""

    @property
    def all_done(self) -> bool:
        """Whether no unit of work is missing."""
        return True

    def parts(self) -> dict[str, str]:
        """Digests of the files in the folder of results, by their path in this folder."""
        return {}

    def part_of(self, name: str) -> int | None:
        """Number of the part to which a file in the list of digests belongs; None for another file."""
        return None

    @abstractmethod
    def refuse_foreign_parts(self) -> None:
        """Raise ValueError if there is a file among the results that this program does not write."""

    @abstractmethod
    def settle(self) -> None:
        """Write the results that are not written yet."""

    @abstractmethod
    def forget(self) -> None:
        """Begin without any results."""

    def create(self) -> None:
        """Write the description of the work into an empty folder."""
        self.forget()
        self._say()

    def _say(self) -> None:
        for name, data in self.first_files().items():
            if not (disk.is_file(self.path / name) and disk.read_bytes(self.path / name) == data):
                disk.put_file(self.path / name, data)
        if self.done_is_folder and not disk.is_folder(self.path / self.done_name):
            disk.make_folders(self.path / self.done_name)

    def load(self) -> None:
        """Read the results in the folder.

        Raises
        ------
        ValueError
            If the folder holds other work, or is damaged. Nothing is changed in that case.
        """
        there = self.read_origin()
        may_change = self.work.may_change
        refuse_another(there.without(may_change), self.here.without(may_change), self.path, self.work.what)
        self.read_done()
        whole = self._is_whole(there)
        other = None
        if whole or self.anything_done or there.arithmetic is not None:
            other = other_arithmetic(there, self.here, self.path)
        if other is not None and not whole:
            raise Refusal(
                f"{other}, which does not give the same bits; go on as before, choose another folder with --out, or "
                "add --overwrite to begin again"
            )
        self.notes = (f"{other}.",) if other else ()
        if not whole:
            # something was taken away, or the work goes further: what rests on it is made again
            disk.remove(self.path / SUMS)
            self._say()

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Write the files about the whole work, the digests of all files last.

        Raises
        ------
        ValueError
            If one cannot be written; the results so far stay.
        """
        self.settle()
        for name, data in files.items():
            self.put_file(name, data)
        names = [*self.first_files(), *files, *([] if self.done_is_folder else [self.done_name])]
        sums = {name: disk.digest(self.path / name) for name in names}
        self.put_file(SUMS, disk.sums_text({**sums, **self.parts()}))

    def summary(self) -> dict[str, Any]:
        """The summary of finished work, as it was written."""
        return self.read_json(self.work.summary)

    def read_json(self, name: str) -> dict[str, Any]:
        """A JSON file of finished work, as it was written."""
        found: dict[str, Any] = json.loads(kept_text(self.path / name, f"the summary of a {self.work.what}"))
        return found

    def put_file(self, name: str, data: bytes) -> None:
        """Put a file in its place.

        Raises
        ------
        ValueError
            If it cannot be written; the results so far stay.
        """
        with self.unwritten(name):
            disk.put_file(self.path / name, data)

    @contextlib.contextmanager
    def unwritten(self, what: str) -> Iterator[None]:
        """Report an error of the disk in the block as a ValueError."""
        try:
            yield
        except OSError as error:
            again = " and ".join(filter(None, (disk.mend(error), "run the same command again")))
            raise Refusal(
                f"{what} cannot be written to {self.path}: {error.strerror}; {self.progress} are done and kept, {again}"
            ) from None

    def changed(self, sums: Mapping[str, str]) -> str | None:
        """First file of the folder itself that differs from a list of digests, or None."""
        for name in self._top:
            there = disk.digest(self.path / name)
            if there and name in sums and there != sums[name]:
                return name
        return None

    @property
    def _top(self) -> tuple[str, ...]:
        """Names of the files of the folder itself that the list of digests may hold."""
        return (self.first, *self.files, *(() if self.done_is_folder else (self.done_name,)))

    def _is_whole(self, there: Origin) -> bool:
        """Whether all results asked for are there.

        Raises
        ------
        ValueError
            If there is a list of digests, and a file differs from it or is missing in it.
        """
        if not disk.is_file(self.path / SUMS):
            return False
        sums, parts = disk.read_sums(self.path), self.parts()
        changed = self.changed(sums)
        if changed is not None:
            raise Refusal(
                f"{self.path / changed} was changed since glucoloop wrote it; move it away and run the same command "
                "again"
            )
        wrong = [name for name in self._top if name not in sums and disk.is_file(self.path / name)]
        wrong += [name for name in sums if name not in self._top and self.part_of(name) is None]
        numbers = {self.part_of(name) for name in parts}
        told = {name: sums[name] for name in sums if name not in self._top and self.part_of(name) in numbers}
        if wrong or told != parts:
            raise Refusal(
                f"{self.path / SUMS} does not list {wrong[0] if wrong else 'what is done'} as it is; "
                "move it away and run the same command again"
            )
        complete = {*self.first_files(), *(() if self.done_is_folder else (self.done_name,))} <= sums.keys()
        return (
            complete
            and self.all_done
            and all(disk.is_file(self.path / name) for name in sums if name in self._top)
            and all(there.config.get(key) == self.here.config.get(key) for key in self.work.may_change)
        )


F = TypeVar("F", bound=ResumableFolder)


@contextlib.contextmanager
def opened(folder: F, *, overwrite: bool) -> Iterator[F]:
    """Open a folder, new or begun, for writing.

    Parameters
    ----------
    folder : ResumableFolder
    overwrite : bool
        Begin again, unless the folder holds the same work unfinished: then it is resumed.

    Raises
    ------
    ValueError
        If the place is taken by something else, by other work or by another run, if the results in it are damaged, or
        if the folder cannot be written to. A new folder is removed if the block fails before there are results.
    """
    path, made = folder.path, list[Path]()
    with contextlib.ExitStack() as stack:
        try:
            made = disk.make_folders(path)
            stack.enter_context(locked(path))
            new = _begin(folder, overwrite=overwrite)
        except (FileExistsError, NotADirectoryError):
            raise Refusal(f"{path} is not a folder and cannot be one; choose another place with --out") from None
        except OSError as error:
            stack.close()
            disk.remove_empty(made)
            mend = disk.mend(error)
            again = f"{mend} and run the same command again, or " if mend else ""
            raise Refusal(
                f"the output folder {path} cannot be written: {error.strerror}; {again}choose another with --out"
            ) from None
        try:
            yield folder
            folder.settle()
        except BaseException:
            with contextlib.suppress(ValueError):  # the error of the block matters more
                folder.settle()
            if new and not folder.anything_done:
                with contextlib.suppress(OSError, ValueError):
                    _clear(folder)
                stack.close()
                disk.remove_empty(made)
            raise


def _begin(folder: ResumableFolder, *, overwrite: bool) -> bool:
    """Create a new folder or read an existing one; returns whether the work is new."""
    _refuse_foreign(folder)
    there = disk.is_file(folder.path / folder.first)
    if there and overwrite and not _goes_on(folder):
        _clear(folder)
        there = False
    elif there and not overwrite:
        folder.load()
    _sweep(folder)
    if not there:
        folder.create()
    return not there


def _goes_on(folder: ResumableFolder) -> bool:
    """Whether the folder holds the same work, undamaged and not finished."""
    try:
        folder.load()
    except ValueError:
        return False
    return not folder.finished


def _refuse_foreign(folder: ResumableFolder) -> None:
    path, what = folder.path, folder.work.what
    holds = [name for name in disk.names(path.resolve()) if name != LOCK and not disk.is_part(name, *folder.names)]
    foreign = [name for name in holds if name not in folder.names]
    if foreign:
        raise Refusal(f"{path} holds {foreign[0]}, which is no part of a {what}; choose another folder with --out")
    if holds and folder.first not in holds:
        raise Refusal(f"{path} is not empty and holds no {what}; choose another folder with --out")
    for name in holds:
        (disk.is_folder if folder.done_is_folder and name == folder.done_name else disk.is_file)(path / name)


def _sweep(folder: ResumableFolder) -> None:
    """Remove unfinished files that a dead process left."""
    path = folder.path
    for name in disk.names(path.resolve()):
        if disk.is_part(name, *folder.names):
            disk.remove(path / name)
    if folder.done_is_folder:
        for name in disk.names(path / folder.done_name):
            if disk.is_part(name):
                disk.remove(path / folder.done_name / name)


def _clear(folder: ResumableFolder) -> None:
    """Remove earlier work: the results in one step, then the list of digests, and the description last."""
    path = folder.path
    folder.refuse_foreign_parts()
    changed = folder.changed(disk.read_sums(path))
    if changed not in (None, folder.first):
        raise Refusal(
            f"{path} holds {changed}, which was changed since glucoloop wrote it, so it is not replaced; {_MOVE}"
        )
    for name in (folder.done_name, SUMS, *folder.files, folder.first):
        disk.remove(path / name)
    disk.sync(path)
