"""Commands of declared studies: request, progress, folder, resumption, output and exit code, made once for all."""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import (
    CASE,
    MMOL,
    OUTPUT,
    SITUATION,
    Given,
    Option,
    among,
    names,
    options_of,
    reworded,
    with_options,
    without,
)
from glucoloop.cli.progress import counted
from glucoloop.cli.request import Output, split_off_output
from glucoloop.cli.screen import note, stage, stages
from glucoloop.cli.study import carried_out, needed_folder, paths_of, read_request, tell_results
from glucoloop.cli.trial import compute, computing
from glucoloop.cli.trial_options import CASES, DASK, TRIAL, WORKERS, usual_texts
from glucoloop.config.key import declared
from glucoloop.printable import how_many
from glucoloop.studies.study import (
    Module,
    PlainModule,
    PlainStudy,
    SearchModule,
    SearchStudy,
    Study,
    TrialModule,
    TrialStudy,
)

if TYPE_CHECKING:
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.resumable import Work
    from glucoloop.storage.rows import RowsFolder
    from glucoloop.storage.trials.folder import TrialFolder

_SHARED: Final = {"trial": TRIAL, "run": (*SITUATION, *CASE, *OUTPUT), "nothing": OUTPUT}
_OUTPUT: Final = tuple(option.key for option in OUTPUT)


def command_of(study: Study) -> Callable[..., None]:
    """The command of a study, for Typer."""
    return with_options(study_options(study))(lambda given: _run(study, given))


def study_options(study: Study) -> tuple[Option, ...]:
    """Options of a study: its own settings and the shared keys, in its words."""
    own = tuple(option for record in study.settings for option in options_of(record))
    shared = without(_SHARED[study.shared], *study.refused, *(option.key for option in own), DASK.key, MMOL.key)
    if study.taken is not None:
        shared = among(shared, (*study.taken, *_OUTPUT))
    if not isinstance(study, TrialStudy):
        shared = without(shared, WORKERS.key)
    if isinstance(study, PlainStudy):
        shared = (*without(shared, *_OUTPUT), *(OUTPUT if study.keeps_files else among(OUTPUT, ("json",))))
        kept = {}
    else:
        kept = {
            "out": f"Folder of {study.what}; an unfinished one is resumed.",
            "overwrite": "Begin again in the folder.",
        }
    words = {**study.words, "help": {**kept, **study.words.get("help", {})}}
    shared = tuple(reworded(shared, default=usual_texts(study.usual)))
    own_last = study.shared == "trial" and not isinstance(study, SearchStudy)
    return tuple(reworded((*shared, *own) if own_last else (*own, *shared), **words))


def _run(study: Study, given: Given) -> None:
    """Check the request, carry it out or go on with it, and print the results."""
    keys, output, file = split_off_output({key: value for key, value in given.items() if value not in ((), [])})
    if isinstance(study, TrialStudy):
        _run_trial(study, keys, output, file)
    elif isinstance(study, SearchStudy):
        _run_search(study, keys, output, file)
    elif isinstance(study, PlainStudy):
        _run_plain(study, keys, output, file)
    else:
        raise TypeError(f"{type(study).__name__} is no kind of study")


def asked_of(study: Study, keys: Given, of_file: Given) -> tuple[Any, Any]:
    """The module of a study, and the request from the keys of the command line and those of a file."""
    from glucoloop.config.cases import take_cases
    from glucoloop.config.run import overlay
    from glucoloop.config.trial import overlay_trial

    module: Any = importlib.import_module(study.module)
    options = study_options(study)
    has_cases = any(option.key == CASES.key for option in options)
    cases = take_cases(keys, of_file) if has_cases else ()
    called = names(options, keys)
    if study.shared == "nothing":
        merged = {**of_file, **keys}
    else:
        merged = (overlay_trial if has_cases else overlay)(of_file, keys, called)
    return module, module.read(merged, cases, called)


def _used(read: tuple[Any, Any]) -> Mapping[str, Any]:
    used: dict[str, Any] = read[1].keys()
    return used


def _work(study: Study, what: str, asked: Any, may_change: Mapping[str, Any]) -> Work:
    from glucoloop.storage.resumable import Work

    return Work(
        command=study.name,
        what=what,
        keys=asked.keys(),
        given=asked.given,
        final=(*study.files, study.summary),
        summary=study.summary,
        may_change=frozenset(may_change),
    )


