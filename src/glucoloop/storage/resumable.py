"""Folder of a long computation: results stay, an interrupted run resumes, and damaged results are refused.

The first file describes the work; the list of digests, written last, marks it as finished. A process may die between
any two operations on the disk; the next one reads the results, removes unfinished files, and resumes.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.lock import LOCK, locked

_MOVE: Final = "move that away, or choose another folder with --out"


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Names that a folder may hold."""

    what: str
    """Name of the work: ``"trial"``."""
    first: str
    """File that describes the work: written first, removed last."""
    files: tuple[str, ...]
    """Further files, in the order of their removal."""
    done: str
    """File or folder of the results so far, which grows step by step."""
    done_is_folder: bool

    @property
    def names(self) -> tuple[str, ...]:
        """All names that may be in the folder."""
        return (self.first, *self.files, self.done, SUMS, LOCK)


class ResumableFolder(ABC):
    """A folder that this process may write to; see `opened`."""

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path = path
        self.layout = layout
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
    def kept(self) -> str:
        """Extent of the results, for messages: ``"3 of 5 shards are done and kept"``."""

    @abstractmethod
    def create(self) -> None:
        """Write the description of the work into an empty folder."""

    @abstractmethod
    def load(self) -> None:
        """Read the results in the folder.

        Raises
        ------
        ValueError
            If the folder holds other work, or is damaged. Nothing is changed in that case.
        """

    @abstractmethod
    def refuse_foreign_parts(self) -> None:
        """Raise ValueError if the results, of any work, are mixed with files that this program does not write."""

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
            raise ValueError(
                f"{what} cannot be written to {self.path}: {error.strerror}; {self.kept}, free some space and run the "
                "same command again"
            ) from None

    def changed(self, sums: Mapping[str, str]) -> str | None:
        """First file of the folder itself that differs from a list of digests, or None."""
        layout = self.layout
        for name in (layout.first, *layout.files, *([] if layout.done_is_folder else [layout.done])):
            there = disk.digest(self.path / name)
            if there and name in sums and there != sums[name]:
                return name
        return None

    def refuse_changed(self, sums: Mapping[str, str]) -> None:
        """Raise ValueError if a file of the folder itself differs from a list of digests."""
        name = self.changed(sums)
        if name is not None:
            raise ValueError(
                f"{self.path / name} was changed since glucoloop wrote it; move it away and run the same command again"
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
            raise ValueError(f"{path} is not a folder and cannot be one; choose another place with --out") from None
        except OSError as error:
            stack.close()
            disk.remove_empty(made)
            raise ValueError(
                f"the output folder {path} cannot be written: {error.strerror}; "
                "free some space and run the same command again, or choose another with --out"
            ) from None
        try:
            yield folder
        except BaseException:
            if new and not folder.anything_done:
                with contextlib.suppress(OSError, ValueError):
                    _clear(folder)
                stack.close()
                disk.remove_empty(made)
            raise


def _begin(folder: ResumableFolder, *, overwrite: bool) -> bool:
    """Create a new folder or read an existing one; returns whether the work is new."""
    _refuse_foreign(folder)
    there = disk.is_file(folder.path / folder.layout.first)
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
    path, layout = folder.path, folder.layout
    holds = [name for name in disk.names(path.resolve()) if name != LOCK and not disk.is_part(name, *layout.names)]
    foreign = [name for name in holds if name not in layout.names]
    if foreign:
        raise ValueError(
            f"{path} holds {foreign[0]}, which is no part of a {layout.what}; choose another folder with --out"
        )
    if holds and layout.first not in holds:
        raise ValueError(f"{path} is not empty and holds no {layout.what}; choose another folder with --out")
    for name in holds:
        (disk.is_folder if layout.done_is_folder and name == layout.done else disk.is_file)(path / name)


def _sweep(folder: ResumableFolder) -> None:
    """Remove unfinished files that a dead process left."""
    path, layout = folder.path, folder.layout
    for name in disk.names(path.resolve()):
        if disk.is_part(name, *layout.names):
            disk.remove(path / name)
    if layout.done_is_folder:
        for name in disk.names(path / layout.done):
            if disk.is_part(name):
                disk.remove(path / layout.done / name)


def _clear(folder: ResumableFolder) -> None:
    """Remove earlier work: the results in one step, then the list of digests, and the description last."""
    path, layout = folder.path, folder.layout
    folder.refuse_foreign_parts()
    changed = folder.changed(disk.read_sums(path))
    if changed not in (None, layout.first):
        raise ValueError(
            f"{path} holds {changed}, which was changed since glucoloop wrote it, so it is not replaced; {_MOVE}"
        )
    for name in (layout.done, SUMS, *layout.files, layout.first):
        disk.remove(path / name)
    disk.sync(path)
