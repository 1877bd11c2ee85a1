"""The folder of long work: what is done stays, a run that was cut short goes on, and what is damaged is refused.

The first file says what the work is; the list of digests, written last, marks it as finished. Between two operations
on the disk a process may die, and the next one finds what was done, sweeps what was in the making, and goes on.
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
    """What a folder may hold."""

    what: str
    """The work: ``"trial"``."""
    first: str
    """File that says what the work is: written first, removed last."""
    files: tuple[str, ...]
    """Further files, in the order of their removal."""
    done: str
    """What is done so far, which is added to step by step."""
    done_is_folder: bool

    @property
    def names(self) -> tuple[str, ...]:
        """All that may be in the folder."""
        return (self.first, *self.files, self.done, SUMS, LOCK)


class ResumableFolder(ABC):
    """A folder that this process may write to; see `opened`."""

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path = path
        self.layout = layout
        self.notes: tuple[str, ...] = ()
        """What else is worth knowing, one sentence each."""

    @property
    def finished(self) -> bool:
        """Whether all that was asked for is there."""
        return disk.is_file(self.path / SUMS)

    @property
    @abstractmethod
    def anything_done(self) -> bool:
        """Whether there is something that would be lost with the folder."""

    @property
    @abstractmethod
    def kept(self) -> str:
        """What is done, for messages: ``"3 of 5 shards are done and kept"``."""

    @abstractmethod
    def create(self) -> None:
        """Say what the work is, in a folder that holds nothing."""

    @abstractmethod
    def load(self) -> None:
        """Take up what is there.

        Raises
        ------
        ValueError
            If it is other work, or damaged. Nothing has changed then.
        """

    @abstractmethod
    def refuse_foreign_parts(self) -> None:
        """Raise ValueError if what is done so far, by whatever work, is mixed with what this program does not write."""

    def put_file(self, name: str, data: bytes) -> None:
        """Put a file in its place.

        Raises
        ------
        ValueError
            If it cannot be written; what is done stays.
        """
        with self.unwritten(name):
            disk.put_file(self.path / name, data)

    @contextlib.contextmanager
    def unwritten(self, what: str) -> Iterator[None]:
        """Tell an error of the disk in the block."""
        try:
            yield
        except OSError as error:
            raise ValueError(
                f"{what} cannot be written to {self.path}: {error.strerror}; {self.kept}, free some space and run the "
                "same command again"
            ) from None

    def changed(self, sums: Mapping[str, str]) -> str | None:
        """The first file of the folder itself that is there, but not as a list of digests says."""
        layout = self.layout
        for name in (layout.first, *layout.files, *([] if layout.done_is_folder else [layout.done])):
            there = disk.digest(self.path / name)
            if there and name in sums and there != sums[name]:
                return name
        return None

    def refuse_changed(self, sums: Mapping[str, str]) -> None:
        """Raise ValueError if a file of the folder itself is not as a list of digests says."""
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
        Begin again, unless the folder holds the very same work and that is not finished: then it goes on.

    Raises
    ------
    ValueError
        If the place is taken by something else, by other work or by another run, if what is there is damaged, or if
        the folder cannot be written to. A new folder is gone again if the block fails before anything is done.
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
    """Create what is not there, and take up what is; returns whether the work is new."""
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
    """Whether the folder holds the same work, whole as far as it got, and that is not finished."""
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
    """Remove what a process that died left in the making."""
    path, layout = folder.path, folder.layout
    for name in disk.names(path.resolve()):
        if disk.is_part(name, *layout.names):
            disk.remove(path / name)
    if layout.done_is_folder:
        for name in disk.names(path / layout.done):
            if disk.is_part(name):
                disk.remove(path / layout.done / name)


def _clear(folder: ResumableFolder) -> None:
    """Take earlier work away: what was done in one step, then the list of digests, and what it is about last."""
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
