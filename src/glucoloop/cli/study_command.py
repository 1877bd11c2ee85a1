"""Commands of declared studies: request, progress, folder, resumption, output and exit code, made once for all."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from glucoloop.cli.command import (
    DASK,
    OUTPUT,
    SET,
    TRACES_AT,
    UNITS,
    WORKERS,
    Command,
    CommandOption,
    Given,
    options_of,
    reworded,
)
from glucoloop.cli.errors import interrupted
from glucoloop.cli.progress import counted
from glucoloop.cli.request import CommandRequest, Output, command_request, configuration_of, notes_without_effect
from glucoloop.cli.screen import note, print_json, print_text, show, stage, where_written
from glucoloop.component.request import read_root
from glucoloop.display_units import in_shown_units, showing
from glucoloop.refusal import Refusal
from glucoloop.studies.study import PlainStudy, SearchStudy, Study, TrialStudy
from glucoloop.text import how_many

if TYPE_CHECKING:
    from glucoloop.storage.results import Results
    from glucoloop.storage.resumable import ResumableFolder, Work
    from glucoloop.trials.computing import Workers
    from glucoloop.trials.folder import TrialFolder

F = TypeVar("F", bound="ResumableFolder")

TABLES = "tables.tex"
"""File of every study with its tables as LaTeX."""
_SELDOM = ("sample_time_min", "allow_unusual", "meal_size_spread_pct", "meal_time_spread_min")
"""Settings that the help of a study only names, unless the study says otherwise."""


def command_of_study(study: Study) -> Command:
    """The command of a study."""
    return Command(study.name, study.help, study_options(study), functools.partial(_run, study), more=study.name)


def study_options(study: Study) -> tuple[CommandOption, ...]:
    """Options of a study: the settings of what it asks for, in its words, and where its results go."""
    options = options_of(study.request)
    if isinstance(study, TrialStudy):
        options += (WORKERS, DASK, TRACES_AT) if study.on_clusters else (WORKERS,)
    help_of_output = {}
    if not isinstance(study, PlainStudy):
        out = f"Folder of {study.what}; an unfinished one is resumed."
        help_of_output = {"out": out, "overwrite": "Begin again in the folder."}
    nested = any(option.key == "patient" for option in options)  # others have no setting that is not an option
    output = tuple(option for option in OUTPUT if nested or option is not SET)
    options += (*output, UNITS)
    rare = {**dict.fromkeys(_SELDOM, True), **study.option_texts.get("rare", {})}
    texts = {**study.option_texts, "help": {**help_of_output, **study.option_texts.get("help", {})}, "rare": rare}
    return tuple(reworded(options, **texts))


def _run(study: Study, typed: Given) -> None:
    """Carry a study out or go on with it, print the results, and leave with its exit code."""
    with showing(typed.get(UNITS.key, "mg/dl")):
        outcome = carry_out(study, typed)
        outcome.print()
    if outcome.interruption:
        interrupted(outcome.interruption)
    if not outcome.holds:
        sys.exit(1)


def carry_out(study: Study, typed: Given) -> StudyOutcome:
    """Check the options of a study, and carry it out or go on with it."""
    request = command_request(typed, study_options(study))
    read_root(study.request, request.tree)
    if isinstance(study, TrialStudy):
        return _run_trial(study, request, typed)
    if isinstance(study, SearchStudy):
        return _run_search(study, request)
    if isinstance(study, PlainStudy):
        return _run_plain(study, request)
    raise TypeError(f"{type(study).__name__} is no kind of study")


@dataclass(frozen=True)
class StudyOutcome:
    """Results of a study that was carried out, and the files that hold them."""

    run: _StudyRun
    results: Results
    files: Mapping[str, str]
    """Paths of the files by name."""
    written: str | None = None
    """Sentence on the place of the files, where it differs from the default one."""
    interruption: str = ""
    """Sentence on what was done when the study was interrupted; empty for one that is whole."""

    @property
    def holds(self) -> bool:
        """Whether everything that the study checks holds, as its exit code tells."""
        return bool(self.results.plain.get("holds", True) and self.results.plain.get("complete", True))

    def tables(self) -> tuple[object, ...]:
        """Tables for the terminal, which rich prints."""
        with self.results.refusing_damage():
            return tuple(self.run.module.tables(self.run.config, self.results))

    def sentences(self) -> tuple[str, ...]:
        """Conclusions and notes, in the units that are shown."""
        run, results = self.run, self.results
        with results.refusing_damage():
            conclusions = run.sentences("sentences", run.config, results)
            return tuple(map(in_shown_units, (*conclusions, *self._further_notes())))

    def _further_notes(self) -> tuple[str, ...]:
        """Notes that were not given before the study was carried out."""
        return tuple(text for text in self.results.plain.get("notes", ()) if text not in self.run.without_effect)

    def print(self) -> None:
        """Print the results: as JSON, or as tables and sentences, the place of the files, and how to go on."""
        run, results = self.run, self.results
        tables, sentences = self.tables(), self.sentences()
        with results.refusing_damage():
            next_steps = tuple(run.sentences("next_steps", results, self.files))
        if run.output.json:
            print_json(results.plain, self.files, self._further_notes())
            return
        with results.refusing_damage():
            for table in tables:
                show(table)
        place = where_written(run.output.out, self.files) if self.written is None else self.written
        for line in (*sentences, *([place] if place else []), *next_steps):
            print_text(line)


def _run_again(study: Study, output: Output, config: Any, without_effect: tuple[str, ...]) -> _StudyRun:
    return _StudyRun(study, output, importlib.import_module(study.module), config, without_effect)


@dataclass(frozen=True)
class _StudyRun:
    """A study whose request is complete."""

    study: Study
    output: Output
    module: Any
    config: Any
    without_effect: tuple[str, ...]
    """Notes on what was given and changes nothing."""

    @classmethod
    def of(cls, study: Study, request: CommandRequest) -> _StudyRun:
        """Complete the request, and import the module that does the work."""
        config = configuration_of(request, study.request)
        run = cls(study, request.output, importlib.import_module(study.module), config, notes_without_effect(config))
        note(map(in_shown_units, (*run.sentences("notes", config), *run.without_effect)))
        return run

    def __reduce__(self) -> tuple[Any, ...]:
        """The parts of which it is made anew: a module cannot be pickled."""
        return _run_again, (self.study, self.output, self.config, self.without_effect)

    def with_notes(self, results: Results) -> Results:
        """Findings whose notes begin with those on what changes nothing, for JSON and the files."""
        if not self.without_effect:
            return results
        notes = [*self.without_effect, *results.plain.get("notes", ())]
        return dataclasses.replace(results, values={**results.plain, "notes": notes})

    def work(self, may_change: Iterable[str] = ()) -> Work:
        """Work that a folder keeps."""
        from glucoloop.storage.resumable import Work

        return Work(
            command=self.study.name,
            what=self.study.what.removeprefix("a "),
            keys=self.config.tree(whole=True),
            explicit=self.config.tree(),
            final=_final(self.study),
            may_change=frozenset(may_change),
        )

    def carry_out(self, opened: AbstractContextManager[F], compute: Callable[[F], Results]) -> Results:
        """Begin, or go on with, the work of a folder and finish it; after Ctrl-C, print how much is kept."""
        from glucoloop.storage.results import Results

        folder: F | None = None
        try:
            with opened as folder:
                note(folder.notes)
                if folder.finished:
                    note([f"{folder.path} was finished before; nothing is computed again."])
                    return Results.read(folder.path / self.study.summary)
                if folder.done:
                    note([f"{folder.progress} of {folder.path} are there already; going on."])
                results = self.with_notes(compute(folder))
                folder.finish(self.files_of(results))
                return results
        except KeyboardInterrupt:
            if folder is None:
                raise
            interrupted(f"interrupted; {folder.progress} are kept, the same command goes on")

    def files_of(self, results: Results) -> dict[str, bytes]:
        """Files of what was found, of its tables as LaTeX, and of its pages and figures, by name."""
        from glucoloop.display_units import rates_as_pumps_show
        from glucoloop.reporting.latex import latex_tables

        name = self.study.name
        with stage("Drawing"):
            tables = latex_tables(self.module.tables(self.config, results), name, f"glucoloop {name}")
            with rates_as_pumps_show(getattr(getattr(self.config, "patient", None), "subcutaneous", False)):
                files: Mapping[str, bytes] = self.module.files_of(self.config, results)
            return {**results.files(self.study.summary), TABLES: tables.encode(), **files}

    def sentences(self, function: str, *arguments: Any) -> Iterable[str]:
        """Sentences by a function that the module may lack."""
        results: Iterable[str] = getattr(self.module, function)(*arguments) if hasattr(self.module, function) else ()
        return results


def _run_trial(study: TrialStudy, request: CommandRequest, typed: Given) -> StudyOutcome:
    from glucoloop.trials.computing import Workers
    from glucoloop.trials.folder import SHARDS, TrialFolder, trial_folder
    from glucoloop.trials.trace_store import store_address

    workers = Workers.of(typed.get(WORKERS.key), typed.get(DASK.key))
    traces_at = store_address(typed[TRACES_AT.key]) if TRACES_AT.key in typed else None
    out = _needed_folder(study, request.output)
    _refuse_unusable(study, out, TrialFolder, SHARDS, overwrite=request.output.overwrite)
    run = _StudyRun.of(study, request)
    module = run.module

    work, trial, start = run.work(study.extent), module.trial_of(run.config), time.monotonic()
    if traces_at is not None and trial.traces == "none":
        raise Refusal(f"no traces are kept for {traces_at}", "add --traces all", "leave --traces-at out")
    if request.output.overwrite:
        from glucoloop.trials.engine import prepare

        with stage("Designing controllers"):
            prepare(trial)  # what cannot be designed must not cost earlier work

    def compute(folder: TrialFolder) -> Results:
        before = folder.people_done()
        _compute_shards(folder, workers)
        note([f"{how_many(trial.people - before, 'person', 'people')} in {time.monotonic() - start:.1f} s."])
        with stage("Summing up"):
            results: Results = module.results_of(run.config, folder)
            return results

    folder = trial_folder(out, trial, overwrite=request.output.overwrite, work=work, traces_at=traces_at)
    results = run.carry_out(folder, compute)
    files = _paths(out, *work.final, work.configuration)
    elsewhere = "" if traces_at is None else f", and their traces to {traces_at}"
    written = f"Wrote {', '.join(files)} and {how_many(trial.shards, 'shard')} to {out}{elsewhere}."
    return StudyOutcome(run, results, files, written)


def _compute_shards(folder: TrialFolder, workers: Workers) -> None:
    """Design the controllers of a trial and compute its missing shards, with its progress."""
    from glucoloop.reporting.descriptions import engine_notes
    from glucoloop.trials.computing import beginning
    from glucoloop.trials.engine import prepare

    missing = folder.missing()
    if missing:
        note([beginning(folder.trial)])
    with stage("Designing controllers"):
        prepared = prepare(folder.trial)
    note(engine_notes(prepared.engines))
    if not missing:
        return
    with contextlib.ExitStack() as stack:
        with stage("Connecting to the cluster") if workers.dask else contextlib.nullcontext():
            client = stack.enter_context(workers.cluster())
        if client is not None and not client.nthreads():
            note([f"No worker has come to {workers.dask} yet; waiting for one."])
        more = stack.enter_context(counted(folder.trial.people, folder.people_done(), "people"))
        workers.compute(prepared, folder, client, more, lambda sentence: note([sentence]))


def _run_search(study: SearchStudy, request: CommandRequest) -> StudyOutcome:
    output = request.output
    out = _needed_folder(study, output) if study.needs_folder else output.place
    from glucoloop.storage.rows import RowsFolder, rows_folder

    if out is not None:
        _refuse_unusable(study, out, RowsFolder, study.results, overwrite=output.overwrite)
    run = _StudyRun.of(study, request)
    module = run.module
    row_kind = module.rows(run.config)

    total, unit = row_kind.amount(row_kind.wanted), row_kind.unit or row_kind.what

    def search(rows: list[Any], add: Callable[[Any], None]) -> Results:
        with stage("Preparing"):
            prepared = module.search(run.config)
        try:
            with counted(total, row_kind.amount(len(rows)), unit, rate_over_s=row_kind.rate_over_s) as more:
                within = (more,) if row_kind.counted_within else ()
                for number, row in enumerate(prepared.missing(rows[:], *within), start=len(rows)):
                    add(row)
                    if not within:
                        more(row_kind.work(number))
        except KeyboardInterrupt:
            if out is not None or not study.partial:
                raise
        with stage("Summing up"):
            results: Results = prepared.results_of(rows)
            return results

    if out is None:
        rows: list[Any] = []
        results = run.with_notes(search(rows, rows.append))
        done = row_kind.amount(len(rows))
        interruption = f"interrupted; of {total} {unit} {done} were checked to the end; their results follow"
        whole = not study.partial or len(rows) == row_kind.wanted
        return StudyOutcome(run, results, {}, interruption="" if whole else interruption)
    work = run.work(study.extent)
    opened = rows_folder(out, work, row_kind, overwrite=output.overwrite)
    results = run.carry_out(opened, lambda folder: search(folder.rows, folder.add))
    return StudyOutcome(run, results, _paths(out, *work.final, row_kind.file, work.configuration))


def _run_plain(study: PlainStudy, request: CommandRequest) -> StudyOutcome:
    files: dict[str, str] = {}
    with request.output.folder(f"{study.name}.toml", study.summary) as folder:
        run = _StudyRun.of(study, request)
        config = run.config
        module = run.module
        shown: Any = counted(module.amount(config), 0, study.unit) if study.unit else stage("Preparing")
        with shown as progress:
            results = run.with_notes(module.results_of(config, progress))
        if folder is not None:
            from glucoloop.situations.toml import toml_text

            configuration = f"{study.name}.toml"
            text = toml_text(config.tree(whole=True), f"{study.name} --config {configuration}", config.tree())
            for name, data in {configuration: text.encode(), **run.files_of(results)}.items():
                folder.write(name, data)
            files = folder.paths()
    return StudyOutcome(run, results, files)


def _needed_folder(study: Study, output: Output) -> Path:
    """The output folder of a study that is always kept in one."""
    if output.out is None:
        raise Refusal(f"--out is missing; {study.what} is kept in a folder, name one like --out {study.name}")
    return output.out


def _final(study: Study) -> tuple[str, ...]:
    """Files that are written when everything is done."""
    return (*study.files, TABLES, study.summary)


def _refuse_unusable(study: Study, out: Path, kind: type[ResumableFolder], results: str, *, overwrite: bool) -> None:
    """Refuse, before anything is imported or computed, a folder that the study can never use."""
    from glucoloop.storage.resumable import refuse_unusable

    names = (f"{study.name}.toml", results, *_final(study))
    refuse_unusable(out, study.what.removeprefix("a "), kind.record, names, overwrite=overwrite)


def _paths(out: Path, *files: str) -> dict[str, str]:
    return {name: str(out / name) for name in files}
