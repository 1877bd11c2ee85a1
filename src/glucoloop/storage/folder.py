"""Output folder that appears complete: it is built beside its place, and moved there in one step.

Each folder holds a list of its files with their digests, which ``sha256sum -c SHA256SUMS`` checks. An old folder is
replaced only if it holds exactly these files, unchanged: files that a person added or edited are never lost.

A folder being made is a hidden one beside its place, locked by its process; the next command that writes to the same
place removes those of dead processes.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS

_OLD: Final = ".old"
"""Suffix of the name of a replaced folder, where two names cannot be exchanged in one step."""


class OutputFolder:
    """A folder being made; see `output_folder`."""

    def __init__(self, path: Path, building: Path) -> None:
        self.path = path
        self._building = building
        self._digests: dict[str, str] = {}

    def write(self, name: str, data: bytes | str) -> None:
        """Write one file and flush it to the disk, so that a full disk is noticed here at the latest."""
        data = data.encode() if isinstance(data, str) else data
        if name in self._digests:
            disk.remove(self._building / name)
        disk.write_new(self._building / name, data)
        self._digests[name] = hashlib.sha256(data).hexdigest()

    def names(self) -> list[str]:
        """Names of the files written so far."""
        return sorted(self._digests)

    def paths(self) -> dict[str, str]:
        """Final path of each file, by name."""
        return {name: str(self.path / name) for name in self.names()}

    def seal(self) -> None:
        """Write the list of the files with their digests."""
        disk.write_new(self._building / SUMS, disk.sums_text(self._digests))
        disk.sync(self._building)


@contextlib.contextmanager
def output_folder(path: Path, *, overwrite: bool) -> Iterator[OutputFolder]:
    """A folder to write to; it appears at its place when the block ends, and nothing changes if the block fails.

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
            told, own = "it is a loop of symbolic links", ""
            if isinstance(error, OSError):
                told, own = str(error.strerror), disk.mend(error)
            ways = " or ".join(filter(None, (own, "choose another with --out")))
            raise Refusal(f"the output folder {path} cannot be made: {told}; {ways}") from None
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
        raise Refusal(f"{path} is {there}, not a folder; choose another place with --out")
    if Path.cwd().is_relative_to(place):
        raise Refusal(f"{path} is the folder you are in, which cannot be replaced; choose another with --out")
    try:
        holds = disk.names(place)
    except OSError as error:
        ways = " or ".join(filter(None, (disk.mend(error), "choose another")))
        raise Refusal(f"the output folder {path} cannot be read: {error.strerror}; {ways}") from None
    if not holds:
        return
    foreign = _not_ours(place, holds)
    if foreign and overwrite:
        raise Refusal(
            f"{path} holds {foreign}, so it is not replaced; move that away, or choose another folder with --out"
        )
    if foreign:
        raise Refusal(f"{path} is not empty; choose another folder with --out")
    if not overwrite:
        raise Refusal(f"{path} holds an earlier result; choose another folder with --out, or add --overwrite")


def _not_ours(place: Path, holds: list[str]) -> str:
    """Files in the folder that glucoloop did not write, in words, or the empty text."""
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
    """A new hidden folder beside a place, locked during the block where the system can."""
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
    """Remove the leftovers of dead processes beside a place; a replaced folder without a successor is restored."""
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
    """Names in a folder; none in one that can be written but not read."""
    try:
        return disk.names(folder)
    except OSError:
        return []


def _swap(building: Path, place: Path) -> None:
    """Put the new folder in its place, in one step where the system can; the old one takes the place of the new one."""
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
