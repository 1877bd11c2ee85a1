"""Reading of files: which reader takes each, whose the rows are, and the record of each person."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import polars as pl

from glucoloop.component.setting import choices_text
from glucoloop.records.answers import Answers
from glucoloop.records.any_table import AnyTable, proposed_columns
from glucoloop.records.devices import program_of
from glucoloop.records.extract import Account, Extract
from glucoloop.records.file_text import FileText, content_of, read_bytes, text_of
from glucoloop.records.nightscout_profile import zones_of
from glucoloop.records.reader import READERS, ReaderComponent
from glucoloop.records.record import IN_MEMORY, DeviceRecord, FileRefusal, is_parquet_record, record_from_parquet
from glucoloop.records.tidy import record_of, settled
from glucoloop.records.user_files import ZIP, UserFile, files_of, is_workbook
from glucoloop.refusal import Refusal
from glucoloop.schema.tables import PARQUET
from glucoloop.text import how_many, printable

_UNKNOWN: Final = "no reader knows it"


@dataclass(frozen=True)
class _Recognised:
    """A file with the reader that takes it."""

    path: Path
    content: FileText
    reader: ReaderComponent


def read_files(sources: Sequence[Path | pl.DataFrame], reader: str | None, answers: Answers) -> dict[str, DeviceRecord]:
    """Record of each person by name, an empty one for files of one person; FileRefusal if there is none."""
    only = sources[0] if len(sources) == 1 and isinstance(sources[0], Path) else None
    if only is not None and only.is_dir():
        people = _people_of(only)
        if len(people) > 1:
            each = {_name_of([path.name for path in own]): read_files(own, reader, answers) for own in people}
            return _by_name(each)
    chosen = None if reader is None else READERS.choose(reader)
    files: list[UserFile] = []
    for source in sources:
        if isinstance(source, pl.DataFrame):
            files.append(UserFile(IN_MEMORY, text_of(source).encode()))
            continue
        with _refusing(source):
            files += files_of(source)
    people_in_zip = _people_in_zip(only, files) if only is not None and only.is_file() else {}
    if people_in_zip:
        each = {name: _read(own, chosen, answers) for name, own in people_in_zip.items()}
        return _by_name(each)
    return _read(files, chosen, answers)


def _by_name(each: Mapping[str, Mapping[str, DeviceRecord]]) -> dict[str, DeviceRecord]:
    """Records by the name of a folder or file and that of the person in it."""
    return {f"{name} {who}".strip(): record for name, of_one in each.items() for who, record in of_one.items()}


def _read(files: Sequence[UserFile], chosen: ReaderComponent | None, answers: Answers) -> dict[str, DeviceRecord]:
    """Record of each person of files that belong together."""
    record = next((file for file in files if file.data.startswith(PARQUET)), None)
    if record is not None:
        with _refusing(record.path):
            if len(files) > 1:
                raise Refusal("it is a record that was read before; read it alone, or the first files together")
            return {"": record_from_parquet(record.data)}
    recognised, answers, notes = _recognised(files, chosen, answers)
    extracts: list[Extract] = []
    for file in recognised:
        with _refusing(file.path):
            extract = file.reader.rows(file.content, answers)
            extracts.append(replace(extract, notes=(*file.content.notes, *extract.notes)))
    _refuse_names_in_no_file(recognised, extracts, answers)
    zones = [*zones_of(answers.basal_profiles), *(zone for extract in extracts for zone in extract.zones)]
    return {
        name: _record(name, [file.path for file in recognised], extracts, zones, answers, notes)
        for name in _names_of_people(recognised, extracts)
    }


def _recognised(
    files: Sequence[UserFile], chosen: ReaderComponent | None, answers: Answers
) -> tuple[list[_Recognised], Answers, list[str]]:
    """Files with rows of their own, what the others tell about them, and notes on files of a folder that none takes."""
    result: list[_Recognised] = []
    unread: list[FileRefusal] = []
    for file in files:
        try:
            with _refusing(file.path):
                content = content_of(file.data)
                own = chosen or reader_of(content, answers)
                if file.of_many and own.name == "table" and answers.columns and not _may_be_table(content, answers):
                    names = ", ".join(answers.columns.values())
                    raise Refusal(
                        f"no line of its beginning has all of the columns {names}; give the names as they stand in the "
                        "file"
                    )
                with_profiles = own.with_profiles(content, answers)
        except FileRefusal as error:
            if not file.of_many:
                raise
            unread.append(error)
            continue
        if with_profiles is None:
            result.append(_Recognised(file.path, content, own))
        elif len(files) == 1:
            with _refusing(file.path):
                raise Refusal(
                    "it has no readings, meals or insulin, only what helps to read other files; give those too"
                )
        else:
            answers = with_profiles
    if not result:
        if unread:
            raise unread[0]
        with _refusing(files[0].path):
            raise Refusal("none of the files has readings, meals or insulin; give those too")
    notes = []
    if unread:
        count = how_many(len(unread), "file or table", "files or tables")
        notes = [f"{count} of the folder, ZIP or workbook that no reader knows: not read."]
    return result, answers, notes


def _may_be_table(content: FileText, answers: Answers) -> bool:
    """Whether a file has some of the columns that are named, or the names of a record."""
    return AnyTable().has_columns(content, answers.columns) or AnyTable().recognised(content)


def _refuse_names_in_no_file(files: Sequence[_Recognised], extracts: Sequence[Extract], answers: Answers) -> None:
    """Refuse a column that is named and stands in none of several files."""
    if len(files) < 2 or not answers.columns:
        return
    missing = set.intersection(*(set(extract.missing) for extract in extracts))
    if missing:
        raise FileRefusal(
            [file.path for file in files],
            Refusal(f"none of them has the column {min(missing)!r}; give the names as they stand in the files"),
        )


def _names_of_people(files: Sequence[_Recognised], extracts: Sequence[Extract]) -> list[str]:
    """Names of the people of all files; one empty name for files of one person."""
    each = [extract.frame["person"].drop_nulls().unique(maintain_order=True).to_list() for extract in extracts]
    names = list(dict.fromkeys(name for own in each for name in own))
    if len(names) > 1:
        for file, own in zip(files, each, strict=True):
            if not own:
                with _refusing(file.path):
                    raise Refusal(
                        f"it does not say whose its rows are, and the other files are of {len(names)} people",
                        "name its column of people with person_column (--person-column)",
                        "give files of one person alone",
                    )
        return names
    return [""]


def _record(
    name: str,
    paths: Sequence[Path],
    extracts: Sequence[Extract],
    zones: Sequence[str],
    answers: Answers,
    notes: Sequence[str],
) -> DeviceRecord:
    """Record of one person."""
    account, frames = Account(notes=list(notes)), list[pl.DataFrame]()
    for number, (path, extract) in enumerate(zip(paths, extracts, strict=True), 1):
        before = len(account.notes)
        own = extract.frame.filter(pl.col("person") == name) if name else extract.frame
        with _refusing(path):
            frames.append(settled(extract, own, answers, account))
            nobody = int(extract.frame["person"].is_null().sum()) if name else 0
            if nobody:
                account.notes.append(f"{how_many(nobody, 'row')} of the file name nobody and are in no record.")
        if len(extracts) > 1:
            account.notes[before:] = [f"File {number}: {note}" for note in account.notes[before:]]
    try:
        return record_of(frames, zones, answers, account)
    except Refusal as error:
        whose = Refusal(f"person {printable(name)!r}: {error.problem}", *error.remedies) if name else error
        raise FileRefusal(list(dict.fromkeys(paths)), whose) from None


def _people_of(folder: Path) -> list[tuple[Path, ...]]:
    """Files or folder of each person of a folder, as a report has them; the folder where its files are of one."""
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    files = [path for path in inside if path.is_file() and _is_known(path)]
    folders = [path for path in inside if path.is_dir()]
    if not folders:
        people = files_of_people(files)
        return people if len(people) > 1 else [(folder,)]
    if files and not any(_has_readings(file.data) for path in folders for file in files_of(path)):
        return [(folder,)]  # as of an export that has its insulin in a folder of its own
    return [(path,) for path in sorted([*files, *folders])]


def _people_in_zip(archive: Path, files: Sequence[UserFile]) -> dict[str, list[UserFile]]:
    """Files of each person of a ZIP, by the rules that hold for a folder; nothing where they are of one person."""
    places = [file.path.relative_to(archive).parts for file in files]
    while places and len({place[:1] for place in places}) == 1 and all(len(place) > 1 for place in places):
        places = [place[1:] for place in places]
    groups: dict[str, list[UserFile]] = {}
    for place, file in zip(places, files, strict=True):
        if place and (len(place) > 1 or _is_known_text(file.data)):
            groups.setdefault(place[0], []).append(file)
    folders = {place[0] for place in places if len(place) > 1}
    loose = [name for name in groups if name not in folders]
    if len(groups) < 2:
        return {}
    if not folders:
        every = [(name, file) for name, own in groups.items() for file in own]
        people = [[every[place] for place in own] for own in _people([(name, file.data) for name, file in every])]
        return (
            {_name_of([name for name, _ in own]): [file for _, file in own] for own in people}
            if len(people) > 1
            else {}
        )
    if loose and not any(_has_readings(file.data) for name in folders for file in groups[name]):
        return {}
    return groups


def _has_readings(data: bytes) -> bool:
    """Whether a file tells glucose of a sensor, as far as it can be read without answers."""
    try:
        content = content_of(data)
        return bool(reader_of(content, Answers()).rows(content, Answers()).frame["glucose"].is_not_null().any())
    except Refusal:
        return False


def _is_known(path: Path) -> bool:
    """Whether a file is one with records, by its form; one that cannot be read is, and is refused later."""
    try:
        data = read_bytes(path)
        if (data.startswith(ZIP) and not is_workbook(data)) or is_parquet_record(data):
            return True
        return any(_is_known_text(file.data) for file in files_of(path))
    except Refusal:
        return True


def _is_known_text(data: bytes) -> bool:
    """Whether a reader takes a text, or it is none."""
    try:
        reader_of(content_of(data), Answers())
    except Refusal as error:
        return not error.problem.startswith(_UNKNOWN)
    return True


def files_of_people(paths: Sequence[Path]) -> list[tuple[Path, ...]]:
    """Files of each person: all of one, each of its own person, or those with the same number in their names.

    Refusal where several have readings and others none, since nothing says which belong together.
    """
    try:
        texts = [(path.name, read_bytes(path)) for path in paths]
    except Refusal:
        return [(path,) for path in paths]
    return [tuple(paths[place] for place in own) for own in _people(texts)]


def _people(files: Sequence[tuple[str, bytes]]) -> list[list[int]]:
    """Places of the files of each person, of files by name; files of one are parts of what a program exports."""
    apart = [[place] for place in range(len(files))]
    parts: list[bool] = []
    exports = True
    for _, data in files:
        try:
            content = content_of(data)
            reader = reader_of(content, Answers())
            if not reader.in_parts:
                return apart
            exports = exports and reader.in_exports
            alone = reader.with_profiles(content, Answers()) is None
            parts.append(alone and bool(reader.rows(content, Answers()).frame["glucose"].is_not_null().any()))
        except Refusal:
            return apart
    if not exports and (all(parts) or len(parts) < 2):
        return apart
    if exports or sum(parts) < 2:
        return [list(range(len(files)))]
    numbers = [_number_in(name) for name, _ in files]
    people = [[place for place, other in enumerate(numbers) if other == number] for number in dict.fromkeys(numbers)]
    if None not in numbers and all(sum(parts[place] for place in own) == 1 for own in people):
        return people
    raise Refusal(
        f"{sum(parts)} of the files have readings and {len(parts) - sum(parts)} have none, and nothing says whose "
        "these are; put the files of each person into a folder of their own, and give the folder with these folders"
    )


def _number_in(name: str) -> str | None:
    """Last number in the name of a file, which may be that of a person; None if there is none."""
    numbers = re.findall(r"\d+", name.rpartition(".")[0] or name)
    return numbers[-1] if numbers else None


def _name_of(names: Sequence[str]) -> str:
    """Name of a person by the names of the files: that of the only one, or the number that all have."""
    return names[0] if len(set(names)) == 1 else _number_in(names[0]) or names[0]


@contextlib.contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Say of a refusal which file it is about."""
    try:
        yield
    except FileRefusal:
        raise
    except Refusal as error:
        raise FileRefusal([path], error) from None


