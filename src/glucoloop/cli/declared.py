"""Commands of declared studies: request, progress, folder, resumption, output and exit code, made once for all."""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from glucoloop.cli.command import Command
from glucoloop.cli.computing import Computing, compute, computing
from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.option import (
    DASK,
    JSON,
    MMOL,
    OUTPUT,
    SHORT,
    WORKERS,
    CommandOption,
    Given,
    options_of,
    reworded,
    without,
)
from glucoloop.cli.progress import counted
from glucoloop.cli.request import Output, Request, completed, request_of
from glucoloop.cli.screen import note, stage, stages
from glucoloop.cli.study import carried_out, needed_folder, paths_of, tell_results
from glucoloop.printable import how_many
from glucoloop.situations.request import asked_for, read_root
from glucoloop.studies.study import PlainStudy, SearchStudy, Study, TrialStudy

if TYPE_CHECKING:
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.resumable import Work
    from glucoloop.storage.rows import RowsFolder
    from glucoloop.storage.trials.folder import TrialFolder


_SELDOM = ("sample_time_min", "allow_unusual", "meal_size_spread_pct", "meal_time_spread_min")
"""Settings that the help of a study only names, unless the study says otherwise."""


def command_of_study(study: Study) -> Command:
    """The command of a study."""
    return Command(study.name, study.help, study_options(study), functools.partial(_run, study), more=study.name)


def study_options(study: Study) -> tuple[CommandOption, ...]:
    """Options of a study: the settings of what it asks for, in its words, and where its results go."""
    root = study.request
    options: tuple[CommandOption, ...] = without(options_of(root), root.refused)
    short = SHORT if "sensor" in root.settings() and "sensor" not in root.refused else ()
    computed: tuple[CommandOption, ...] = ()
    if isinstance(study, TrialStudy):
        computed = (WORKERS, *((DASK,) if study.on_clusters else ()))
    if isinstance(study, PlainStudy):
        output, help_of_output = OUTPUT if study.keeps_files else (JSON,), {}
    else:
        output = OUTPUT
        help_of_output = {
            "out": f"Folder of {study.what}; an unfinished one is resumed.",
            "overwrite": "Begin again in the folder.",
        }
    rare = {**dict.fromkeys(_SELDOM, True), **study.words.get("rare", {})}
    words = {**study.words, "help": {**help_of_output, **study.words.get("help", {})}, "rare": rare}
    mmol = (MMOL,) if study.in_mmol else ()
    return tuple(reworded((*options, *short, *computed, *output, *mmol), **words))


def _run(study: Study, typed: Given) -> None:
    """Check the request, carry it out or go on with it, and print the results."""
    request = request_of(typed, study_options(study))
    read_root(study.request, request.tree)
    if isinstance(study, TrialStudy):
        _run_trial(study, request, computing(typed))
    elif isinstance(study, SearchStudy):
        _run_search(study, request)
    elif isinstance(study, PlainStudy):
        _run_plain(study, request)
    else:
        raise TypeError(f"{type(study).__name__} is no kind of study")


def _asked(study: Study, request: Request) -> tuple[Any, Any]:
    """The module of a study, and the complete request."""
    asked = completed(request, functools.partial(asked_for, study.request))
    module: Any = importlib.import_module(study.module)
    note(_sentences(module, "notes", asked))
    return module, asked


def _work(study: Study, what: str, asked: Any, may_change: Iterable[str]) -> Work:
    from glucoloop.storage.resumable import Work

    return Work(
        command=study.name,
        what=what,
        keys=asked.tree(whole=True),
        given=asked.tree(),
        final=(*study.files, study.summary),
        summary=study.summary,
        may_change=frozenset(may_change),
    )


def _run_trial(study: TrialStudy, request: Request, where: Computing) -> None:
    output = request.output
    out = needed_folder(output, study.what, study.name)
    module, asked = _asked(study, request)
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.trials.folder import trial_folder

    work, trial, began = _work(study, "trial", asked, ()), module.trial_of(asked), time.monotonic()
    if output.overwrite:
        from glucoloop.cohorts.engine import prepare

        with stage("Designing controllers"):
            prepare(trial)  # what cannot be designed must not cost earlier work

    def finish(folder: TrialFolder) -> Findings:
        if folder.finished:
            return Findings.read(folder.path / study.summary)
        before = folder.people_done()
        compute(folder, where)
        with stage("Summing up"):
            found: Findings = module.found(asked, folder)
        with stage("Drawing"):
            folder.finish({**found.files(study.summary), **module.drawn(asked, found, **_shown(study, output))})
        note([f"{how_many(trial.people - before, 'person', 'people')} in {time.monotonic() - began:.1f} s."])
        return found

    found = carried_out(trial_folder(out, trial, overwrite=output.overwrite, work=work), finish)
    files = paths_of(work, out)
    written = f"Wrote {', '.join(files)} and {how_many(trial.shards, 'shard')} to {out}."
    _tell(study, module, asked, found, output, files, written=written)


