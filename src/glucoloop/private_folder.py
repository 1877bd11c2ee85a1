"""Folders whose contents are run or accepted, so that nobody else may write to them, nor put another in their place."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal

_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH
_MAX_LINKS: Final = 40


def refuse_of_others(folder: Path) -> None:
    """Refuse a folder that another user owns or can write to, or could replace by way of a folder above it.

    As in OpenSSH, each folder from the root on has to be of this user or of root, and no others may write to it; a
    folder above may be shared if nobody can rename what others own in it, as ``/tmp``. Links on the way are followed,
    and the folders that hold them are checked too. A folder that does not exist yet is judged by those above it.
    """
    if os.name == "nt":
        return
    me, itself = os.getuid(), (_absolute(folder), Path(os.path.realpath(folder)))
    for place in _way_to(folder):
        try:
            result = os.lstat(place)
        except (FileNotFoundError, NotADirectoryError):
            continue
        if place in itself:
            if result.st_uid != me:
                raise Refusal(f"{folder} belongs to another user")
            if stat.S_ISDIR(result.st_mode) and result.st_mode & _OTHERS_WRITE:
                raise Refusal(f"others can write to {folder}; empty it and run chmod 700 on it")
        elif result.st_uid not in (0, me):
            raise Refusal(f"another user can put another folder in the place of {folder}, since {place} is theirs")
        elif stat.S_ISDIR(result.st_mode) and _others_replace(result):
            raise Refusal(f"others can put another folder in the place of {folder}, since they can write to {place}")


@contextlib.contextmanager
def private_temporary_folder(prefix: str) -> Iterator[Path]:
    """A temporary folder in which programs are made and run; Refusal where others could replace it."""
    with tempfile.TemporaryDirectory(prefix=prefix) as name:
        try:
            refuse_of_others(Path(name))
        except Refusal as error:
            raise Refusal(f"{error}; set TMPDIR to a folder of yours") from None
        yield Path(name)


def _way_to(folder: Path) -> Iterator[Path]:
    """The folder and all that are above it, of each link on the way too."""
    to_do, seen, links = [_absolute(folder)], set[Path](), 0
    while to_do:
        end = to_do.pop()
        for place in (end, *end.parents):
            if place in seen:
                continue
            seen.add(place)
            yield place
            if place.is_symlink():
                links += 1
                if links > _MAX_LINKS:
                    raise Refusal(f"{folder} lies behind more than {_MAX_LINKS} links")
                target = _absolute(place.parent / os.readlink(place))
                to_do.append(target / end.relative_to(place))


def _absolute(place: Path) -> Path:
    return Path(os.path.abspath(place))


def _others_replace(result: os.stat_result) -> bool:
    """Whether others can rename what a folder holds: write to it, and no sticky bit. A group of one is nobody else."""
    if result.st_mode & stat.S_ISVTX:
        return False
    return bool(result.st_mode & stat.S_IWOTH or (result.st_mode & stat.S_IWGRP and not _is_own_group(result.st_gid)))


def _is_own_group(group: int) -> bool:
    """Whether a group is of this user alone, by its name and its members, as systems with a group for each user do."""
    import grp
    import pwd

    try:
        user, of_group = pwd.getpwuid(os.getuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return group == user.pw_gid and of_group.gr_name == user.pw_name and {*of_group.gr_mem} <= {user.pw_name}
