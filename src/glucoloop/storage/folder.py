"""An output folder that appears whole: built beside its place, and put there by renaming.

Each folder holds a list of its files with their digests, which ``sha256sum -c SHA256SUMS`` checks. An old folder gives
way only if it holds just these files, unchanged: what somebody else put or edited there is never lost.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

SUMS: Final = "SHA256SUMS"


class OutputFolder:
    """A folder in the making; see `output_folder`."""

    def __init__(self, path: Path, building: Path) -> None:
        self.path = path
        self._building = building

    def write(self, name: str, data: bytes | str) -> None:
        """Write one file."""
        with (self._building / name).open("wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            # A full disk is told now at the latest, and not after the swap.
            os.fsync(file.fileno())

    def names(self) -> list[str]:
        """Files written so far."""
        return sorted(file.name for file in self._building.iterdir() if file.name != SUMS)

    def paths(self) -> dict[str, str]:
        """Name -> where the file will be."""
        return {name: str(self.path / name) for name in self.names()}

    def seal(self) -> None:
        """List the files with their digests."""
        self.write(SUMS, "".join(f"{_digest(self._building / name)}  {name}\n" for name in self.names()))


@contextlib.contextmanager
def output_folder(path: Path, *, overwrite: bool) -> Iterator[OutputFolder]:
    """A folder to write to; it is at its place when the block ends, and nothing has changed if the block fails.

    Raises
    ------
    ValueError
        Before the block runs, if the place is taken or cannot be written to.
    """
    place = path.resolve()
    _refuse_taken(path, place, overwrite=overwrite)
    made = _make_parents(place.parent, path)
    try:
        try:
            building = Path(tempfile.mkdtemp(dir=place.parent, prefix=f".{place.name}."))
        except OSError as error:
            raise ValueError(
                f"the output folder {path} cannot be written: {error.strerror}; choose another with --out"
            ) from None
        try:
            folder = OutputFolder(path, building)
            yield folder
            folder.seal()
            # A temporary folder is its owner's alone; the result is as open as any new folder.
            building.chmod(0o777 & ~_umask())
            _refuse_taken(path, place, overwrite=overwrite)
            _swap(building, place)
        finally:
            shutil.rmtree(building, ignore_errors=True)
    except BaseException:
        for parent in made:
            with contextlib.suppress(OSError):
                parent.rmdir()
        raise


def _refuse_taken(path: Path, place: Path, *, overwrite: bool) -> None:
    if not place.exists():
        return
    if not place.is_dir():
        raise ValueError(f"{path} is a file, not a folder; choose another place with --out")
    if Path.cwd().is_relative_to(place):
        raise ValueError(f"{path} is the folder you are in, which cannot be replaced; choose another with --out")
    try:
        holds = sorted(entry.name for entry in place.iterdir())
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
        lines = (place / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return f"{holds[0]}, which glucoloop did not write"
    sums = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    for name in holds:
        if name == SUMS:
            continue
        file = place / name
        if name not in sums or file.is_symlink() or not file.is_file():
            return f"{name}, which glucoloop did not write"
        if _digest(file) != sums[name]:
            return f"{name}, which was changed since glucoloop wrote it"
    return ""


def _make_parents(parent: Path, path: Path) -> list[Path]:
    """Make the folders that lead to the place; returns the new ones, the deepest first."""
    missing = [folder for folder in (parent, *parent.parents) if not folder.exists()]
    try:
        parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"the output folder {path} cannot be made: {error.strerror}; choose another with --out"
        ) from None
    return missing


def _swap(building: Path, place: Path) -> None:
    """Put the new folder in its place; if that fails, the old one is back."""
    if not place.exists():
        building.rename(place)
        return
    aside = Path(tempfile.mkdtemp(dir=place.parent, prefix=f".{place.name}."))
    old = aside / place.name
    try:
        place.rename(old)
        try:
            building.rename(place)
        except BaseException:
            old.rename(place)
            raise
    except BaseException:
        # Not a tree: if the old folder could not be put back, it stays where it is.
        with contextlib.suppress(OSError):
            aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