def _shown(study: Study, output: Output) -> dict[str, bool]:
    """Arguments of `drawn` on how glucose is shown."""
    return {"mmol": output.mmol} if study.in_mmol else {}


def _run_search(study: SearchStudy, request: Request) -> None:
    output = request.output
    out = needed_folder(output, study.what, study.name) if study.needs_folder else output.place
    module, asked = _asked(study, request)
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.rows import rows_folder

    row_kind = module.rows(asked)

    def finish(folder: RowsFolder[Any] | None) -> Findings:
        if folder is not None and folder.finished:
            return Findings.read(folder.path / study.summary)
        with stage("Preparing"):
            search = module.search(asked)
        rows = [] if folder is None else folder.rows
        with counted(row_kind.wanted, len(rows), row_kind.what) as more:
            for row in search.missing(rows[:]):
                rows.append(row) if folder is None else folder.add(row)
                more(1)
        with stage("Summing up"):
            found: Findings = search.found(rows)
        if folder is not None:
            with stage("Drawing"):
                folder.finish({**found.files(study.summary), **module.drawn(asked, found)})
        return found

    if out is None:
        _tell(study, module, asked, finish(None), output, {})
        return
    work = _work(study, "search", asked, study.extent)
    found = carried_out(rows_folder(out, work, row_kind, overwrite=output.overwrite), finish)
    _tell(study, module, asked, found, output, paths_of(work, out, row_kind.file))


def _run_plain(study: PlainStudy, request: Request) -> None:
    output, files = request.output, dict[str, str]()
    with output.folder() if study.keeps_files else contextlib.nullcontext() as folder:
        module, asked = _asked(study, request)
        with _progress(study, module, asked) as progress:
            found = module.found(asked, progress)
        if folder is not None:
            from glucoloop.situations.toml import toml_text

            configuration = f"{study.name}.toml"
            text = toml_text(asked.tree(whole=True), f"{study.name} --config {configuration}", asked.tree())
            with stage("Drawing"):
                made = {configuration: text.encode(), **found.files(study.summary)}
                made |= module.drawn(asked, found, **_shown(study, output))
            for name, data in made.items():
                folder.write(name, data)
            files = folder.paths()
    _tell(study, module, asked, found, output, files, written=None if study.keeps_files else "")
    if found.plain.get("interrupted"):
        amount, unit = module.amount(asked), study.unit
        interrupted(
            f"interrupted; of {amount} {unit} {found.plain[unit]} were checked to the end; their results follow"
        )
    if not found.plain.get("holds", True):
        sys.exit(1)


@contextlib.contextmanager
def _progress(study: PlainStudy, module: Any, asked: Any) -> Iterator[Callable[[Any], None]]:
    """Progress of a study that is carried out in one go, in units or in words."""
    shown: Any = counted(module.amount(asked), 0, study.unit) if study.unit else stages("Preparing")
    with shown as progress:
        yield progress


def _tell(
    study: Study,
    module: Any,
    asked: Any,
    found: Findings,
    output: Output,
    files: Mapping[str, str],
    *,
    written: str | None = None,
) -> None:
    """Print what was found: as JSON, or as tables and sentences, the place of the files, and how to go on."""
    notes = tuple(found.plain.get("notes", ()))
    if output.json:
        tell_results(output, found.plain, files, (), (), notes=notes)
        return
    mmol = module.mmol_lines(found) if output.mmol else ()
    lines = (*_sentences(module, "sentences", asked, found), *notes, *mmol)
    tell_results(output, found.plain, files, module.tables(asked, found), lines, written=written)
    for line in _sentences(module, "how_to_go_on", found, files):
        print(line)


def _sentences(module: Any, function: str, *arguments: Any) -> Iterable[str]:
    """Sentences by a function of a study that its module may lack."""
    found: Iterable[str] = getattr(module, function)(*arguments) if hasattr(module, function) else ()
    return found
