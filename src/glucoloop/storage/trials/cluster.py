"""Trial on a Dask cluster: a shard is a task, and its files come back as bytes.

Workers need the same version of glucoloop, but no shared disk with this process, which alone writes to the folder. A
task of a worker that dies is given to another one. The results of a person do not depend on the machine.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import signal
import threading
import uuid
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import Any, Final

import glucoloop
from glucoloop import arithmetic
from glucoloop._extras import needed_for
from glucoloop.cohorts.trial import Trial, fingerprint
from glucoloop.refusal import Refusal
from glucoloop.storage.trials.folder import TrialFolder
from glucoloop.storage.trials.run import Progress
from glucoloop.storage.trials.shard import compute_shard

LOCAL: Final = "local"
RETRIES: Final = 3
"""Number of times that a shard is tried again before the trial stops."""
_IN_FLIGHT_PER_THREAD: Final = 2
_LEAST_IN_FLIGHT: Final = 4
_CONNECT_S: Final = 30
_designing = threading.Lock()


def shard_on_worker(trial: Trial, index: int, version: str, identity: Mapping[str, str]) -> dict[str, bytes]:
    """The files of a shard, computed by a worker.

    Parameters
    ----------
    trial : Trial
    index : int
    version : str
        Version of glucoloop in the process that owns the folder.
    identity : mapping
        Arithmetic of that process, on which the bits depend; see `glucoloop.arithmetic`.

    Raises
    ------
    ValueError
        If the worker has another version of glucoloop, or would compute other bits.
    """
    from glucoloop.cohorts import engine

    if glucoloop.__version__ != version:
        raise Refusal(
            f"a worker has glucoloop {glucoloop.__version__}, and this is {version}; "
            "install the same on all workers and run the same command again"
        )
    other = arithmetic.difference(identity, arithmetic.identity())
    if other is not None:
        name, here, there = other
        raise Refusal(
            f"a worker has {name} {there}, and here it is {here}, which does not give the same bits; "
            "have workers of one kind, with the same libraries and settings, and run the same command again"
        )
    with _designing:  # kept by the process, and made once even where it has several threads
        prepared = engine.prepare(trial)
    return compute_shard(
        trial,
        index,
        lambda label, person, traces: engine.run_people(prepared, label, person, traces=traces, threads=1),
        lambda: None,
    )


@contextlib.contextmanager
def connected(address: str, workers: int | None = None) -> Iterator[Any]:
    """A client of the scheduler at an address, or of one of this machine's own.

    Parameters
    ----------
    address : str
        Address such as ``tcp://10.0.0.1:8786``, or ``"local"`` to start worker processes on this machine.
    workers : int, optional
        Number of worker processes; one for each core by default.

    Raises
    ------
    ValueError
        If Dask is not installed, or no scheduler answers at the address.
    """
    distributed = library()
    with contextlib.ExitStack() as stack:
        if address == LOCAL:
            with _workers_deaf_to_interrupts():
                cluster: Any = stack.enter_context(
                    distributed.LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        dashboard_address="127.0.0.1:0",
                        silence_logs=logging.ERROR,
                    )
                )
        elif workers is not None:
            raise Refusal("the number of workers is the cluster's own; leave it out")
        else:
            cluster = address
        try:
            stack.enter_context(_silent("distributed.client"))
            client = stack.enter_context(distributed.Client(cluster, timeout=_CONNECT_S, set_as_default=False))
        except (OSError, ValueError) as error:
            raise Refusal(
                f"no Dask scheduler answers at {address} ({' '.join(str(error).split())}); "
                "start one, or give its address like tcp://10.0.0.1:8786"
            ) from None
        yield client


def library() -> Any:
    """The library of clusters, asked for before a trial designs its controllers.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    with needed_for("a cluster"):
        return importlib.import_module("distributed")  # untyped


@contextlib.contextmanager
def _silent(logger: str) -> Iterator[None]:
    """Keep a logger from printing tracebacks about a lost scheduler, since the raised error says it."""
    told = logging.getLogger(logger)
    before = told.level
    told.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        told.setLevel(before)


@contextlib.contextmanager
def _workers_deaf_to_interrupts() -> Iterator[None]:
    """Start processes in the block so that Ctrl-C does not reach them; this process stops them itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def run_on_cluster(folder: TrialFolder, client: Any, progress: Progress) -> None:
    """Compute the missing shards on the workers of a cluster, and put them into the folder as they arrive.

    Raises
    ------
    ValueError
        If a shard fails repeatedly, or cannot be written; finished shards stay.
    """
    trial, identity = folder.trial, arithmetic.identity()
    waiting = deque(folder.missing())
    tried: Counter[int] = Counter()
    running: dict[Any, int] = {}
    """Number of the shard of each future."""
    completed = library().as_completed(loop=client.loop)

    def fill() -> None:
        while waiting and len(running) < max(_LEAST_IN_FLIGHT, _IN_FLIGHT_PER_THREAD * sum(client.nthreads().values())):
            index = waiting.popleft()
            tried[index] += 1
            future = client.submit(
                shard_on_worker,
                trial,
                index,
                glucoloop.__version__,
                identity,
                key=f"glucoloop-{fingerprint(trial)[:16]}-{index:05d}-{uuid.uuid4().hex}",
                pure=False,
            )
            running[future] = index
            completed.add(future)

    fill()
    for future in completed:
        index = running.pop(future)
        error = future.exception()
        if error is None:
            folder.put(index, future.result())
            progress(trial.shard(index).size * len(trial.cases))
        elif tried[index] <= RETRIES and not isinstance(error, Refusal):
            waiting.appendleft(index)
        else:
            raise Refusal(
                f"shard {index} failed on the cluster: {' '.join(str(error).split()).rstrip('.')}; "
                f"{folder.done} of {trial.shards} shards are done and kept, run the same command again to go on"
            )
        future.release()
        fill()
