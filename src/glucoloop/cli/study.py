"""Steps that the commands of studies share: work in a folder that resumes, print the results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.printing import print_json, where_written
from glucoloop.cli.request import Output
from glucoloop.cli.screen import note, show
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.storage.resumable import ResumableFolder, Work

T = TypeVar("T")
F = TypeVar("F", bound="ResumableFolder")


def needed_folder(output: Output, what: str, example: str) -> Path:
    """The output folder of a study that is always kept in one."""
    if output.out is None:
        raise Refusal(f"--out is missing; {what} is kept in a folder, name one like --out {example}")
    return output.out


def carried_out(opened: AbstractContextManager[F], finish: Callable[[F], T]) -> T:
    """Complete the work of a folder; after Ctrl-C, print how much is kept."""
    folder: F | None = None
    try:
        with opened as folder:
            note(folder.notes)
            if folder.finished:
                note([f"{folder.path} was finished before; nothing is computed again."])
            elif folder.done:
                note([f"{folder.progress} of {folder.path} are there already; going on."])
            return finish(folder)
    except KeyboardInterrupt:
        if folder is None:
            raise
        interrupted(f"interrupted; {folder.progress} are kept, the same command goes on")


def paths_of(work: Work, out: Path, *further: str) -> dict[str, str]:
    """Path of each file of finished work by name; `further` are those that grew with it."""
    return {name: str(out / name) for name in (*work.final, *further, work.configuration)}


def tell_results(
    output: Output,
    report: Mapping[str, Any],
    files: Mapping[str, str],
    tables: Iterable[object],
    lines: Iterable[str],
    *,
    notes: tuple[str, ...] = (),
    written: str | None = None,
) -> None:
    """Print a report as JSON, with notes on standard error; or tables, sentences, and where the files are."""
    if output.json:
        print_json(report, files, notes)
        return
    for table in tables:
        show(table)
    for line in lines:
        print(line)
    place = where_written(output.out, files) if written is None else written
    if place:
        print(place)
