"""``glucoloop compare``: several controllers or tunings in one situation, side by side."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import CASE, MMOL, OUTPUT, SITUATION, Given, Option, names, with_options
from glucoloop.cli.request import Output, file_keys, keys_used, read_again, split_off_output, with_lists
from glucoloop.cli.screen import stage
from glucoloop.cli.study import tell_results
from glucoloop.cli.telling import mmol_lines
from glucoloop.refusal import Refusal
from glucoloop.storage.strict_json import with_version

if TYPE_CHECKING:
    from glucoloop.bounds import Distance, OptimalDoses
    from glucoloop.config.comparison import Comparison
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.closed_loop import Outcome

HELP: Final = (
    "Compare controllers or tunings with the same patient, meals, sensor and pump: one table, one figure.\n\n"
    "A case is a label and the settings that are its own, [LABEL:] [CONTROLLER,] [KEY=VALUE, ...]; its keys are the "
    "controller and "
    "model options with underscores. Controller and model options given beside the cases hold for every case that "
    "does not say otherwise; given beside a file, they hold for every case of the file.\n\n"
    "  glucoloop compare --case mpc --case 'careful: mpc, move_weight=1'\n\n"
    "  glucoloop compare --noise 1.45 --case 'short: prediction_horizon=6' --case 'long: prediction_horizon=14'\n\n"
    "  glucoloop compare --dead-time 10 --case 'unknown: mpc' --case 'known: mpc, known_dead_time=true'\n\n"
    "  glucoloop compare --bound --case mpc --case nlqdmc-se\n\n"
    "In a file, each case is a table: [[case]], with label = 'careful', controller = 'mpc', move_weight = 1."
)
_CASES: Final = Option(
    "cases",
    "--case",
    list[str],
    "A case, like 'careful: mpc, move_weight=1'; give two or more, which take the place of the file's.",
    "Cases",
    metavar="CASE",
)
_BOUND: Final = Option(
    "bound",
    "--bound/--no-bound",
    bool,
    "Also compute the best result possible with each meal known from its start, and the distance of each case from it.",
    "Cases",
    default="no bound",
)
_OPTIONS: Final = (_CASES, _BOUND, *SITUATION, *CASE, *OUTPUT, MMOL)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, run all cases, write and print them."""
    keys, output, file = split_off_output(given)
    keys, of_file = with_lists(keys), file_keys(file)
    bounded = _bounded(keys, of_file)
    asked = read_again(_read, keys_used, keys, of_file)
    outcomes: dict[str, Outcome] = {}
    bound: OptimalDoses | None = None
    files: dict[str, str] = {}
    with output.folder() as folder:
        with stage("Importing the simulator"):
            from glucoloop.cli.compiled import keep_compiled
            from glucoloop.studies.closed_loop import close_the_loop
        if bounded:
            from glucoloop.bounds.optimal_doses import check_samples

            check_samples(asked.situation.duration_min, asked.situation.sample_time_min)
        keep_compiled()
        for label, run in asked.runs().items():
            with stage(f"Closing the loop of {label}"):
                try:
                    outcomes[label] = close_the_loop(run)
                except Refusal as error:
                    error.args = (f"case {label!r}: {error}",)
                    raise
        if bounded:
            with stage("Working out the bound"):
                from glucoloop.studies.bound.study import bound_of_run

                bound = bound_of_run(asked.situation)
        if folder is not None:
            with stage("Drawing"):
                _write(folder, asked, outcomes, bound, output)
            files = folder.paths()
    _tell(outcomes, bound, output, files)


def _bounded(keys: Given, of_file: Given) -> bool:
    """Whether the bound is requested, for which a run has no key."""
    in_file = of_file.pop(_BOUND.key, False)
    if not isinstance(in_file, bool):
        raise Refusal(f"bound is {in_file!r}; give true or false")
    return bool(keys.pop(_BOUND.key, in_file))


