"""Computation of the shards of a trial, in this process or on a Dask cluster.

On a cluster a shard is a task, and its files come back as bytes. Workers need the same version of glucoloop, but no
shared disk with this process, which alone writes to the folder; where the trial has a store of traces, a worker writes
those of its shards there itself, and returns their size and digest. A task of a worker that dies is given to another
one. The results of a person do not depend on the machine: a worker of another kind of processor is refused, unless the
trial asks for portable arithmetic. Then its loops are rounded alike, and the shard says which processor computed it,
for people and designs, which JAX and SciPy compute, may have other last digits.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import logging
import re
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, Self

import glucoloop
from glucoloop import arithmetic
from glucoloop.component.setting import About, Default, declared_setting
from glucoloop.refusal import Refusal, needed_for
from glucoloop.schema.values import json_value
from glucoloop.text import how_many, one_line
from glucoloop.trials.folder import TrialFolder, traces_stored
from glucoloop.trials.shard import Simulate, compute_shard
from glucoloop.trials.trace_store import StoredTable, TraceStore
from glucoloop.trials.trial import PORTABLE, Trial
from glucoloop.user_file import read_regular

if TYPE_CHECKING:
    from glucoloop.trials.engine import PreparedTrial

_LOCAL: Final = "local"
_NUMBER: Final = declared_setting(
    "--workers", Annotated[int, About("Number of workers.", at_least=1, at_most=4096)], Default(None)
)
_RETRIES: Final = 3
"""Number of times that Dask tries a shard again before the trial stops."""
_IN_FLIGHT_PER_THREAD: Final = 2
_MIN_IN_FLIGHT: Final = 4
_CONNECT_S: Final = 30
_MAX_LABELS: Final = 5
"""Largest number of cases that are named one by one."""
_MAX_LINES: Final = 3
"""Largest number of lines of an error that are repeated whole; JAX adds the traceback of a function of the user."""
_designing = threading.Lock()
_ADDRESS: Final = re.compile(r"[a-z][a-z0-9+.-]*://[^\s/@?#]+(/[\w./-]*)?")
"""Address of a scheduler of Dask, which holds nothing that is secret."""
_ENCRYPTED: Final = ("tls", "wss")
"""Protocols of addresses for which this process needs certificates."""
_CERTIFICATES: Final = tuple(
    f"DASK_DISTRIBUTED__COMM__TLS__{name}" for name in ("CA_FILE", "CLIENT__CERT", "CLIENT__KEY")
)
"""Variables that name the files of the certificates to Dask."""
_FILE: Final = ".json"
"""End of the name of a file of a scheduler."""
_UNREADABLE: Final = re.compile("deserialization|No module named 'glucoloop")
"""Words of Dask where a process of a cluster lacks the library of what it was sent."""
_LARGEST_FILE: Final = 1 << 20


@dataclass(frozen=True)
class Workers:
    """Place of the computation of a trial, which is no part of the configuration: threads here, or a Dask cluster."""

    number: int | None = None
    dask: str | None = None
    """Address of a scheduler, or ``"local"`` for processes of this machine."""

    @classmethod
    def of(cls, number: str | None = None, dask: str | None = None) -> Self:
        """The place that options name; Refusal for one that cannot be used, before anything is designed."""
        workers = None if number is None else _NUMBER.check(_NUMBER.read(number))
        if dask not in (None, _LOCAL):
            dask = _address_in(dask)
        if dask not in (None, _LOCAL) and workers is not None:
            raise Refusal(f"--workers is {workers}, but the cluster at {dask} has its own workers; leave it out")
        if dask is not None:
            _refuse_without_certificates(library(), dask)
        return cls(workers, dask)

    def cluster(self) -> contextlib.AbstractContextManager[Any]:
        """A client of the cluster, or None for threads of this process."""
        return contextlib.nullcontext() if self.dask is None else connected(self.dask, self.number)

    def compute(
        self,
        prepared: PreparedTrial,
        folder: TrialFolder,
        client: Any,
        progress: Callable[[float], None],
        told: Callable[[str], None],
    ) -> None:
        """Compute the missing shards of a folder; `progress` is called with the number of people done since before.

        `told` is called with a sentence on workers of a cluster that are lost.
        """
        from glucoloop.trials.engine import run_people

        def done(people: float) -> None:
            progress(people / len(folder.trial.cases))  # which come once under each controller

        if client is not None:
            run_on_cluster(folder, client, done, told)
            return
        run_here(
            folder,
            lambda label, person, traces: run_people(
                prepared, label, person, traces=traces, threads=self.number, done=done
            ),
        )


def beginning(trial: Trial) -> str:
    """Sentence on the work that begins; its first results may take minutes."""
    controllers = {case.controller.display_name: case.controller for case in trial.cases}
    labels = ", ".join(case.label for case in trial.cases)
    which = labels if len(trial.cases) <= _MAX_LABELS else f"{len(trial.cases)} cases of {', '.join(controllers)}"
    slow = [name for name, controller in controllers.items() if controller.slow]
    begun = f"Designing and compiling for {how_many(trial.people, 'person', 'people')} under {which}"
    return f"{begun}; compiling {' and '.join(slow)} takes up to half a minute." if slow else f"{begun}."


def run_here(folder: TrialFolder, simulate: Simulate) -> None:
    """Compute the shards that are missing in this process, and write each while the next is computed.

    A ValueError tells that one cannot be written.
    """
    with ThreadPoolExecutor(1, thread_name_prefix="writer") as writer:
        writing: Future[None] | None = None
        for index in folder.missing():
            files = compute_shard(folder.trial, index, simulate)
            if writing is not None:
                writing.result()  # one at a time, so that what waits does not pile up
            writing = writer.submit(folder.put, index, files)
        if writing is not None:
            writing.result()


class ComputedShard(NamedTuple):
    """A shard as a worker sends it."""

    files: dict[str, bytes]
    processor: str
    """Kind of processor that computed it."""
    stored: dict[str, StoredTable]
    """Tables that the worker wrote to the store of traces."""


def shard_on_worker(
    trial: Trial, index: int, version: str, identity: Mapping[str, str], store: TraceStore | None = None
) -> ComputedShard:
    """A shard, computed by a worker, which writes its traces to a store if there is one.

    `version` and `identity` are those of glucoloop and of the arithmetic in the process that owns the folder; a
    Refusal tells that the worker has others, and would compute other bits, or what went wrong. It is the only error of
    a worker: one of another class may hold what cannot be sent, or be unknown to the process that it is sent to.
    """
    try:
        return _shard_on_worker(trial, index, version, identity, store)
    except Refusal as error:
        why = str(error)
    except Exception as error:
        summary = traceback.TracebackException(type(error), error, None)
        summary.__notes__ = None  # JAX's, on its own traceback
        lines = "".join(summary.format_exception_only()).strip().splitlines()
        why = one_line(" ... ".join(lines if len(lines) <= _MAX_LINES else (lines[0], lines[-1])))
    raise Refusal(why)


def _shard_on_worker(
    trial: Trial, index: int, version: str, identity: Mapping[str, str], store: TraceStore | None
) -> ComputedShard:
    from glucoloop.trials import engine

    if glucoloop.__version__ != version:
        raise Refusal(
            f"a worker has glucoloop {glucoloop.__version__}, and this is {version}; "
            "install the same on all workers and run the same command again"
        )
    own = arithmetic.identity()
    processor = own[arithmetic.PROCESSOR]
    if trial.arithmetic == PORTABLE:
        own = {**own, arithmetic.PROCESSOR: identity[arithmetic.PROCESSOR]}
    other = arithmetic.difference(identity, own)
    if other is not None:
        name, ours, theirs = other
        begin_again = ", or begin another folder with --arithmetic portable" if name == arithmetic.PROCESSOR else ""
        raise Refusal(
            f"a worker has {name} {theirs}, and here it is {ours}, which does not give the same bits; have workers of "
            f"one kind, with the same libraries and settings, and run the same command again{begin_again}"
        )
    with _designing:  # kept by the process, and made once even where it has several threads
        prepared = engine.prepare(trial)
    files = compute_shard(
        trial,
        index,
        lambda label, person, traces: engine.run_people(prepared, label, person, traces=traces, threads=1),
    )
    kept, stored = traces_stored(store, trial, index, files)
    return ComputedShard(kept, processor, stored)


@contextlib.contextmanager
def connected(address: str, workers: int | None = None) -> Iterator[Any]:
    """A client of the scheduler at an address, or of one of this machine's own.

    The address is like ``tcp://10.0.0.1:8786``, or the file, ending in .json, that the scheduler wrote of itself, or
    ``"local"`` to start `workers` processes on this machine, one for each core by default. A ValueError tells that Dask
    is not installed, that there are no certificates for an address like ``tls://10.0.0.1:8786``, or that no scheduler
    answers.
    """
    distributed = library()
    options: dict[str, Any]
    if address == _LOCAL:
        options = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
        options["silence_logs"] = logging.ERROR
    elif workers is not None:
        raise Refusal("the number of workers is the cluster's own; leave it out")
    else:
        options = {"address": _address_in(address)}
        _refuse_without_certificates(distributed, options["address"])
    logger = logging.getLogger("distributed.client")
    with contextlib.ExitStack() as stack:
        stack.callback(logger.setLevel, logger.level)
        logger.setLevel(logging.CRITICAL)  # it would print a traceback of a lost scheduler, which the error tells
        try:
            with _ignoring_interrupts() if address == _LOCAL else contextlib.nullcontext():
                client = distributed.Client(**options, timeout=_CONNECT_S, set_as_default=False)
            stack.enter_context(client)
        except (OSError, ValueError) as error:
            raise Refusal(
                f"no Dask scheduler answers at {address} ({one_line(error)}); "
                "start one, or give its address like tcp://10.0.0.1:8786, or tls:// if it has certificates"
            ) from None
        yield client


def _address_in(text: str) -> str:
    """The address of a scheduler, or that in a file of one.

    What is none is refused without a word of it: it may hold a name and a password.
    """
    if text.endswith(_FILE):
        try:
            text = str(json_value(read_regular(Path(text), _LARGEST_FILE))["address"])
        except (ValueError, KeyError, TypeError, FileNotFoundError):
            raise Refusal(
                f"{text} is no file of a Dask scheduler; have it written by: dask scheduler --scheduler-file {text}"
            ) from None
    if not _ADDRESS.fullmatch(text):
        raise Refusal(
            "what is given for Dask is no address of a scheduler; give local, an address like tcp://10.0.0.1:8786 "
            "without a name or a password, or the file of a scheduler, whose name ends in .json"
        )
    return text


def _refuse_without_certificates(distributed: Any, address: str) -> None:
    """Refuse an encrypted address for which Dask's configuration has no certificates, or some that cannot be read.

    Dask itself would raise a TypeError, after the controllers are designed.
    """
    security = distributed.Security()
    if address.partition("://")[0] not in _ENCRYPTED:
        if security.require_encryption and address != _LOCAL:
            raise Refusal(
                f"Dask's configuration requires encryption, and {address} is an address without it; "
                "give that of a scheduler with certificates, like tls://10.0.0.1:8786"
            )
        return
    names = f"{', '.join(_CERTIFICATES[:-1])} and {_CERTIFICATES[-1]}"
    remedy = f"have the variables {names} name files in the form PEM"
    try:
        context = security.get_connection_args("client")["ssl_context"]
    except OSError as error:  # that of a file without a certificate is one too
        parts = (security.get_tls_config_for_role("client").get(name) for name in ("ca_file", "cert", "key"))
        files = dict.fromkeys(part for part in parts if part and "\n" not in part)  # others are no names, but keys
        raise Refusal(
            f"the certificates for {address} cannot be read from {', '.join(files)} ({one_line(error)}); {remedy}"
        ) from None
    if context is None:
        raise Refusal(f"{address} asks for certificates, and Dask's configuration names none; {remedy}")


def library() -> Any:
    """The library of clusters; a `MissingExtraError` tells that it is not installed, before a trial is designed."""
    with needed_for("a cluster"):
        return importlib.import_module("distributed")  # untyped


@contextlib.contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Start processes in the block that Ctrl-C does not reach; this process stops them itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def run_on_cluster(
    folder: TrialFolder,
    client: Any,
    progress: Callable[[int], None],
    told: Callable[[str], None] = lambda sentence: None,
) -> None:
    """Compute the missing shards on the workers of a cluster, and put them into the folder as they arrive.

    `progress` is called with the number of people simulated since the last call, under each controller, and `told` with
    a sentence on workers that are lost.
    A ValueError tells that a shard fails repeatedly, or cannot be written; finished shards stay.
    """
    trial, identity = folder.trial, arithmetic.identity()
    waiting = iter(folder.missing())
    running: dict[Any, int] = {}
    """Number of the shard of each future."""
    completed = library().as_completed(loop=client.loop)
    known = set[str]()

    def fill() -> None:
        workers = client.nthreads()
        if lost := known - set(workers):
            left = f"{len(workers)} {'is' if len(workers) == 1 else 'are'} left, and others may come"
            told(f"{how_many(len(lost), 'worker was', 'workers were')} lost; {left}.")
        known.clear()
        known.update(workers)
        most = max(_MIN_IN_FLIGHT, _IN_FLIGHT_PER_THREAD * sum(workers.values()))
        for index in itertools.islice(waiting, max(0, most - len(running))):
            work = shard_on_worker, trial, index, glucoloop.__version__, identity, folder.store
            future = client.submit(*work, pure=False, retries=_RETRIES)
            running[future] = index
            completed.add(future)

    fill()
    for future in completed:
        index = running.pop(future)
        error = future.exception()
        if error is not None:
            why = one_line(error)
            if _UNREADABLE.search(why):
                why = (
                    "the scheduler or a worker cannot read what it was sent; install the same glucoloop for all of them"
                )
            raise Refusal(
                f"shard {index} failed on the cluster: {why}; "
                f"{folder.done} of {trial.shards} shards are done and kept, run the same command again to go on"
            )
        computed: ComputedShard = future.result()
        folder.put(index, computed.files, computed.processor, computed.stored)
        progress(trial.shard(index).size * len(trial.cases))
        future.release()
        fill()
