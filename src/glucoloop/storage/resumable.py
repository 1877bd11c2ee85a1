"""Folder of a long computation: results stay, an interrupted run resumes, and damaged results are refused.

The first file is the origin of the results, the configuration, the version and the arithmetic that they depend on; the
list of digests, written last, marks the work as finished. A process may die between any two operations on the disk; the
next one reads the results, removes unfinished files, and resumes.

The results are either one file with a row for each unit of work, see `storage.rows`, or a folder of parts that are put
in their places whole, see `trials.folder`. Each of them says what its results are; the rest is written here.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Self, TypeVar

import glucoloop
from glucoloop import arithmetic
from glucoloop.component.code import outside_code
from glucoloop.refusal import Refusal
from glucoloop.situations.toml import toml_text
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import json_text, stored_json
from glucoloop.text import shown


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Record on which the bits of the results depend, written before anything else; a kind of folder may add to it."""

    format: str = "glucoloop-rows 1"
    version: str
    """Version of glucoloop."""
    arithmetic: dict[str, str]
    """Record of `glucoloop.arithmetic.identity`, with digests of the code of other packages."""
    config: dict[str, Any]
    """The configuration as flat keys."""

    @classmethod
    def current(cls, config: Mapping[str, Any], **further: Any) -> Self:
        """Origin of work that begins now."""
        given = {key: value for key, value in config.items() if value is not None}
        identity = {**arithmetic.identity(), **outside_code(given)}
        return cls(version=glucoloop.__version__, arithmetic=identity, config=given, **further)

    def text(self) -> str:
        """JSON from which the same origin is read."""
        return json_text(vars(self)) + "\n"

    @classmethod
    def read(cls, place: Path) -> Self:
        """Read the record of a folder; ValueError if glucoloop did not write it."""
        mend = f"delete {place.parent} and run the same command again"
        written = stored_json(place, mend, dict[str, Any]).get("format")
        if written != cls.format:
            raise Refusal(
                f"{place} is of another format, {shown(written)} and not {cls.format}; read it with the glucoloop that "
                "wrote it"
            )
        return stored_json(place, mend, cls)


def differences(earlier: Mapping[str, Any], current: Mapping[str, Any]) -> Iterator[tuple[str, object, object]]:
    """Name, earlier value and current value of each key of two configurations that differs; cases by their labels."""
    before, now = _flat(earlier), _flat(current)
    for name in dict.fromkeys([*now, *before]):
        one, other = before.get(name), now.get(name)
        if json_text(one, str) != json_text(other, str):  # TOML also has dates, which no configuration has
            yield name, "not given" if one is None else one, "not given" if other is None else other


def _flat(config: Mapping[str, Any]) -> dict[str, object]:
    """Values of a configuration by the names of the keys, also of those in tables and cases."""
    result: dict[str, object] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            result |= {f"{key}.{name}": item for name, item in _flat(value).items()}
        elif key == "controller" and _are_cases(value):
            result["the list of cases"] = ", ".join(str(case["label"]) for case in value)
            for case in value:
                result |= {f"{name} of case {case['label']!r}": item for name, item in _flat(case).items()}
        else:
            result[key] = value
    return result


def _are_cases(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(case, dict) and "label" in case for case in value)


LOCK: Final = "lock"


@dataclass(frozen=True, kw_only=True)
class Work:
    """Work of a command that may take long, and the files that it leaves."""

    command: str
    """Name of the command, and of its configuration file."""
    what: str
    """Name of the work in messages: ``"trial"``."""
    keys: Mapping[str, Any]
    """Configuration as flat keys, with the values that are used."""
    explicit: Mapping[str, Any] | None = None
    """Flat keys from which they follow, if it was read from fewer."""
    final: tuple[str, ...]
    """Names of the files that are written when everything is done."""
    may_change: frozenset[str] = frozenset()
    """Keys for how far the work goes, which may differ when it is resumed."""

    @property
    def configuration(self) -> str:
        """Name of the file that repeats the work."""
        return f"{self.command}.toml"