def _run_trial(study: TrialStudy, keys: Given, output: Output, file: Path | None) -> None:
    where, out = computing(keys), needed_folder(output, study.what, study.name)
    module: TrialModule
    module, asked = read_request(keys, file, functools.partial(asked_of, study), _used)
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.trials.folder import trial_folder

    work, trial = _work(study, "trial", asked, {}), asked.trial
    note(module.notes(asked))

    def finish(folder: TrialFolder) -> Findings:
        if folder.finished:
            return Findings.read(folder.path / study.summary)
        compute(folder, where)
        with stage("Summing up"):
            found = module.found(asked, folder)
        with stage("Drawing"):
            folder.finish({**found.files(study.summary), **module.drawn(asked, found)})
        return found

    found = carried_out(trial_folder(out, trial, overwrite=output.overwrite, work=work), finish)
    files = paths_of(work, out)
    written = f"Wrote {', '.join(files)} and {how_many(trial.shards, 'shard')} to {out}."
    _tell(module, asked, found, output, files, written=written)


def _run_search(study: SearchStudy, keys: Given, output: Output, file: Path | None) -> None:
    out = needed_folder(output, study.what, study.name) if study.needs_folder else output.place
    module: SearchModule
    module, asked = read_request(keys, file, functools.partial(asked_of, study), _used)
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.rows import rows_folder

    note(module.notes(asked))
    kept = module.rows(asked)

    def finish(folder: RowsFolder[Any] | None) -> Findings:
        if folder is not None and folder.finished:
            return Findings.read(folder.path / study.summary)
        with stage("Preparing"):
            search = module.search(asked)
        rows = [] if folder is None else folder.rows
        with counted(kept.wanted, len(rows), kept.what) as more:
            for row in search.missing(rows[:]):
                rows.append(row) if folder is None else folder.add(row)
                more(1)
        with stage("Summing up"):
            found = search.found(rows)
        if folder is not None:
            with stage("Drawing"):
                folder.finish({**found.files(study.summary), **module.drawn(asked, found)})
        return found

    if out is None:
        _tell(module, asked, finish(None), output, {})
        return
    work = _work(study, "search", asked, {} if study.extent is None else declared(study.extent))
    found = carried_out(rows_folder(out, work, kept, overwrite=output.overwrite), finish)
    _tell(module, asked, found, output, paths_of(work, out, kept.file))


def _run_plain(study: PlainStudy, keys: Given, output: Output, file: Path | None) -> None:
    files: dict[str, str] = {}
    with output.folder() if study.keeps_files else contextlib.nullcontext() as folder:
        module: PlainModule
        module, asked = read_request(keys, file, functools.partial(asked_of, study), _used)
        note(module.notes(asked))
        with _progress(study, module, asked) as progress:
            found = module.found(asked, progress)
        if folder is not None:
            from glucoloop.config.toml import toml_text

            configuration = f"{study.name}.toml"
            text = toml_text(asked.keys(), f"{study.name} --config {configuration}", asked.given)
            with stage("Drawing"):
                made = {configuration: text.encode(), **found.files(study.summary), **module.drawn(asked, found)}
            for name, data in made.items():
                folder.write(name, data)
            files = folder.paths()
    _tell(module, asked, found, output, files, written=None if study.keeps_files else "")
    if found.plain.get("interrupted"):
        amount, unit = module.amount(asked), study.unit
        interrupted(
            f"interrupted; of {amount} {unit} {found.plain[unit]} were checked to the end; their results follow"
        )
    if not found.plain.get("holds", True):
        sys.exit(1)


@contextlib.contextmanager
def _progress(study: PlainStudy, module: PlainModule, asked: Any) -> Iterator[Callable[[Any], None]]:
    """Progress of a study that is carried out in one go, in units or in words."""
    shown: Any = counted(module.amount(asked), 0, study.unit) if study.unit else stages("Preparing")
    with shown as progress:
        yield progress


def _tell(
    module: Module, asked: Any, found: Findings, output: Output, files: Mapping[str, str], *, written: str | None = None
) -> None:
    """Print what was found: as JSON, or as tables and sentences, and the place of the files."""
    notes = tuple(found.plain.get("notes", ()))
    tables = () if output.json else module.tables(asked, found)
    lines = () if output.json else (*module.sentences(asked, found), *notes)
    tell_results(output, found.plain, files, tables, lines, notes=notes, written=written)
