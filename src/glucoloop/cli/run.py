"""``glucoloop run``: one controller in one situation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.options import CASE, MMOL, OUTPUT, SITUATION, Given, names, with_options
from glucoloop.cli.request import Output, file_keys, keys_used, read_again, split_off_output, with_lists
from glucoloop.cli.screen import stage
from glucoloop.cli.study import tell_results
from glucoloop.cli.telling import mmol_lines
from glucoloop.storage.strict_json import with_version

if TYPE_CHECKING:
    from glucoloop.config.run import Run
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.closed_loop import Outcome

HELP: Final = (
    "Simulate a controller in closed loop with a virtual patient and a meal.\n\n"
    "Without options it is the noise-free loop of Parker, Doyle and Peppas (1999): 50 g of carbohydrate at 50 min, "
    "linear MPC on a model identified from the patient. With --noise the model comes from an equally noisy record, and "
    "the tuning is the paper's for noise.\n\n"
    "  glucoloop run --noise 1.45 --seed 3 --out first\n\n"
    "  glucoloop run --meal 60g@1h --meal 40g@6h --duration 720\n\n"
    "  glucoloop run --config first/run.toml"
)
_OPTIONS: Final = (*SITUATION, *CASE, *OUTPUT, MMOL)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, run it, write and print the results."""
    keys, output, file = split_off_output(given)
    asked = read_again(_read, keys_used, with_lists(keys), file_keys(file))
    files: dict[str, str] = {}
    with output.folder() as folder:
        with stage("Importing the simulator"):
            from glucoloop.cli.compiled import keep_compiled
            from glucoloop.studies.closed_loop import close_the_loop
        keep_compiled()
        with stage("Closing the loop"):
            outcome = close_the_loop(asked)
        if folder is not None:
            with stage("Drawing"):
                again = outcome.repeat()
                write_outcome(folder, outcome, output, outcome.report(), again.keys(), again.given)
            files = folder.paths()
    tell(outcome, output, files, outcome.report())


def _read(keys: Given, of_file: Given) -> Run:
    from glucoloop.config.run import overlay, read_run

    called = names(_OPTIONS, keys)
    return read_run(overlay(of_file, keys, called), called)


def write_outcome(
    folder: OutputFolder,
    outcome: Outcome,
    output: Output,
    report: Mapping[str, Any],
    repeat: Mapping[str, Any],
    given: Mapping[str, Any] | None,
    command: str = "run",
) -> None:
    """Write tables, metrics, pictures, and the configuration of the command that repeats them."""
    from glucoloop.cli.pictures import RUN_FILES, write_pictures
    from glucoloop.config.toml import with_settled
    from glucoloop.report import Repeat
    from glucoloop.report.facts import run_facts
    from glucoloop.storage import tables
    from glucoloop.storage.strict_json import json_text

    samples = tables.sample_table(outcome.trace)
    folder.write("trace.parquet", tables.parquet(samples))
    folder.write("trace.csv", tables.csv(samples))
    folder.write("glucose_1min.parquet", tables.parquet(tables.minute_table(outcome.trace)))
    folder.write("metrics.json", json_text(with_version(report)) + "\n")
    if outcome.model is not None:
        folder.write("model.json", outcome.model.text())
    again = Repeat(f"{command} --config run.toml", with_settled(repeat, outcome.settled), RUN_FILES, given=given)
    folder.write("run.toml", again.text)
    case, situation = outcome.run.case, outcome.run.situation
    write_pictures(
        folder,
        {case.controller: outcome},
        title=f"{case.controller} at {situation.place}",
        mmol=output.mmol,
        facts=run_facts(outcome.repeat(), outcome.settled),
        repeat=again,
    )


def tell(
    outcome: Outcome, output: Output, files: dict[str, str], report: Mapping[str, Any], more: Iterable[str] = ()
) -> None:
    """Print the metrics and the notes, or one JSON object."""
    from glucoloop.report import metrics_table

    notes = (*outcome.notes, *more)
    mmol = mmol_lines({outcome.run.case.controller: outcome}) if output.mmol else ()
    tell_results(
        output,
        report,
        files,
        [metrics_table(outcome.metrics)],
        (*outcome.summary.sentences(), *notes, *mmol),
        notes=notes,
    )