class ResumableFolder(ABC):
    """A folder that this process may write to; see `opened`.

    The `results` so far are a file that is written again as it grows, or a folder of parts. `wanted` results are asked
    for, called `unit` in messages, ``"shards"``.
    """

    record: ClassVar[str]
    """Name of the first file, which holds the origin of the results."""
    in_parts: ClassVar[bool]
    """Whether the results are a folder of parts."""

    def __init__(self, path: Path, work: Work, origin: Origin, *, results: str, wanted: int, unit: str) -> None:
        self.path, self.work = path, work
        self.origin = self.recorded = origin
        """Origin of the results that are computed now, and the one that the folder records."""
        self.wanted, self.unit = wanted, unit
        self.notes: tuple[str, ...] = ()
        """Further notes, one sentence each."""
        self._files = (self.record, work.configuration, *work.final, *([] if self.in_parts else [results]))
        self._results = results

    @property
    @abstractmethod
    def done(self) -> int:
        """Number of results that are written."""

    @abstractmethod
    def _read_done(self) -> None:
        """Read the results so far; ValueError if they are damaged, foreign, or more than was asked for."""

    @abstractmethod
    def write_pending(self) -> None:
        """Write the results that are not written yet."""

    def _part_digests(self) -> dict[str, str]:
        """Digests of the files in the folder of results, by their path in this folder."""
        return {}

    @property
    def progress(self) -> str:
        """Extent of the results, for messages: ``"3 of 5 shards"``."""
        return f"{self.done} of {self.wanted} {self.unit}"

    @property
    def finished(self) -> bool:
        """Whether all results asked for are there."""
        return disk.is_file(self.path / SUMS)

    def begin(self, *, overwrite: bool) -> bool:
        """Read an existing folder or create a new one; returns whether the work is new."""
        self._refuse_foreign()
        new = not disk.is_file(self.path / self.record)
        if not new:
            try:
                self._load()
                new = overwrite and self.finished
            except ValueError:
                if not overwrite:
                    raise
                new = True
            if new:
                self.clear()
        self._sweep()
        if new:
            self.notes, self.recorded = (), self.origin
            self._read_done()  # none
            self._describe()
        return new

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Write all results, the files about the whole work, and the digests of all files last; see `put_file`."""
        self.write_pending()
        for name, data in files.items():
            self.put_file(name, data)
        self.put_file(SUMS, disk.sums_text(self._digests()))

    def put_file(self, name: str, data: bytes) -> None:
        """Put a file in its place; ValueError if it cannot be written, and the results so far stay."""
        with self.unwritten(name):
            disk.put_file(self.path / name, data)

    @contextlib.contextmanager
    def unwritten(self, what: str) -> Iterator[None]:
        """Report an error of the disk in the block as a ValueError."""
        try:
            yield
        except OSError as error:
            mend = f"{disk.mend(error)} and " if disk.mend(error) else ""
            raise Refusal(
                f"{what} cannot be written to {self.path}: {error.strerror}; {self.progress} are done and kept, {mend}"
                "run the same command again"
            ) from None

    def clear(self) -> None:
        """Remove earlier work: the results in one step, then the list of digests, and the record of the origin last.

        A ValueError names a file that somebody added or changed; nothing is removed then.
        """
        _refuse_changed(self.path, self._file_digests().keys() - {self.record})
        for name in (self._results, SUMS, *reversed(self._files)):
            disk.remove(self.path / name)
        disk.sync(self.path)

    def _load(self) -> None:
        """Read the results; ValueError if the folder holds other work, or is damaged, and nothing is changed then."""
        self.recorded = type(self.origin).read(self.path / self.record)
        goes_further = self._refuse_another()
        self._read_done()
        whole = self._is_whole() and not goes_further
        self._compare_arithmetic(whole=whole)
        if not whole:
            # something was taken away, or the work goes further: what rests on it is made again
            disk.remove(self.path / SUMS)
            self.recorded = self.origin if goes_further else self.recorded
            self._describe()

    def _refuse_another(self) -> bool:
        """Refuse another version or configuration; returns whether a key differs that may."""
        earlier, now = self.recorded, self.origin
        if earlier.version != now.version:
            raise Refusal(
                f"{self.path} was begun by glucoloop {earlier.version}, and this is {now.version}; "
                f"go on with {earlier.version}, or choose another folder with --out"
            )
        differing = list(differences(earlier.config, now.config))
        for name, old, new in differing:
            if name not in self.work.may_change:
                raise Refusal(
                    f"{self.path} holds another {self.work.what}: {name} is {old} there and {new} here; choose "
                    "another folder with --out, or add --overwrite to replace it"
                )
        return bool(differing)

    def _compare_arithmetic(self, *, whole: bool) -> None:
        """Refuse results of another arithmetic; those of whole work are noted."""
        if (result := arithmetic.difference(self.recorded.arithmetic, self.origin.arithmetic)) is None:
            return
        name, old, new = result
        other = f"{self.path} was computed with {name} {old}, and here it is {new}"
        if not whole:
            raise Refusal(
                f"{other}, which does not give the same bits; go on as before, choose another folder with --out, or "
                "add --overwrite to begin again"
            )
        self.notes = (f"{other}.", *self.notes)

    def _is_whole(self) -> bool:
        """Whether there are all files of the list of digests, and no result is missing.

        A ValueError names a file that differs from the list, or is missing in it.
        """
        if not disk.is_file(self.path / SUMS):
            return False
        sums, digests = disk.read_sums(self.path), self._digests()
        for name, digest in digests.items():
            if sums.get(name) != digest:
                fault = f"{self.path / name} was changed since glucoloop wrote it"
                if name not in sums:
                    fault = f"{self.path / SUMS} does not list {name} as it is"
                raise Refusal(f"{fault}; move it away and run the same command again")
        needed = self.wanted if self.in_parts else 1  # a search may end before all of its rows
        return sums.keys() == digests.keys() >= {*self._files[:2]} and self.done >= needed

    def _describe(self) -> None:
        """Write the origin and the configuration, as far as they are not there."""
        work = self.work
        configuration = toml_text(work.keys, f"{work.command} --config {work.configuration}", work.explicit)
        for name, text in zip(self._files, (self.recorded.text(), configuration), strict=False):
            if not (disk.is_file(self.path / name) and disk.read_bytes(self.path / name) == text.encode()):
                disk.put_file(self.path / name, text.encode())
        if self.in_parts and not disk.is_folder(self.path / self._results):
            (self.path / self._results).mkdir()

    def _digests(self) -> dict[str, str]:
        return {**self._file_digests(), **self._part_digests()}

    def _file_digests(self) -> dict[str, str]:
        digests = {name: disk.digest(self.path / name) for name in self._files}
        return {name: digest for name, digest in digests.items() if digest}

    def _refuse_foreign(self) -> None:
        for name in _names_of_ours(self.path, self.work.what, self.record, {*self._files, self._results}):
            (disk.is_file if name in (*self._files, SUMS) else disk.is_folder)(self.path / name)

    def _sweep(self) -> None:
        """Remove unfinished files that a dead process left."""
        for folder in (self.path.resolve(), *([self.path / self._results] if self.in_parts else [])):
            for name in filter(disk.is_part, disk.names(folder)):
                disk.remove(folder / name)


F = TypeVar("F", bound=ResumableFolder)


@contextlib.contextmanager
def opened(folder: F, *, overwrite: bool) -> Iterator[F]:
    """Open a folder, new or begun, for writing.

    To overwrite is to begin again, unless the folder holds the same work unfinished: then it is resumed. A new folder
    is removed if the block fails before there are results.

    A ValueError tells that the place is taken by something else, by other work or by another run, that the results in
    it are damaged, or that the folder cannot be written to.
    """
    path = folder.path
    with contextlib.ExitStack() as stack:
        with _place_refused(path):
            stack.enter_context(disk.made_folders(path))
            stack.enter_context(disk.locked(path / LOCK, path))
            new = folder.begin(overwrite=overwrite)
        try:
            yield folder
        except BaseException:
            with contextlib.suppress(ValueError):  # the error of the block matters more
                folder.write_pending()
            if new and not folder.done:
                with contextlib.suppress(OSError, ValueError):
                    folder.clear()
            raise
        folder.write_pending()


def refuse_unusable(path: Path, what: str, record: str, names: Collection[str], *, overwrite: bool) -> None:
    """Refuse at once a place that `opened` would refuse for any work of a command, and leave it as it is.

    `record` is the first file that the work of the command writes, and `names` are those of all the others.
    """
    with _place_refused(path), disk.made_folders(path, kept=False), disk.locked(path / LOCK, path):
        there = _names_of_ours(path, what, record, names)
        if overwrite:
            _refuse_changed(path, {name for name in there if disk.kind(path / name) == "a file"} - {record, SUMS})


def _refuse_changed(path: Path, names: Collection[str]) -> None:
    """Refuse to replace files that are not as the list of digests has them; one that it lacks was not finished."""
    sums = disk.read_sums(path)
    for name in sorted(sums.keys() & names):
        if sums[name] != disk.digest(path / name):
            raise Refusal(
                f"{path} holds {name}, which was changed since glucoloop wrote it, so it is not replaced; "
                "move that away, or choose another folder with --out"
            )


def _names_of_ours(path: Path, what: str, record: str, names: Collection[str]) -> list[str]:
    """Names in a folder, all of which are of such work; Refusal for another one, or where the record is missing."""
    known = {record, *names, SUMS, LOCK}
    holds = [name for name in disk.names(path.resolve()) if not disk.is_part(name, *known) and name != LOCK]
    foreign = [name for name in holds if name not in known]
    other = "choose another folder with --out"
    if foreign:
        raise Refusal(f"{path} holds {foreign[0]}, which is no part of a {what}; {other}")
    if holds and record not in holds:
        raise Refusal(f"{path} is not empty and holds no {what}; {other}")
    return holds


@contextlib.contextmanager
def _place_refused(path: Path) -> Iterator[None]:
    """Report in a sentence that an output folder cannot be made, or not be written to."""
    try:
        yield
    except (FileExistsError, NotADirectoryError):
        raise Refusal(f"{path} is not a folder and cannot be one; choose another place with --out") from None
    except OSError as error:
        again = f"{disk.mend(error)} and run the same command again, or " if disk.mend(error) else ""
        raise Refusal(
            f"the output folder {path} cannot be written: {error.strerror}; {again}choose another with --out"
        ) from None