def reader_that_knows(path: Path) -> str | None:
    """Name of the reader that takes a file of a device, an app or a simulator; None if there is not one."""
    try:
        return reader_of(content_of(read_bytes(path)), Answers()).name
    except Refusal:
        return None


def reader_of(content: FileText, answers: Answers) -> ReaderComponent:
    """Reader that takes a file; Refusal if there is none, or more than one."""
    if answers.columns and AnyTable().has_columns(content, answers.columns):
        return READERS.choose("table")
    readers = [READERS.choose(name) for name in READERS.names()]
    result = [reader for reader in readers if reader.recognised(content)]
    if len(result) == 1:
        return result[0]
    if answers.columns:
        return READERS.choose("table")
    if result:
        names = [reader.name for reader in result]
        raise Refusal(f"it could be read by {' and by '.join(names)}", f"say which with reader={names[0]} (--reader)")
    begins = content.text.lstrip()[:1]
    if begins in ("[", "{") and content.json is None and content.items is None:
        raise Refusal("it begins like JSON, and breaks off or is damaged; give the whole file as it was exported")
    program = program_of("\n".join(content.head))
    form = f"; it names {program}, and has a form or a language that is not known here" if program else ""
    columns = proposed_columns(content)
    if columns:
        raise Refusal(
            f"{_UNKNOWN}: {_seen(content)}{form}",
            f"name its columns, perhaps as columns='{columns}' (--columns), and check the units",
        )
    raise Refusal(
        f"{_UNKNOWN}: {_seen(content)}{form}. The readers are {choices_text(READERS.names())}",
        "for any other table name its columns, as columns='time=Zeit,glucose_mg_dl=BZ' (--columns)",
    )


def _seen(content: FileText) -> str:
    """Words on what a file holds, without anything from its cells."""
    text = content.text.lstrip()
    if text[:1] in ("[", "{"):
        value = content.json if content.json is not None else content.items
        return f"it is JSON, {'one object' if isinstance(value, dict) else f'a list of {len(value or [])}'}"
    if text.startswith("<"):
        return "it is XML or HTML"
    lines = content.text.count("\n") + 1
    names = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
    delimiter, most = max(((sign, content.head[0].count(sign)) for sign in names), key=lambda pair: pair[1])
    return (
        f"it is text of {lines} lines, the first of {most + 1} fields by {names[delimiter]}"
        if most
        else (f"it is text of {lines} lines without commas, semicolons or tabs in the first")
    )
