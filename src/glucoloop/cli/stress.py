"""``glucoloop stress``: every controller, with and without a guard, under one fault after another."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import FAULTS, NO_FAULT, Given, Option, names, with_options
from glucoloop.cli.request import Output, file_keys, split_off_output, with_lists
from glucoloop.cli.screen import note, show, stage
from glucoloop.cli.trial_options import DASK, GUARDS, TRIAL, WORKERS
from glucoloop.cli.trial_progress import counted

if TYPE_CHECKING:
    from glucoloop.storage.trials.folder import TrialFolder
    from glucoloop.storage.trials.shard import Simulate
    from glucoloop.studies.stress.keys import StressTest
    from glucoloop.studies.stress.stress import StressResult

HELP: Final = (
    "Try controllers under faults of sensor and pump, one at a time, with and without a guard: one table, one page.\n\n"
    "Each fault is met by the same people, meals and noise, and compared with the run without it. Without options it "
    "is the paper's four controllers on 100 people whose metabolism varies as in Parker et al. (2000), 50 g at 50 min, "
    "noise of variance 1.45, and 23 faults. The folder grows shard by shard; after Ctrl-C the same command goes on.\n\n"
    "  glucoloop stress --out stress\n\n"
    "  glucoloop stress --controller mpc --people 1000 --fault 'stuck, start_min=60, duration_min=90' --out stuck\n\n"
    "  glucoloop stress --config stress/stress.toml --out again"
)
CONFIGURATION: Final = "stress.toml"
_FILES: Final = (
    "stress.csv",
    "stress.parquet",
    "summary.json",
    "stress.html",
    "figure.pdf",
    "figure.png",
    "figure.svg",
)
_NOT_HERE: Final = ("traces", "guard", NO_FAULT, DASK.key, "mmol")
_WORDS: Final = {
    FAULTS: "A fault that is tried alone, in place of the usual ones; repeat it for more. ",
    "out": "Folder of the test; one that was begun there goes on.",
    "overwrite": "Begin again, whatever test the folder holds.",
}
_DEFAULTS: Final = {
    "people": "100",
    "duration_min": "600",
    "meals": "50g@50min",
    "noise_variance": "1.45",
    "controllers": "imc, mpc, mpc-se, nlqdmc-se",
}


def _options() -> Iterator[Option]:
    for option in TRIAL:
        if option.key in _NOT_HERE:
            continue
        told = option.help
        if option.key == FAULTS:
            told = _WORDS[FAULTS] + told[told.index("Sensor:") :]
        yield dataclasses.replace(
            option,
            help=told if option.key == FAULTS else _WORDS.get(option.key, told),
            default=_DEFAULTS.get(option.key, option.default),
        )
    yield GUARDS


_OPTIONS: Final = tuple(_options())


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check what was asked for, carry it out or go on with it, and tell it."""
    keys, output, file = split_off_output(given)
    workers = keys.pop(WORKERS.key, None)
    if workers is not None and workers < 1:
        raise ValueError(f"--workers is {workers}; give 1 or more")
    texts = with_lists(keys), file_keys(file)
    if output.out is None:
        raise ValueError("--out is missing; a stress test is kept in a folder, name one like --out stress")
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled

        asked = _read(*texts)
    keep_compiled()
    _carry_out(asked, output, output.out, workers)


def _read(keys: Given, of_file: Given) -> StressTest:
    from glucoloop.config.cases import take_cases
    from glucoloop.config.trial import overlay_trial
    from glucoloop.studies.stress.keys import read_stress

    cases = take_cases(keys, of_file)
    called = names(_OPTIONS, keys)
    return read_stress(overlay_trial(of_file, keys, called), cases, called)


def _carry_out(asked: StressTest, output: Output, out: Path, workers: int | None) -> None:
    from glucoloop.config import toml_text
    from glucoloop.storage.trials.folder import Kind, trial_folder

    trial, folder = asked.stress.trial, None
    text = toml_text(asked.keys(), f"stress --config {CONFIGURATION}")
    try:
        with trial_folder(
            out, trial, overwrite=output.overwrite, kind=Kind(configuration=CONFIGURATION, text=text, final=_FILES)
        ) as folder:
            note(folder.notes)
            if folder.done and not folder.finished:
                note([f"{folder.done} of {trial.shards} shards of {out} are done already; going on."])
            result = _finish(asked, folder, workers)
    except KeyboardInterrupt:
        if folder is None:
            raise
        interrupted(f"interrupted; {folder.done} of {trial.shards} shards are done, the same command goes on")
    _tell(asked, result, output, out)


def _simulator(asked: StressTest, workers: int | None) -> Simulate:
    from glucoloop.cohorts import engine

    prepared = engine.prepare(asked.stress.trial)
    return lambda label, person, traces: engine.run_people(prepared, label, person, traces=traces, threads=workers)


def _finish(asked: StressTest, folder: TrialFolder, workers: int | None) -> StressResult:
    """Compute what is missing, and sum up; of a test that was finished before, tell what is there."""
    from glucoloop.storage.trials.run import run_here
    from glucoloop.studies.stress.results import files_of, result_of, told_before

    trial = folder.trial
    if folder.finished:
        note([f"{folder.path} was finished before; nothing is computed again."])
        return told_before(asked, folder)
    with stage("Designing controllers"):
        simulate = _simulator(asked, workers)
    if folder.missing():
        with counted(trial.people, folder.people_done(), len(trial.cases)) as progress:
            run_here(folder, simulate, progress)
    with stage("Looking for reasons"):
        result = result_of(asked, folder)
    with stage("Drawing"):
        folder.finish(files_of(result))
    return result


def _tell(asked: StressTest, result: StressResult, output: Output, out: Path) -> None:
    from glucoloop.cli.telling import print_json
    from glucoloop.studies.stress.results import summary_of
    from glucoloop.studies.stress.table import stress_table

    if output.json:
        print_json(summary_of(result), {name: str(out / name) for name in (*_FILES, CONFIGURATION)}, ())
        return
    show(stress_table(result))
    for line in verdict(result):
        print(line)
    shards = asked.stress.trial.shards
    print(f"Wrote {', '.join(_FILES)}, {CONFIGURATION} and {shards} {'shard' if shards == 1 else 'shards'} to {out}.")


def verdict(result: StressResult) -> Iterator[str]:
    """For whom, and why, a fault made more than the borne difference with the guard."""
    guarded = [row for row in result.rows if row.tried.guarded and row.tried.fault]
    if not guarded:
        return
    broken = [row for row in guarded if not row.stands]
    yield (
        f"With the guard, in {len(guarded) - len(broken)} of {len(guarded)} cells nobody spends more than 1 % of the "
        "time more below 60 mg/dl than without the fault."
    )
    not_valid = [row for row in result.rows if row.people_below_validity]
    if not_valid:
        most = max(not_valid, key=lambda row: row.people_below_validity)
        yield (
            f"In {len(not_valid)} of {len(result.rows)} cells glucose was lower than the patient's model is valid for, "
            f"at most of {most.people_below_validity} of {most.people} people ({most.tried.label}). Read it as severe "
            "hypoglycemia; its depth means nothing."
        )
    for reason in result.reasons:
        yield f"{reason.tried.label}: person {reason.person}, {reason.more_pct:.1f} % more. {reason.text}"
