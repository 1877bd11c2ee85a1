"""An output folder that appears whole: built beside its place, and put there in one step.

Each folder holds a list of its files with their digests, which ``sha256sum -c SHA256SUMS`` checks. An old folder gives
way only if it holds just these files, unchanged: what somebody else put or edited there is never lost.

A folder in the making is a hidden one beside its place, locked by the process that makes it; the next command that
writes to the same place sweeps those of processes that died.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS

_OLD: Final = ".old"
"""Ends the name of a folder that gives way, where two names cannot be exchanged in one step."""


class OutputFolder:
    """A folder in the making; see `output_folder`."""

    def __init__(self, path: Path, building: Path) -> None:
        self.path = path
        self._building = building
        self._digests: dict[str, str] = {}

    def write(self, name: str, data: bytes | str) -> None:
        """Write one file, down to the disk, so that a full one is told now at the latest."""
        data = data.encode() if isinstance(data, str) else data
        if name in self._digests:
            disk.remove(self._building / name)
        disk.write_new(self._building / name, data)
        self._digests[name] = hashlib.sha256(data).hexdigest()

    def names(self) -> list[str]:
        """Files written so far."""
        return sorted(self._digests)

    def paths(self) -> dict[str, str]:
        """Name -> where the file will be."""
        return {name: str(self.path / name) for name in self.names()}

    def seal(self) -> None:
        """List the files with their digests."""
        disk.write_new(self._building / SUMS, disk.sums_text(self._digests))
        disk.sync(self._building)


@contextlib.contextmanager
def output_folder(path: Path, *, overwrite: bool) -> Iterator[OutputFolder]:
    """A folder to write to; it is at its place when the block ends, and nothing has changed if the block fails.

    Raises
    ------
    ValueError
        Before the block runs, if the place is taken or cannot be written to.
    """
    made = list[Path]()
    with contextlib.ExitStack() as stack:
        try:
            place = path.resolve()
            made = disk.make_folders(place.parent)
            _recover(place)
            _refuse_taken(path, place, overwrite=overwrite)
            building = stack.enter_context(_new_folder(place))
        except (OSError, RuntimeError) as error:  # RuntimeError: a loop of links, in Python before 3.13
            disk.remove_empty(made)
            told = error.strerror if isinstance(error, OSError) else "it is a loop of symbolic links"
            raise ValueError(f"the output folder {path} cannot be made: {told}; choose another with --out") from None
        except ValueError:
            disk.remove_empty(made)
            raise
        try:
            folder = OutputFolder(path, building)
            yield folder
            folder.seal()
            _refuse_taken(path, place, overwrite=overwrite)
            _swap(building, place)
        except BaseException:
            with contextlib.suppress(OSError):
                disk.remove(building)
                disk.remove_empty(made)
            raise
        # Of an old folder that gave way; the new one is in its place, whatever happens to this one.
        with contextlib.suppress(OSError):
            disk.remove(building)


def _refuse_taken(path: Path, place: Path, *, overwrite: bool) -> None:
    there = disk.kind(place)
    if not there:
        return
    if there != "a folder":
        raise ValueError(f"{path} is {there}, not a folder; choose another place with --out")
    if Path.cwd().is_relative_to(place):
        raise ValueError(f"{path} is the folder you are in, which cannot be replaced; choose another with --out")
    try:
        holds = disk.names(place)
    except OSError as error:
        raise ValueError(f"the output folder {path} cannot be read: {error.strerror}; choose another") from None
    if not holds:
        return
    foreign = _not_ours(place, holds)
    if foreign and overwrite:
        raise ValueError(
            f"{path} holds {foreign}, so it is not replaced; move that away, or choose another folder with --out"
        )
    if foreign:
        raise ValueError(f"{path} is not empty; choose another folder with --out")
    if not overwrite:
        raise ValueError(f"{path} holds an earlier result; choose another folder with --out, or add --overwrite")


def _not_ours(place: Path, holds: list[str]) -> str:
    """What the folder holds that glucoloop did not write, or the empty text."""
    try:
        sums = disk.read_sums(place)
    except (OSError, ValueError):
        return f"{SUMS}, which glucoloop did not write"
    for name in holds:
        if name == SUMS:
            continue
        if name not in sums or disk.kind(place / name) != "a file":
            return f"{name}, which glucoloop did not write"
        if disk.digest(place / name) != sums[name]:
            return f"{name}, which was changed since glucoloop wrote it"
    return ""


@contextlib.contextmanager
def _new_folder(place: Path) -> Iterator[Path]:
    """A new hidden folder beside a place, locked while the block runs where the system can."""
    building = place.with_name(f".{place.name}.{secrets.token_hex(4)}{disk.PART}")
    with contextlib.ExitStack() as stack:
        try:
            disk.make_folders(building)
            if disk.can_lock():
                with contextlib.suppress(OSError):
                    stack.enter_context(disk.flocked(building, create=False))
        except BaseException:
            with contextlib.suppress(OSError):
                disk.remove(building)
            raise
        yield building


def _recover(place: Path) -> None:
    """Sweep what processes that died left beside a place; an old folder that gave way to nothing is put back."""
    if not disk.can_lock():
        return
    ours = re.compile(rf"\.{re.escape(place.name)}\.[0-9a-f]{{8}}({re.escape(_OLD)})?{re.escape(disk.PART)}")
    for name in filter(ours.fullmatch, _names(place.parent)):
        left = place.with_name(name)
        with contextlib.suppress(OSError, ValueError), disk.flocked(left, create=False) as held:
            if held is None:
                continue  # somebody is at work there
            if name.endswith(f"{_OLD}{disk.PART}") and not disk.kind(place):
                disk.rename(left, place)
            else:
                disk.remove(left)


def _names(folder: Path) -> list[str]:
    """Names in a folder; none in one that can be written to, but not read."""
    try:
        return disk.names(folder)
    except OSError:
        return []


def _swap(building: Path, place: Path) -> None:
    """Put the new folder in its place, in one step where the system can; the old one is then where the new one was."""
    if not disk.kind(place):
        disk.rename(building, place)
    elif not disk.exchange(building, place):
        old = building.with_name(f"{building.name.removesuffix(disk.PART)}{_OLD}{disk.PART}")
        try:
            disk.rename(place, old)
            disk.rename(building, place)
        except BaseException:
            if not disk.kind(place):
                disk.rename(old, place)
            raise
        with contextlib.suppress(OSError):
            disk.rename(old, building)
    disk.sync(place.parent)
