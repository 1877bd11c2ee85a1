"""File operations of this layer: files are written completely or not at all, and only files and folders are touched.

A folder may come from another person. A symbolic link, pipe, device or socket under one of its names is reported in an
error; it is never read, waited for, or written through.

A file being made has a name that begins with a dot and ends in ``.part``; it is on the disk before it is renamed, and a
folder is renamed before it is removed. So a process may die between any two operations, and `is_part` recognises what
it left. Each folder that this program writes holds the list of its files with their digests, `SUMS`.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import io
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.user_file import FILE, FOLDER, kind_of

try:
    import fcntl
except ImportError:  # Windows, where nothing is locked
    fcntl = None  # type: ignore[assignment]

_MENDS: Final = {
    errno.ENOSPC: "free some space",
    getattr(errno, "EDQUOT", errno.ENOSPC): "free some space",
    errno.EACCES: "change its permissions",
    errno.EPERM: "change its permissions",
    errno.EROFS: "mount the disk for writing",
    errno.EFBIG: "allow larger files",
    errno.EIO: "check the disk",
    errno.EMFILE: "allow more open files",
    errno.ENFILE: "close other programs",
    errno.ENAMETOOLONG: "give a shorter name",
}
"""Mends of errors of the system."""
SUMS: Final = "SHA256SUMS"
PART: Final = ".part"
LARGEST_BYTES: Final = 4_000_000_000
"""Largest size of a file that is read into memory."""

_SAFE: Final = (
    getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)
"""Flags for opening a file without following a link or waiting for a pipe."""
_CHUNK: Final = 1 << 20
_DIGITS: Final = 20
"""Most digits of the number of a process."""
_AT_CWD: Final = -100
_EXCHANGE: Final = 2


def mend(error: OSError, *others: str) -> str:
    """Mend of an error of the system, if one is known, or any of the other ones, as imperatives."""
    return " or ".join(filter(None, (_MENDS.get(error.errno or 0), *others)))


def kind(path: Path) -> str:
    """Kind of the object under a name, like ``"a pipe"``; the empty text if there is none."""
    try:
        mode = os.lstat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ""
    return kind_of(mode)


def is_file(path: Path) -> bool:
    """Whether there is a regular file; ValueError if something else stands there."""
    return _is(path, FILE)


def is_folder(path: Path) -> bool:
    """Whether there is a real folder; ValueError if something else stands there."""
    return _is(path, FOLDER)


def names(folder: Path) -> list[str]:
    """Names in a folder, in order; none if there is no folder."""
    return sorted(os.listdir(folder)) if is_folder(folder) else []


def is_part(name: str, *names: str) -> bool:
    """Whether a dead process left a file of this name unfinished or half removed, of given names or of any."""
    if not (name.startswith(".") and name.endswith(PART)):
        return False
    return not names or name[1 : -len(PART)] in names


def _part_of(path: Path) -> Path:
    """Temporary path of a file or folder while it is made or removed."""
    return path.parent / f".{path.name}{PART}"


def read_bytes(path: Path, most: int = LARGEST_BYTES) -> bytes:
    """Contents of a regular file; ValueError for something else, or for more than `most` bytes."""
    with _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise Refusal(f"{path} has {size} bytes, and at most {most} are expected; it is damaged or foreign")
        return file.read()


def digest(path: Path) -> str:
    """SHA-256 of a regular file in hexadecimal; the empty text if there is none, ValueError for something else."""
    if not is_file(path):
        return ""
    with _opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def put_file(place: Path, data: bytes) -> None:
    """Put a file in its place, replacing an earlier one."""
    is_file(place)
    part = _part_of(place)
    with _making(part):
        _write_new(part, data)
        os.replace(part, place)
    sync(place.parent)


def check_writable(place: Path) -> None:
    """Raise what `put_file` would raise where no file can be put, and leave the place as it is."""
    is_file(place)
    part = _part_of(place)
    with _making(part):
        _write_new(part, b"")
        remove(part)


def put_folder(place: Path, files: Mapping[str, bytes]) -> None:
    """Put a folder in its place, with its files and the list of their digests.

    An earlier folder gives way to it, in one step where the system can exchange two names.
    """
    part = _part_of(place)
    with _making(part):
        os.mkdir(part)
        for name, data in files.items():
            _write_new(part / name, data)
        _write_new(part / SUMS, sums_text({name: hashlib.sha256(data).hexdigest() for name, data in files.items()}))
        sync(part)
        if not kind(place):
            os.rename(part, place)
        elif not exchange(part, place):
            _replace(place, part)
    sync(place.parent)
    with contextlib.suppress(OSError):  # an earlier folder, now that the new one is in its place
        remove(part)


def exchange(one: Path, other: Path) -> bool:
    """Exchange two folders of the same disk in one step; False where the system cannot.

    Only Linux has such a call, and Python has none: between two renames there would be no folder under the name.
    """
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):
        return False
    if call(_AT_CWD, os.fsencode(one), _AT_CWD, os.fsencode(other), _EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
        return False
    raise OSError(code, os.strerror(code), str(one))


def recover(place: Path) -> None:
    """Remove what a dead process left beside the place of a folder; one that gave way to nothing is put back."""
    old = _old(place)
    if kind(old) and not kind(place):
        os.rename(old, place)
    for left in (old, _part_of(place)):
        remove(left)


def remove(path: Path) -> None:
    """Remove the object under a name, if there is one; a folder disappears in one step.

    A link is removed, and not its target.
    """
    result = kind(path)
    if not result:
        return
    if result != FOLDER:
        os.unlink(path)
        return
    if not is_part(path.name):
        part = _part_of(path)
        remove(part)
        os.rename(path, part)
        with contextlib.suppress(OSError):  # digests tell a folder of which a power cut leaves a part
            sync(path.parent)
        path = part
    shutil.rmtree(path)


@contextlib.contextmanager
def made_folders(path: Path, *, kept: bool = True) -> Iterator[None]:
    """Make a folder and its parents for the block; the new ones that are still empty are removed if it fails.

    Unless `kept`, they are removed in any case.
    """
    new = [folder for folder in (path, *path.parents) if not folder.is_dir()]
    try:
        os.makedirs(path, exist_ok=True)
        yield
    except BaseException:
        kept = False
        raise
    finally:
        for folder in () if kept else new:
            with contextlib.suppress(OSError):
                os.rmdir(folder)


def sync(folder: Path) -> None:
    """Flush changes of the names in a folder to the disk; Windows does so by itself and opens no folders."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # the user may have named it by a link
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sums_text(digests: Mapping[str, str]) -> bytes:
    """List of digests that ``sha256sum -c`` checks."""
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items())).encode()


