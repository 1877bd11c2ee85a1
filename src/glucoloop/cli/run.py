"""``glucoloop run`` and ``glucoloop compare``: one controller, or several side by side, in one situation."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import MMOL, OUTPUT, SHORT, Given, options_of
from glucoloop.cli.request import Output, completed, request_of
from glucoloop.cli.screen import stage
from glucoloop.cli.study import tell_results
from glucoloop.cli.telling import mmol_lines
from glucoloop.parts.models import FilePart
from glucoloop.refusal import Refusal
from glucoloop.situations.option import CONTROLLER_PANEL, Option
from glucoloop.situations.request import asked_for, read_root
from glucoloop.situations.run import Run
from glucoloop.storage.strict_json import with_version
from glucoloop.studies.study import PARTS_TOLD

if TYPE_CHECKING:
    from glucoloop.bounds import Distance, OptimalDoses
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.closed_loop import Outcome

_FEWEST: Final = 2
RUN_HELP: Final = (
    "Simulate a controller in closed loop with a virtual patient and a meal.\n\n"
    "Without options it is the noise-free loop of Parker, Doyle and Peppas (1999): 50 g of carbohydrate at 50 min, "
    "linear MPC on a model identified from the patient. With --noise the model comes from an equally noisy record, and "
    "the tuning is the paper's for noise.\n\n"
    f"{PARTS_TOLD}\n\n"
    "  glucoloop run --noise 1.45 --seed 3 --out first\n\n"
    "  glucoloop run --controller 'mpc-se, move_weight=2' --guard --meal 60g@1h --meal 40g@6h --duration 720\n\n"
    "  glucoloop run --config first/run.toml"
)
COMPARE_HELP: Final = (
    "Simulate several controllers, or tunings of one, in the same situation and compare them.\n\n"
    "Give --controller for each; all have the same meals, the same noise and the same pump. What differs between them "
    "stands among the settings of each: its label, guard and model, and whether it knows the dead time.\n\n"
    f"{PARTS_TOLD}\n\n"
    "  glucoloop compare --controller pid --controller imc --controller mpc --out comparison\n\n"
    "  glucoloop compare --controller mpc --controller 'mpc, move_weight=1, label=careful' --noise 1.45\n\n"
    "  glucoloop compare --controller 'mpc, label=bare' --controller 'mpc, label=safe, guard=usual' --bound"
)


class Comparison(Run):
    """Several controllers in one situation."""

    kind: ClassVar = "comparison"

    bound: Annotated[
        bool,
        Option(
            "Compute the best that any controller could do that knows each meal when it begins, and the distance of "
            "each case from it.",
            panel=CONTROLLER_PANEL,
        ),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        number = len(self.cases)
        if number < _FEWEST:
            raise Refusal(
                f"a comparison of {number} case is not possible; give --controller for each of {_FEWEST} or more, like "
                "--controller mpc --controller 'mpc, move_weight=1, label=careful'"
            )


RUN_OPTIONS: Final = (*options_of(Run), *SHORT, *OUTPUT, MMOL)
COMPARE_OPTIONS: Final = (*options_of(Comparison), *SHORT, *OUTPUT, MMOL)


def run(typed: Given) -> None:
    """Check the request, run it, write and print the results."""
    request = request_of(typed, RUN_OPTIONS)
    read_root(Run, request.tree)
    output, files = request.output, dict[str, str]()
    with output.folder() as folder:
        asked = completed(request, functools.partial(asked_for, Run))
        from glucoloop.studies.closed_loop import close_the_loop

        with stage("Closing the loop"):
            outcome = close_the_loop(asked, asked.case)
        if folder is not None:
            with stage("Drawing"):
                write_outcome(folder, asked, outcome, output, outcome.report())
            files = folder.paths()
    tell(outcome, output, files, outcome.report())


def write_outcome(
    folder: OutputFolder, asked: Run, outcome: Outcome, output: Output, report: Mapping[str, Any], command: str = "run"
) -> None:
    """Write tables, metrics, pictures, and the configuration of the command that repeats them."""
    from glucoloop.report.facts import run_facts
    from glucoloop.storage import tables

    samples = tables.sample_table(outcome.trace)
    folder.write("trace.parquet", tables.parquet(samples))
    folder.write("trace.csv", tables.csv(samples))
    folder.write("glucose_1min.parquet", tables.parquet(tables.minute_table(outcome.trace)))
    files = {}
    if outcome.model is not None:
        folder.write("model.json", outcome.model.text())
        files = {outcome.case.label: "model.json"}
    name = outcome.case.controller.called
    _write_shared(
        folder,
        asked,
        {name: outcome},
        output,
        report,
        files,
        command=f"{command} --config run.toml",
        title=f"{name} at {asked.place}",
        facts=run_facts(asked, outcome.case, outcome.settled),
    )


def _write_shared(
    folder: OutputFolder,
    asked: Run,
    outcomes: Mapping[str, Outcome],
    output: Output,
    report: Mapping[str, Any],
    models: Mapping[str, str],
    *,
    command: str,
    title: str,
    facts: Mapping[str, str],
) -> None:
    """Write metrics, the configuration and pictures; `models` are the files of models beside them, by label."""
    from glucoloop.cli.pictures import RUN_FILES, write_pictures
    from glucoloop.report import Repeat
    from glucoloop.situations.toml import with_settled
    from glucoloop.storage.strict_json import json_text

    folder.write("metrics.json", json_text(with_version(report)) + "\n")
    used, given = asked.tree(whole=True), asked.tree()
    by_label = {outcome.case.label: outcome for outcome in outcomes.values()}
    for table in used["controller"]:
        outcome = by_label[table["label"]]
        table.update(with_settled({}, outcome.settled))
        if isinstance(outcome.case.model, FilePart):
            table["model"] = {"name": FilePart.name, "path": models[outcome.case.label]}
    _beside(asked, given, models)
    again = Repeat(command, used, RUN_FILES, given=given)
    folder.write(f"{command.rpartition(' ')[2]}", again.text)
    write_pictures(folder, outcomes, title=title, mmol=output.mmol, facts=facts, repeat=again)


def _beside(asked: Run, given: dict[str, Any], models: Mapping[str, str]) -> None:
    """Name the files of models beside a configuration in place of those that were given, so that it stands alone."""
    cases = [case for case in asked.cases if isinstance(case.model, FilePart)]
    if not cases:
        return
    given.pop("model", None)
    tables = given.get("controller") or [case.tree() for case in asked.cases]
    for table, case in zip(tables, asked.cases, strict=True):
        if case in cases and case.label in models:
            table["model"] = {"name": FilePart.name, "path": models[case.label]}
    given["controller"] = tables


def tell(
    outcome: Outcome, output: Output, files: dict[str, str], report: Mapping[str, Any], more: Iterable[str] = ()
) -> None:
    """Print the metrics and the notes, or one JSON object."""
    from glucoloop.report import metrics_table

    notes = (*outcome.notes, *more)
    mmol = mmol_lines({outcome.case.controller.called: outcome}) if output.mmol else ()
    tell_results(
        output,
        report,
        files,
        [metrics_table(outcome.metrics)],
        (*outcome.summary.sentences(), *notes, *mmol),
        notes=notes,
    )


def compare(typed: Given) -> None:
    """Check the request, run all cases, write and print them."""
    request = request_of(typed, COMPARE_OPTIONS)
    read_root(Comparison, request.tree)
    outcomes: dict[str, Outcome] = {}
    bound: OptimalDoses | None = None
    output, files = request.output, dict[str, str]()
    with output.folder() as folder:
        asked: Comparison = completed(request, functools.partial(asked_for, Comparison))
        from glucoloop.studies.closed_loop import close_the_loop

        if asked.bound:
            from glucoloop.bounds.optimal_doses import check_samples

            check_samples(asked.duration_min, asked.sample_time_min)
        for case in asked.cases:
            with stage(f"Closing the loop of {case.label}"):
                try:
                    outcomes[case.label] = close_the_loop(asked, case)
                except Refusal as error:
                    error.args = (f"case {case.label!r}: {error}",)
                    raise
        if asked.bound:
            with stage("Working out the bound"):
                from glucoloop.studies.bound.study import bound_of_run

                bound = bound_of_run(asked)
        if folder is not None:
            with stage("Drawing"):
                _write_comparison(folder, asked, outcomes, bound, output)
            files = folder.paths()
    _tell_comparison(asked, outcomes, bound, output, files)


def _write_comparison(
    folder: OutputFolder,
    asked: Comparison,
    outcomes: Mapping[str, Outcome],
    bound: OptimalDoses | None,
    output: Output,
) -> None:
    from glucoloop.report.facts import comparison_facts
    from glucoloop.storage import tables

    samples = tables.stacked({label: tables.sample_table(outcome.trace) for label, outcome in outcomes.items()})
    folder.write("trace.parquet", tables.parquet(samples))
    folder.write("trace.csv", tables.csv(samples))
    minutes = tables.stacked({label: tables.minute_table(outcome.trace) for label, outcome in outcomes.items()})
    folder.write("glucose_1min.parquet", tables.parquet(minutes))
    models = {}
    for number, (label, outcome) in enumerate(outcomes.items(), start=1):
        if outcome.model is not None:
            short = re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-") or "case"
            models[label] = f"model-{number}-{short}.json"
            folder.write(models[label], outcome.model.text())
    _write_shared(
        folder,
        asked,
        outcomes,
        output,
        _report(outcomes, bound),
        models,
        command="compare --config compare.toml",
        title=f"Comparison at {asked.place}",
        facts=comparison_facts(asked, {label: of.settled for label, of in outcomes.items()}),
    )


def _report(outcomes: Mapping[str, Outcome], bound: OptimalDoses | None) -> dict[str, object]:
    cases = {label: outcome.report() for label, outcome in outcomes.items()}
    if bound is None:
        return {"cases": cases}
    return {
        "cases": cases,
        "bound": {
            "known_after_min": bound.known_after_min,
            "deviation_mg_dl": bound.bound,
            "converged": bound.converged,
            "distances": {label: dataclasses.asdict(of) for label, of in _distances(outcomes, bound).items()},
        },
    }


def _distances(outcomes: Mapping[str, Outcome], bound: OptimalDoses) -> dict[str, Distance]:
    from glucoloop.bounds import distance_to_bound

    return {
        label: distance_to_bound(outcome.trace.fine_glucose_mg_dl, bound)
        for label, outcome in outcomes.items()
        if not _gave_boluses(outcome)
    }


def _gave_boluses(outcome: Outcome) -> bool:
    """Whether there was a bolus, which the bound does not know: it is that of rates within the pump's limits."""
    return outcome.trace.bolus_mU is not None and bool((outcome.trace.bolus_mU > 0.0).any())


