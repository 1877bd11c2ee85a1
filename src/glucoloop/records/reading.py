"""Reading of files: which reader takes each, and the record of what they found."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import polars as pl

from glucoloop.component.setting import choices_text
from glucoloop.records.answers import Answers
from glucoloop.records.file_text import FileText, content_of, read_bytes
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.readers import READERS
from glucoloop.records.record import PARQUET, DeviceRecord, FileRefusal, record_from_parquet
from glucoloop.records.tidy import Account, record_of, settled
from glucoloop.refusal import Refusal


def read_files(paths: Sequence[Path], reader: str | None, answers: Answers) -> DeviceRecord:
    """Record of a person from all files; FileRefusal where there is none."""
    chosen = None if reader is None else READERS.choose(reader)
    account, frames = Account(), list[pl.DataFrame]()
    result: list[tuple[int, Path, FileText, ReaderComponent]] = []
    for number, path in enumerate(paths, 1):
        with _refusing(path):
            data = read_bytes(path)
            if data.startswith(PARQUET):
                if len(paths) > 1:
                    raise Refusal("it is a record that was read before; read it alone, or the first files together")
                return record_from_parquet(data)
            content = content_of(data)
            own = chosen or _reader_of(content, answers)
            with_profiles = own.with_profiles(content, answers)
            if with_profiles is None:
                result.append((number, path, content, own))
            elif len(paths) == 1:
                raise Refusal(
                    "it has no readings, meals or insulin, only what helps to read other files; give those too"
                )
            else:
                answers = with_profiles
    for number, path, content, own in result:
        before = len(account.notes)
        with _refusing(path):
            account.notes += content.notes
            frames.append(settled(own.rows(content, answers), answers, account))
        if len(paths) > 1:
            account.notes[before:] = [f"File {number}: {note}" for note in account.notes[before:]]
    try:
        return record_of(frames, account)
    except Refusal as error:
        raise FileRefusal(paths, error) from None


@contextlib.contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Say of a refusal which file it is about."""
    try:
        yield
    except Refusal as error:
        raise FileRefusal([path], error) from None


def reader_that_knows(path: Path) -> str | None:
    """Name of the reader that takes a file of a device, an app or a simulator; None if there is not one."""
    try:
        return _reader_of(content_of(read_bytes(path)), Answers()).name
    except Refusal:
        return None


def _reader_of(content: FileText, answers: Answers) -> ReaderComponent:
    """Reader that takes a file; Refusal if there is none, or more than one."""
    if answers.columns:
        return READERS.choose("table")
    readers = [READERS.choose(name) for name in READERS.names()]
    result = [reader for reader in readers if reader.recognised(content)]
    if len(result) == 1:
        return result[0]
    if result:
        names = [reader.name for reader in result]
        raise Refusal(f"it could be read by {' and by '.join(names)}", f"say which with reader={names[0]} (--reader)")
    raise Refusal(
        f"no reader knows it: {_seen(content)}. The readers are {choices_text(READERS.names())}",
        "for any other table name its columns, as columns='time=Zeit,glucose_mg_dl=BZ' (--columns)",
    )


def _seen(content: FileText) -> str:
    """Words on what a file holds, without anything from its cells."""
    text = content.text.lstrip()
    if text[:1] in ("[", "{"):
        value = content.json
        if value is None:
            return "it begins like JSON and is no whole JSON"
        return f"it is JSON, {'one object' if isinstance(value, dict) else f'a list of {len(value)}'}"
    if text.startswith("<"):
        return "it is XML or HTML"
    lines = content.text.count("\n") + 1
    delimiter, most = max(((sign, content.head[0].count(sign)) for sign in (",", ";", "\t")), key=lambda pair: pair[1])
    names = {",": "commas", ";": "semicolons", "\t": "tabs"}
    return (
        f"it is text of {lines} lines, the first of {most + 1} fields by {names[delimiter]}"
        if most
        else (f"it is text of {lines} lines without commas, semicolons or tabs in the first")
    )
