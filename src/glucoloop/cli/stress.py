"""``glucoloop stress``: every controller, with and without a guard, under one fault after another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import MMOL, Given, options_of, reworded, with_options, without
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import stage
from glucoloop.cli.study import (
    carried_out,
    needed_folder,
    paths_of,
    read_request,
    read_with_cases,
    tell_results,
)
from glucoloop.cli.telling import note_on_boluses
from glucoloop.cli.trial import compute, computing
from glucoloop.cli.trial_options import DASK, TRIAL, usual_texts
from glucoloop.config.key import declared
from glucoloop.studies.stress.options import REFUSED, USUAL, StressKeys

if TYPE_CHECKING:
    from glucoloop.storage.trials.folder import TrialFolder
    from glucoloop.studies.stress.keys import StressTest
    from glucoloop.studies.stress.stress import StressResult

HELP: Final = (
    "Test controllers under faults of sensor and pump, one fault at a time, with and without a guard; the results are "
    "a table and a page.\n\n"
    "The same people, with the same meals and noise, are simulated with each fault and without it. By default these "
    "are 100 people whose metabolism varies as in Parker et al. (2000), with 50 g at 50 min, noise of variance 1.45, "
    "23 faults and the paper's four controllers. The folder is written in parts; after Ctrl-C, the same command "
    "continues where it stopped.\n\n"
    "  glucoloop stress --out stress\n\n"
    "  glucoloop stress --controller mpc --people 1000 --fault 'stuck, start_min=60, duration_min=90' --out stuck\n\n"
    "  glucoloop stress --config stress/stress.toml --out again"
)
_OPTIONS: Final = (
    *reworded(
        without(TRIAL, *REFUSED, *declared(StressKeys), DASK.key, MMOL.key),
        help={
            "out": "Folder of the test; an unfinished test in it is resumed.",
            "overwrite": "Begin again and replace the test in the folder.",
        },
        default=usual_texts(USUAL),
    ),
    *options_of(StressKeys),
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, run or resume the test, and print the results."""
    keys, output, file = split_off_output(given)
    where = computing(keys)
    out = needed_folder(output, "a stress test", "stress")
    asked = read_request(keys, file, _read)
    from glucoloop.storage.trials.folder import trial_folder
    from glucoloop.studies.stress.results import summary_of, verdict, work_of
    from glucoloop.studies.stress.table import stress_table

    trial, work = asked.stress.trial, work_of(asked)
    note_on_boluses(trial.patient, (case.controller for case in trial.cases))

    def finish(folder: TrialFolder) -> StressResult:
        from glucoloop.studies.stress.results import files_of, result_of, told_before

        if folder.finished:
            return told_before(asked, folder)
        compute(folder, where)
        with stage("Looking for reasons"):
            result = result_of(asked, folder)
        with stage("Drawing"):
            folder.finish(files_of(result))
        return result

    result = carried_out(trial_folder(out, trial, overwrite=output.overwrite, work=work), finish)
    files = paths_of(work, out)
    shards = f"{trial.shards} {'shard' if trial.shards == 1 else 'shards'}"
    written = f"Wrote {', '.join(files)} and {shards} to {out}."
    tell_results(output, summary_of(result), files, [stress_table(result)], verdict(result), written=written)


def _read(keys: Given, of_file: Given) -> StressTest:
    from glucoloop.studies.stress.keys import read_stress

    return read_with_cases(keys, of_file, _OPTIONS, read_stress)