def read_sums(folder: Path) -> dict[str, str]:
    """Digest of each name in the list of a folder, if it has one; ValueError if it is not as `sums_text` writes it."""
    place = folder / SUMS
    if not is_file(place):
        return {}
    text = read_bytes(place)
    try:
        lines = text.decode().splitlines()
        result = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    except UnicodeDecodeError:
        result = {}
    if not result or sums_text(result) != text:
        raise Refusal(f"{place} was changed since glucoloop wrote it; move it away and run the same command again")
    return result


@contextlib.contextmanager
def locked(lock: Path, what: Path) -> Iterator[None]:
    """Hold a lock during the block, a file with the number of this process; the lock of a dead process is free.

    A ValueError names who else is at work on `what`. Where the system locks nothing, nothing is locked.
    """
    if fcntl is None:
        yield
        return
    with contextlib.ExitStack() as stack:
        while True:
            descriptor = _open_lock(lock)
            stack.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno in (errno.EAGAIN, errno.EACCES):
                    raise Refusal(
                        f"another run writes to {what}{_whose(lock)}; wait for it, or choose another folder with --out"
                    ) from None
            if _is_still(lock, descriptor):
                break  # and the one who held it has not removed it
        try:
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"{os.getpid()}\n".encode())
            yield
        finally:
            with contextlib.suppress(OSError):  # while the lock is held, so that nobody else's is removed
                remove(lock)


def _open_lock(lock: Path) -> int:
    is_file(lock)
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | _SAFE, 0o666)
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        raise _refused(lock, "a file that has other names too", "a file of its own")
    return descriptor


def _is_still(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except OSError:
        return False


def _whose(lock: Path) -> str:
    try:
        return f" (process {int(read_bytes(lock, _DIGITS))})"
    except (OSError, ValueError):
        return ""


def _is(path: Path, wanted: str) -> bool:
    result = kind(path)
    if result not in ("", wanted):
        raise _refused(path, result, wanted)
    return bool(result)


def _refused(path: Path, result: str, wanted: str) -> Refusal:
    return Refusal(f"{path} is {result}, not {wanted}; move it away and run the same command again")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[io.BufferedReader]:
    _is(path, FILE)
    descriptor = os.open(path, os.O_RDONLY | _SAFE)
    try:
        with open(descriptor, "rb", closefd=False) as file:
            yield file
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _making(part: Path) -> Iterator[None]:
    """Make an object of a temporary name in the block; what an earlier process or a failure leaves is removed."""
    remove(part)
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            remove(part)
        raise


def _write_new(place: Path, data: bytes) -> None:
    """Write a file that does not exist yet, and flush it to the disk."""
    descriptor = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _SAFE, 0o666)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(descriptor, rest[:_CHUNK]) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _replace(place: Path, part: Path) -> None:
    """Put a folder in the place of an earlier one, which has another name for a moment; see `recover`."""
    old = _old(place)
    os.rename(place, old)
    try:
        os.rename(part, place)
    except BaseException:
        os.rename(old, place)
        raise
    with contextlib.suppress(OSError):
        remove(old)


def _old(place: Path) -> Path:
    return _part_of(place.parent / f"{place.name}.old")