def _read(keys: Given, of_file: Given) -> Comparison:
    from glucoloop.config.cases import take_cases
    from glucoloop.config.comparison import read_comparison
    from glucoloop.config.run import overlay

    cases = take_cases(keys, of_file)
    called = names(_OPTIONS, keys)
    return read_comparison(overlay(of_file, keys, called), cases, called)


def _write(
    folder: OutputFolder,
    asked: Comparison,
    outcomes: Mapping[str, Outcome],
    bound: OptimalDoses | None,
    output: Output,
) -> None:
    from glucoloop.cli.pictures import RUN_FILES, write_pictures
    from glucoloop.config.toml import with_settled
    from glucoloop.report import Repeat
    from glucoloop.report.facts import comparison_facts
    from glucoloop.storage import tables
    from glucoloop.storage.strict_json import json_text

    samples = tables.stacked({label: tables.sample_table(outcome.trace) for label, outcome in outcomes.items()})
    folder.write("trace.parquet", tables.parquet(samples))
    folder.write("trace.csv", tables.csv(samples))
    minutes = tables.stacked({label: tables.minute_table(outcome.trace) for label, outcome in outcomes.items()})
    folder.write("glucose_1min.parquet", tables.parquet(minutes))
    folder.write("metrics.json", json_text(with_version(_report(outcomes, bound))) + "\n")
    more = {} if bound is None else {_BOUND.key: True}
    keys, given = {**more, **asked.keys()}, None if asked.given is None else {**more, **asked.given}
    for number, (table, (label, outcome)) in enumerate(zip(keys["case"], outcomes.items(), strict=True), start=1):
        if outcome.model is not None:
            name = f"model-{number}-{re.sub(r'[^a-z0-9]+', '-', label.lower()).strip('-') or 'case'}.json"
            folder.write(name, outcome.model.text())
            if outcome.run.case.model is not None:
                table["model"] = name
                if given is not None:
                    given["case"][number - 1]["model"] = name
    for table, outcome in zip(keys["case"], outcomes.values(), strict=True):
        table.update(with_settled({}, outcome.settled))
    again = Repeat("compare --config compare.toml", keys, RUN_FILES, given=given)
    folder.write("compare.toml", again.text)
    write_pictures(
        folder,
        outcomes,
        title=f"Comparison at {asked.situation.place}",
        mmol=output.mmol,
        facts=comparison_facts(asked, {label: of.settled for label, of in outcomes.items()}),
        repeat=again,
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


def _tell(outcomes: Mapping[str, Outcome], bound: OptimalDoses | None, output: Output, files: dict[str, str]) -> None:
    notes = tuple(f"{label}: {text}" for label, outcome in outcomes.items() for text in outcome.notes)
    if bound is not None:
        notes += (
            f"The bound is that of a controller that knows each meal {_known(bound.known_after_min)}, the patient "
            f"and the "
            f"pump's limits{'' if bound.converged else '; it did not converge, so it is not a bound'}.",
            *(
                f"{label} gave boluses. The bound is of rates alone, so it does not hold for {label}, which has no "
                "distance from it."
                for label, outcome in outcomes.items()
                if _gave_boluses(outcome)
            ),
            *(["A controller that prepares for a likely meal could do better."] if len(_meals(outcomes)) > 1 else []),
        )
    from glucoloop.report import comparison_table

    distances = None if bound is None else _distances(outcomes, bound)
    table = comparison_table({label: outcome.metrics for label, outcome in outcomes.items()}, distances)
    told = (f"{label}: {text}" for label, outcome in outcomes.items() for text in outcome.summary.sentences())
    lines = (*told, *notes, *(mmol_lines(outcomes) if output.mmol else ()))
    tell_results(output, _report(outcomes, bound), files, [table], lines, notes=notes)


def _meals(outcomes: Mapping[str, Outcome]) -> tuple[str, ...]:
    return next(iter(outcomes.values())).run.situation.meals


def _known(after_min: float) -> str:
    return f"{after_min:g} min after its start" if after_min > 0.0 else "from its start"