def _tell_comparison(
    asked: Comparison,
    outcomes: Mapping[str, Outcome],
    bound: OptimalDoses | None,
    output: Output,
    files: dict[str, str],
) -> None:
    from glucoloop.report import comparison_table

    notes = (
        *(f"{label}: {text}" for label, outcome in outcomes.items() for text in outcome.notes),
        *_notes_on_bound(asked, outcomes, bound),
    )
    distances = None if bound is None else _distances(outcomes, bound)
    table = comparison_table({label: outcome.metrics for label, outcome in outcomes.items()}, distances)
    summaries = (f"{label}: {text}" for label, outcome in outcomes.items() for text in outcome.summary.sentences())
    lines = (*summaries, *notes, *(mmol_lines(outcomes) if output.mmol else ()))
    tell_results(output, _report(outcomes, bound), files, [table], lines, notes=notes)


def _notes_on_bound(asked: Comparison, outcomes: Mapping[str, Outcome], bound: OptimalDoses | None) -> Iterator[str]:
    if bound is None:
        return
    after_min = bound.known_after_min
    known = f"{after_min:g} min after its start" if after_min > 0.0 else "from its start"
    yield (
        f"The bound is that of a controller that knows each meal {known}, the patient and the pump's limits"
        f"{'' if bound.converged else '; it did not converge, so it is not a bound'}."
    )
    for label, outcome in outcomes.items():
        if _gave_boluses(outcome):
            yield (
                f"{label} gave boluses. The bound is of rates alone, so it does not hold for {label}, which has no "
                "distance from it."
            )
    if len(asked.meals) > 1:
        yield "A controller that prepares for a likely meal could do better."


RUN: Final = Command("run", RUN_HELP, RUN_OPTIONS, run, more="run")
COMPARE: Final = Command("compare", COMPARE_HELP, COMPARE_OPTIONS, compare, more="compare")
