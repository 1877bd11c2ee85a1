"""Store of the traces of a trial, at an address: those of a shard are written there by the process that computed them.

Traces are the largest part of a trial, and nothing is computed from them again. All else stays in the folder of the
trial, whose shards list size and digest of what is in the store. Names in the store are those of the folder, and its
record, ``trial.json``, says to which trial it belongs: nothing is written beside another one, and nothing is deleted.

A store of objects, which fsspec reaches, shows an object when it is whole; in a file system that machines share a file
gets its name when it is whole. Credentials are those of the environment of each process. An address with a password is
refused, since the address is written into the folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Protocol

from glucoloop.refusal import Refusal, needed_for
from glucoloop.schema.values import ValueBounds
from glucoloop.storage import disk
from glucoloop.text import one_line

_PACKAGES: Final = {"abfs": "adlfs", "az": "adlfs", "gcs": "gcsfs", "gs": "gcsfs", "s3": "s3fs", "s3a": "s3fs"}
"""Package that fsspec needs for each protocol of a store of objects."""
_FILE: Final = "file"
"""Protocol of a file system."""
_ADDRESS: Final = re.compile(r"(?P<protocol>[a-z0-9]+)://(?P<place>[\w./@=+~-]*[\w.=+~-])/*")
"""Address without a password, a query or a pattern."""
_RECORD: Final = "trial.json"
MEND: Final = "delete its shard in the folder of the trial, and run the command of the trial again"
"""Mend of a table that is not as it was written."""


@dataclass(frozen=True, kw_only=True)
class StoredTable:
    """A table in a store, as the record of its shard lists it."""

    rows: Annotated[int, ValueBounds(at_least=0)]
    bytes: Annotated[int, ValueBounds(at_least=0, at_most=disk.LARGEST_BYTES)]
    """Size of the file."""
    sha256: str


def store_address(text: str) -> str:
    """The address of a store of traces, without a slash at its end.

    A Refusal tells, before anything is designed, that it is none, or that a package for it is not installed. What is no
    address is not repeated, for it may hold a password.
    """
    match = _ADDRESS.fullmatch(text)
    protocols = (*_PACKAGES, _FILE)
    possible = match is not None and match["protocol"] in protocols
    if match is None or not possible or (match["protocol"] == _FILE and not match["place"].startswith("/")):
        raise Refusal(
            "what is given for traces is no address of a store; give one like s3://bucket/folder or "
            f"file:///shared/folder, without a password, of one of the protocols {', '.join(protocols)}"
        )
    address = f"{match['protocol']}://{match['place']}"
    _files_at(address)
    return address


@dataclass(frozen=True)
class TraceStore:
    """The store of one trial; a process of any machine may write to it."""

    address: str
    record: bytes
    """Record of the trial, which is the first file of the store."""

    def begin(self) -> None:
        """Write the record into an empty store; Refusal for a store that has another one, or cannot be used."""
        if self.refuse_other():
            with refusing(self.address, "written"):
                _files_at(self.address).write(_RECORD, self.record)

    def refuse_other(self) -> bool:
        """Refuse a store that holds anything but this trial; returns whether it is empty."""
        files = _files_at(self.address)
        with refusing(self.address, "read"):
            earlier = files.read(_RECORD, len(self.record) + 1)
            others = [] if earlier is not None else files.names()
        if others:
            raise Refusal(
                f"{self.address} holds {others[0]} and no traces of a trial", "give an empty place with --traces-at"
            )
        if earlier not in (None, self.record):
            raise Refusal(f"{self.address} holds the traces of another trial", "give another address with --traces-at")
        return earlier is None

    def put(self, name: str, data: bytes, rows: int) -> StoredTable:
        """Write a table of so many rows; Refusal if it cannot be written, or if the record of the trial is not there.

        A process that does not see the record has another place under the same address, such as its own disk.
        """
        if self.refuse_other():
            raise Refusal(
                f"{self.address} does not hold {_RECORD}, which was written there at the beginning; give a place that "
                "all machines see"
            )
        with refusing(f"{self.address}/{name}", "written"):
            _files_at(self.address).write(name, data)
        return StoredTable(rows=rows, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def refuse_changed(address: str, tables: Mapping[str, StoredTable], mend: str) -> None:
    """Refuse a store in which one of these tables is not there in its size; the sentence ends in a mend."""
    with refusing(address, "read"):
        sizes = _files_at(address).sizes() if tables else {}
    for name, table in tables.items():
        if sizes.get(name) != table.bytes:
            raise Refusal(f"{address}/{name} is gone or was changed since glucoloop wrote it; {mend}")


def read_stored(address: str, name: str, stored: StoredTable) -> bytes:
    """Contents of a table of a store; Refusal if it cannot be read, or is not as it was written."""
    place = f"{address}/{name}"
    with refusing(place, "read"):
        data = _files_at(address).read(name, stored.bytes + 1)
    if data is None or len(data) != stored.bytes or hashlib.sha256(data).hexdigest() != stored.sha256:
        raise Refusal(f"{place} is gone or was changed since glucoloop wrote it; {MEND}")
    return data


class _Files(Protocol):
    """Files under an address; each library has errors of its own."""

    def read(self, name: str, most: int) -> bytes | None:
        """Contents of a file, at most so many bytes; None if there is none."""

    def write(self, name: str, data: bytes) -> None:
        """Write a file, which appears whole, and replaces an earlier one."""

    def names(self) -> list[str]:
        """Names right under the address."""

    def sizes(self) -> dict[str, int]:
        """Sizes of all files, by their names."""


@dataclass(frozen=True)
class _FileSystem:
    """Files in a folder."""

    folder: Path

    def read(self, name: str, most: int) -> bytes | None:
        place = self.folder / name
        return disk.read_bytes(place)[:most] if disk.is_file(place) else None

    def write(self, name: str, data: bytes) -> None:
        os.makedirs((self.folder / name).parent, exist_ok=True)
        disk.put_file(self.folder / name, data)

    def names(self) -> list[str]:
        return [name for name in disk.names(self.folder) if not disk.is_part(name)]

    def sizes(self) -> dict[str, int]:
        files = (place for place in self.folder.rglob("*") if place.is_file())
        return {place.relative_to(self.folder).as_posix(): place.stat().st_size for place in files}


@dataclass(frozen=True)
class _Objects:
    """Objects of a store, by a file system of fsspec."""

    system: Any
    root: str

    def read(self, name: str, most: int) -> bytes | None:
        try:
            data: bytes = self.system.cat_file(f"{self.root}/{name}", start=0, end=most)
        except FileNotFoundError:
            return None
        return data

    def write(self, name: str, data: bytes) -> None:
        self.system.pipe_file(f"{self.root}/{name}", data)

    def names(self) -> list[str]:
        try:
            names = [name.rstrip("/") for name in self.system.ls(self.root, detail=False)]
        except FileNotFoundError:  # also that of a bucket, which writing tells
            return []
        return [name.rpartition("/")[2] for name in names if name != self.root]

    def sizes(self) -> dict[str, int]:
        listed = self.system.find(self.root, detail=True)
        return {name[len(self.root) + 1 :]: entry["size"] for name, entry in listed.items()}


def _files_at(address: str) -> _Files:
    protocol, _, place = address.partition("://")
    if protocol == _FILE:
        return _FileSystem(Path(place))
    return _Objects(*system_of(address))


def system_of(address: str) -> tuple[Any, str]:
    """File system of fsspec for an address of a store of objects, and the path in it; Refusal if a package lacks."""
    with needed_for("a store of traces"):
        from fsspec.core import url_to_fs
    package = _PACKAGES[address.partition("://")[0]]
    with refusing(address, "used"):
        try:
            system, root = url_to_fs(address, use_listings_cache=False)  # for others write to it
        except ImportError:
            raise Refusal(f"{address} needs {package}; install it with: pip install {package}") from None
    return system, root.rstrip("/")


def file_system_path(address: str) -> Path | None:
    """Path of a store that is a folder; None for a store of objects."""
    files = _files_at(address)
    return files.folder if isinstance(files, _FileSystem) else None


@contextlib.contextmanager
def refusing(place: str, verb: str) -> Iterator[None]:
    """Report any error in the block as a Refusal: each of the libraries of stores has classes of its own."""
    try:
        yield
    except (Refusal, MemoryError):
        raise
    except Exception as error:
        why, way = one_line(error), ""
        if isinstance(error, OSError) and error.filename:  # of a file system
            why, way = error.strerror or why, disk.mend(error)
        way = way or "check the address, the credentials and the store"
        raise Refusal(f"{place} cannot be {verb}: {why or type(error).__name__}; {way}") from None
