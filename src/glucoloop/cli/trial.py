"""``glucoloop trial``: many virtual people and several controllers, in a folder that can be resumed."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import Given, names, with_options
from glucoloop.cli.request import Output, file_keys, split_off_output, with_lists
from glucoloop.cli.screen import note, stage
from glucoloop.cli.trial_options import DASK, TRIAL, WORKERS
from glucoloop.cli.trial_progress import counted
from glucoloop.cli.trial_telling import tell

if TYPE_CHECKING:
    from glucoloop.cohorts.trial import Trial
    from glucoloop.storage.trials.folder import TrialFolder
    from glucoloop.storage.trials.shard import Simulate

HELP: Final = (
    "Try controllers on a population of virtual people: tables, bands, and a page with a picture of all.\n\n"
    "The folder holds one row per person and controller. It grows shard by shard; after Ctrl-C, a kill or a full disk "
    "the same command goes on where it was, to the same bits. Without options it is linear MPC on 1000 people whose "
    "metabolism varies as in Parker et al. (2000), for a day with three meals.\n\n"
    "A case is written as in `glucoloop compare`; settings given beside the cases hold for every case that has them "
    "and does not say otherwise.\n\n"
    "  glucoloop trial --people 10000 --controller mpc --controller mpc-se --seed 1 --out trial\n\n"
    "  glucoloop trial --days 14 --meal-size-spread 30 --meal-time-spread 45 --noise 1.45 --out fortnight\n\n"
    "  glucoloop trial --case mpc --case 'careful: mpc, move_weight=3' --out weights\n\n"
    "  glucoloop trial --people 1000000 --precision float32 --dask tcp://10.0.0.1:8786 --out million"
)
_MOST_WORKERS: Final = 4096


@dataclass(frozen=True)
class _Work:
    """Way of computing a trial: threads, workers or a cluster."""

    workers: int | None
    dask: str | None


@with_options(TRIAL)
def command(given: Given) -> None:
    """Check the request, run or resume the trial, and print it."""
    keys, output, file = split_off_output(given)
    work = _work(keys)
    texts = with_lists(keys), file_keys(file)
    if output.out is None:
        raise ValueError("--out is missing; a trial is kept in a folder, name one like --out trial")
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled

        trial = _read(*texts)
    keep_compiled()
    _carry_out(trial, output, output.out, work)


def _work(keys: Given) -> _Work:
    """Way of computing, which is not part of the configuration."""
    workers, dask = keys.pop(WORKERS.key, None), keys.pop(DASK.key, None)
    if workers is not None and not 1 <= workers <= _MOST_WORKERS:
        raise ValueError(f"--workers is {workers}; give a whole number from 1 to {_MOST_WORKERS}")
    if dask is not None and dask != "local" and "://" not in dask:
        raise ValueError(f"--dask is {dask!r}; give local, or the address of a scheduler like tcp://10.0.0.1:8786")
    if dask not in (None, "local") and workers is not None:
        raise ValueError(f"--workers is {workers}, but the cluster at {dask} has its own workers; leave it out")
    return _Work(workers, dask)


def _read(keys: Given, of_file: Given) -> Trial:
    from glucoloop.config.cases import take_cases
    from glucoloop.config.trial import overlay_trial, read_trial

    cases = take_cases(keys, of_file)
    called = names(TRIAL, keys)
    return read_trial(overlay_trial(of_file, keys, called), cases, called)


def _carry_out(trial: Trial, output: Output, out: Path, work: _Work) -> None:
    from glucoloop.storage.trials.folder import trial_folder

    folder: TrialFolder | None = None
    began = time.monotonic()
    if output.overwrite:
        _simulator(trial, None)  # what cannot be designed must not cost an earlier trial
    try:
        with trial_folder(out, trial, overwrite=output.overwrite) as folder:
            note(_before(folder))
            before = folder.people_done()
            if not folder.finished:
                _compute(folder, work)
            computed = trial.people - before
            if computed:
                note([f"{computed} people in {time.monotonic() - began:.1f} s."])
            summary = folder.summary()
    except KeyboardInterrupt:
        if folder is None:
            raise
        interrupted(f"interrupted; {folder.done} of {trial.shards} shards are done, the same command goes on")
    tell(trial, summary, output, out)


def _before(folder: TrialFolder) -> Iterator[str]:
    yield from folder.notes
    if folder.finished:
        yield f"{folder.path} was finished before; nothing is computed again."
    elif folder.done:
        yield f"{folder.done} of {folder.trial.shards} shards of {folder.path} are done already; going on."


def _compute(folder: TrialFolder, work: _Work) -> None:
    trial = folder.trial
    with stage("Designing controllers"):
        simulate = _simulator(trial, work.workers if work.dask is None else None)
    if folder.missing():
        if work.dask is None:
            from glucoloop.storage.trials.run import run_here

            with counted(trial.people, folder.people_done(), len(trial.cases)) as progress:
                run_here(folder, simulate, progress)
        else:
            _compute_on_cluster(folder, work.dask, work.workers)
    from glucoloop.cli.trial_results import results

    with stage("Summing up and drawing"):
        files = results(folder, simulate)
        folder.finish(files)


def _simulator(trial: Trial, threads: int | None) -> Simulate:
    """Function that simulates people, with the controllers of the trial designed."""
    from glucoloop.cohorts import engine

    prepared = engine.prepare(trial)
    return lambda label, person, traces: engine.run_people(prepared, label, person, traces=traces, threads=threads)


def _compute_on_cluster(folder: TrialFolder, address: str, workers: int | None) -> None:
    from glucoloop.storage.trials.cluster import connected, run_on_cluster

    with contextlib.ExitStack() as stack:
        with stage("Connecting to the cluster"):
            client = stack.enter_context(connected(address, workers))
        if not client.nthreads():
            note([f"No worker has come to {address} yet; waiting for one."])
        with counted(folder.trial.people, folder.people_done(), len(folder.trial.cases)) as progress:
            run_on_cluster(folder, client, progress)
