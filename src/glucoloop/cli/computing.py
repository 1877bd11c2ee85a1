"""The computation of a trial: on this computer or on a cluster, with its progress."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from glucoloop.cli.option import DASK, WORKERS, Given
from glucoloop.cli.progress import counted
from glucoloop.cli.screen import note, stage
from glucoloop.printable import how_many
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.cohorts.trial import Trial
    from glucoloop.storage.trials.folder import TrialFolder
    from glucoloop.storage.trials.shard import Simulate

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
    given, dask = typed.get(WORKERS.key), typed.get(DASK.key)
    workers = int(given) if given is not None and given.isascii() and given.isdigit() and len(given) < _DIGITS else None
    if given is not None and (workers is None or not 1 <= workers <= _MOST_WORKERS):
        raise Refusal(f"--workers is {given}; give a whole number from 1 to {_MOST_WORKERS}")
    if dask is not None and dask != "local" and "://" not in dask:
        raise Refusal(f"--dask is {dask!r}; give local, or the address of a scheduler like tcp://10.0.0.1:8786")
    if dask not in (None, "local") and workers is not None:
        raise Refusal(f"--workers is {workers}, but the cluster at {dask} has its own workers; leave it out")
    if dask is not None:
        from glucoloop.storage.trials.cluster import library

        library()  # what is missing is told before anything is designed
    return Computing(workers, dask)


def compute(folder: TrialFolder, where: Computing) -> None:
    """Design the controllers, and compute the shards that are missing."""
    from glucoloop.cohorts.engine import prepare
    from glucoloop.report.descriptions import engine_notes

    trial, threads = folder.trial, where.workers if where.dask is None else None
    if folder.missing():
        note([_begun(trial)])
    with stage("Designing controllers"):
        prepare(trial)
    note(engine_notes(prepare(trial).engines))
    if not folder.missing():
        return
    if where.dask is None:
        from glucoloop.storage.trials.run import run_here

        with _people_counted(folder) as progress:
            run_here(folder, _simulator(trial, threads, progress), lambda people: None)
    else:
        _compute_on_cluster(folder, where.dask, where.workers)


def _begun(trial: Trial) -> str:
    """Sentence on the work that begins; its first results may take minutes."""
    controllers = {case.controller.called: case.controller for case in trial.cases}
    labels = ", ".join(case.label for case in trial.cases)
    which = labels if len(trial.cases) <= _MOST_LABELS else f"{len(trial.cases)} cases of {', '.join(controllers)}"
    slow = [name for name, controller in controllers.items() if controller.slow]
    begun = f"Designing and compiling for {how_many(trial.people, 'person', 'people')} under {which}"
    return f"{begun}; a decision of {' and of '.join(slow)} takes long." if slow else f"{begun}."


def _simulator(trial: Trial, threads: int | None, done: Callable[[int], None]) -> Simulate:
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
