"""Output folder that appears complete: it is built beside its place, and moved there in one step.

Each folder holds a list of its files with their digests, which ``sha256sum -c SHA256SUMS`` checks. An old folder is
replaced only if it holds exactly these files, unchanged: files that a person added or edited are never lost.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path

from glucoloop.refusal import Refusal
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS


class OutputFolder:
    """A folder being made; see `output_folder`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files: dict[str, bytes] = {}
        """Contents of the files so far, by name."""

    def write(self, name: str, data: bytes | str) -> None:
        """Add a file, or replace one that was added before."""
        self.files[name] = data.encode() if isinstance(data, str) else data

    def paths(self) -> dict[str, str]:
        """Final path of each file, by name."""
        return {name: str(self.path / name) for name in sorted(self.files)}


@contextlib.contextmanager
def output_folder(path: Path, *, overwrite: bool, holds: Collection[str] = ()) -> Iterator[OutputFolder]:
    """A folder to write to; it appears at its place when the block ends, and nothing changes if the block fails.

    `holds` are names of files that every folder of the same command holds; results without them are those of another
    command, and are not replaced. A ValueError before the block tells that the place is taken or cannot be written to,
    or that another run is at work.
    """
    with contextlib.ExitStack() as stack:
        try:
            place = path.resolve()
            stack.enter_context(disk.made_folders(place.parent))
            stack.enter_context(disk.locked(place.parent / f".{place.name}.lock", path))
            disk.recover(place)
            _refuse_taken(path, place, holds, overwrite=overwrite)
        except (FileExistsError, NotADirectoryError):
            raise Refusal(
                f"the output folder {path} cannot be made, since a part of its path is a file; "
                "choose another with --out"
            ) from None
        except OSError as error:
            mend = disk.mend(error, "choose another with --out")
            raise Refusal(f"the output folder {path} cannot be made: {error.strerror}; {mend}") from None
        except RuntimeError:  # of Python before 3.13
            raise Refusal(f"the output folder {path} is a loop of links; choose another with --out") from None
        folder = OutputFolder(path)
        yield folder
        _refuse_taken(path, place, holds, overwrite=overwrite)
        disk.put_folder(place, folder.files)


def _refuse_taken(path: Path, place: Path, ours: Collection[str], *, overwrite: bool) -> None:
    kind = disk.kind(place)
    if not kind:
        return
    if kind != "a folder":
        raise Refusal(f"{path} is {kind}, not a folder; choose another place with --out")
    if Path.cwd().is_relative_to(place):
        raise Refusal(f"{path} is the folder you are in, which cannot be replaced; choose another with --out")
    try:
        holds = disk.names(place)
    except OSError as error:
        mend = disk.mend(error, "choose another")
        raise Refusal(f"the output folder {path} cannot be read: {error.strerror}; {mend}") from None
    if not holds:
        return
    foreign = _not_ours(place, holds)
    if foreign and overwrite:
        raise Refusal(
            f"{path} holds {foreign}, so it is not replaced; move that away, or choose another folder with --out"
        )
    if foreign:
        raise Refusal(f"{path} is not empty; choose another folder with --out")
    missing = [name for name in ours if name not in holds]
    if missing:
        raise Refusal(
            f"{path} holds the results of another command, for there is no {missing[0]}, and they are not replaced; "
            "choose another folder with --out"
        )
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
