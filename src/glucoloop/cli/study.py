"""Steps that the commands of studies share: read the request, work in a folder that resumes, print the results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import Given, Option, names
from glucoloop.cli.request import Output, file_keys, keys_used, read_again, with_lists
from glucoloop.cli.screen import note, show, stage
from glucoloop.cli.telling import print_json, where_written
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.storage.resumable import ResumableFolder, Work

T = TypeVar("T")
F = TypeVar("F", bound="ResumableFolder")


def read_request(
    keys: Given,
    file: Path | None,
    read: Callable[[Given, Given], T],
    used: Callable[[Any], Mapping[str, Any]] = keys_used,
) -> T:
    """Read a request from the keys of the command line and those of a file, once the simulator is imported.

    `used` as for `request.read_again`.
    """
    texts = with_lists(keys), file_keys(file)
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled

        asked: T = read_again(read, used, *texts)
    keep_compiled()
    return asked


def read_with_cases(keys: Given, of_file: Given, options: Sequence[Option], read: Callable[..., T]) -> T:
    """Read a trial with further keys: `read` takes keys, cases, and the users' names of the keys for messages."""
    from glucoloop.config.cases import take_cases
    from glucoloop.config.trial import overlay_trial

    cases = take_cases(keys, of_file)
    called = names(options, keys)
    return read(overlay_trial(of_file, keys, called), cases, called)


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
            elif folder.anything_done:
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
