"""``glucoloop trial``: many virtual people and several controllers, in a folder that can be resumed."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import DASK, MMOL, OUTPUT, SHORT, WORKERS, Given, options_of, reworded
from glucoloop.cli.progress import counted
from glucoloop.cli.request import completed, request_of
from glucoloop.cli.run import PARTS_TOLD
from glucoloop.cli.screen import note, stage
from glucoloop.cli.study import carried_out, needed_folder
from glucoloop.cli.trial_telling import tell
from glucoloop.cohorts.trial import Trial
from glucoloop.printable import how_many
from glucoloop.refusal import Refusal
from glucoloop.situations.doubts import boluses_into_a_vein
from glucoloop.situations.request import asked_for, read_root

if TYPE_CHECKING:
    from glucoloop.storage.trials.folder import TrialFolder
    from glucoloop.storage.trials.shard import Simulate

HELP: Final = (
    "Simulate controllers on a population of virtual people; the results are tables, percentiles over time and a "
    "page.\n\n"
    "The folder holds one row for each person and controller, and is written in parts (shards). After Ctrl-C, a kill "
    "or a full disk, the same command continues where it stopped, and the results are the same to the bit. By default "
    "linear MPC is simulated on 1000 people whose metabolism varies as in Parker et al. (2000), for a day with three "
    "meals.\n\n"
    f"{PARTS_TOLD}\n\n"
    "  glucoloop trial --people 10000 --controller mpc --controller mpc-se --seed 1 --out trial\n\n"
    "  glucoloop trial --days 14 --meal-size-spread 30 --meal-time-spread 45 --noise 1.45 --out fortnight\n\n"
    "  glucoloop trial --controller mpc --controller 'mpc, move_weight=3, label=careful' --out weights\n\n"
    "  glucoloop trial --people 1000000 --precision float32 --dask tcp://10.0.0.1:8786 --out million"
)
_MOST_WORKERS: Final = 4096
_DIGITS: Final = 10
_MOST_LABELS: Final = 5
"""Largest number of cases that are named one by one."""


@dataclass(frozen=True)
class Computing:
    """Place of the computation of a trial, which is no part of the configuration."""

    workers: int | None
    dask: str | None


def computing(typed: Given) -> Computing:
    """The place of the computation."""
    told, dask = typed.get(WORKERS.key), typed.get(DASK.key)
    workers = int(told) if told is not None and told.isascii() and told.isdigit() and len(told) < _DIGITS else None
    if told is not None and (workers is None or not 1 <= workers <= _MOST_WORKERS):
        raise Refusal(f"--workers is {told}; give a whole number from 1 to {_MOST_WORKERS}")
    if dask is not None and dask != "local" and "://" not in dask:
        raise Refusal(f"--dask is {dask!r}; give local, or the address of a scheduler like tcp://10.0.0.1:8786")
    if dask not in (None, "local") and workers is not None:
        raise Refusal(f"--workers is {workers}, but the cluster at {dask} has its own workers; leave it out")
    if dask is not None:
        from glucoloop.storage.trials.cluster import library

        library()  # what is missing is told before anything is designed
    return Computing(workers, dask)


OPTIONS: Final = (
    *reworded(
        options_of(Trial),
        help={
            "patient": "Patient, around whom people vary and for whom controllers are designed.",
            "setpoint_mg_dl": "Glucose at which all people rest at the start, and the target; that of the operating "
            "point by default.",
            "seed": "The same seed gives the same people, meals and noise.",
        },
        rare=dict.fromkeys(
            ("sample_time_min", "design", "traces", "allow_unusual", "meal_size_spread_pct", "meal_time_spread_min"),
            True,
        ),
    ),
    *SHORT,
    WORKERS,
    DASK,
    *reworded(
        (*OUTPUT, MMOL),
        help={
            "out": "Folder of the trial; an unfinished trial in it is resumed.",
            "overwrite": "Begin again and replace the trial in the folder.",
            "json": "Print the summary as one JSON object.",
        },
    ),
)


def _trial(typed: Given) -> None:
    """Check the request, run or resume the trial, and print the results."""
    request, where = request_of(typed, OPTIONS), computing(typed)
    output = request.output
    out = needed_folder(output, "a trial", "trial")
    read_root(Trial, request.tree)
    trial: Trial = completed(request, functools.partial(asked_for, Trial))
    note(boluses_into_a_vein(trial))
    from glucoloop.storage.trials.folder import trial_folder

    began = time.monotonic()
    if output.overwrite:
        _simulator(trial, None)  # what cannot be designed must not cost an earlier trial

    def finish(folder: TrialFolder) -> dict[str, Any]:
        before = folder.people_done()
        if not folder.finished:
            simulate = compute(folder, where)
            from glucoloop.cli.trial_results import results

            with stage("Summing up and drawing"):
                folder.finish(results(folder, simulate))
        computed = trial.people - before
        if computed:
            note([f"{how_many(computed, 'person', 'people')} in {time.monotonic() - began:.1f} s."])
        return folder.summary()

    tell(trial, carried_out(trial_folder(out, trial, overwrite=output.overwrite), finish), output, out)


def compute(folder: TrialFolder, where: Computing) -> Simulate:
    """Compute the shards that are missing; returns the simulator."""
    from glucoloop.cohorts.engine import prepare
    from glucoloop.report.facts import engine_notes

    trial, threads = folder.trial, where.workers if where.dask is None else None
    if folder.missing():
        note([_begun(trial)])
    with stage("Designing controllers"):
        simulate = _simulator(trial, threads)
    note(engine_notes(prepare(trial).engines))
    if not folder.missing():
        return simulate
    if where.dask is None:
        from glucoloop.storage.trials.run import run_here

        with _people_counted(folder) as progress:
            run_here(folder, _simulator(trial, threads, progress), lambda people: None)
    else:
        _compute_on_cluster(folder, where.dask, where.workers)
    return simulate


def _begun(trial: Trial) -> str:
    """Sentence on the work that begins; its first results may take minutes."""
    controllers = {case.controller.called: case.controller for case in trial.cases}
    labels = ", ".join(case.label for case in trial.cases)
    which = labels if len(trial.cases) <= _MOST_LABELS else f"{len(trial.cases)} cases of {', '.join(controllers)}"
    slow = [name for name, controller in controllers.items() if controller.slow]
    told = f"Designing and compiling for {how_many(trial.people, 'person', 'people')} under {which}"
    return f"{told}; a decision of {' and of '.join(slow)} takes long." if slow else f"{told}."


def _simulator(trial: Trial, threads: int | None, done: Callable[[int], None] = lambda people: None) -> Simulate:
    """The engine, with the controllers of a trial designed; `done` gets the number of people after each block."""
    from glucoloop.cohorts import engine

    prepared = engine.prepare(trial)
    return lambda label, person, traces: engine.run_people(
        prepared, label, person, traces=traces, threads=threads, done=done
    )


@contextlib.contextmanager
def _people_counted(folder: TrialFolder) -> Iterator[Callable[[int], None]]:
    """Show the number of finished people; the engine reports people under one controller each."""
    with counted(folder.trial.people, folder.people_done(), "people") as more:
        yield lambda tried: more(tried / len(folder.trial.cases))


def _compute_on_cluster(folder: TrialFolder, address: str, workers: int | None) -> None:
    from glucoloop.storage.trials.cluster import connected, run_on_cluster

    with contextlib.ExitStack() as stack:
        with stage("Connecting to the cluster"):
            client = stack.enter_context(connected(address, workers))
        if not client.nthreads():
            note([f"No worker has come to {address} yet; waiting for one."])
        with _people_counted(folder) as progress:
            run_on_cluster(folder, client, progress)


TRIAL: Final = Command("trial", HELP, OPTIONS, _trial, more="trial")
