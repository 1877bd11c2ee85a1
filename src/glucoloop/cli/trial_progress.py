"""The computation of a trial: on this computer or on a cluster, with its progress."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

from glucoloop.cli.option import DASK, WORKERS, Given
from glucoloop.cli.progress import counted
from glucoloop.cli.screen import note, stage
from glucoloop.component.setting import About, Default, declared_setting
from glucoloop.refusal import Refusal
from glucoloop.text import how_many

if TYPE_CHECKING:
    from glucoloop.trials.folder import TrialFolder
    from glucoloop.trials.trial import Trial

_NUMBER: Final = declared_setting(
    WORKERS.flag, Annotated[int, About("Number of workers.", at_least=1, at_most=4096)], Default(None)
)
_MAX_LABELS: Final = 5
"""Largest number of cases that are named one by one."""


@dataclass(frozen=True)
class Computing:
    """Place of the computation of a trial, which is no part of the configuration."""

    workers: int | None
    dask: str | None

    @classmethod
    def of(cls, typed: Given) -> Computing:
        """The place that is given."""
        given, dask = typed.get(WORKERS.key), typed.get(DASK.key)
        workers = None if given is None else _NUMBER.check(_NUMBER.read(given))
        if dask is not None and dask != "local" and "://" not in dask:
            raise Refusal(f"--dask is {dask!r}; give local, or the address of a scheduler like tcp://10.0.0.1:8786")
        if dask not in (None, "local") and workers is not None:
            raise Refusal(f"--workers is {workers}, but the cluster at {dask} has its own workers; leave it out")
        if dask is not None:
            from glucoloop.trials.computing import library

            library()  # what is missing is told before anything is designed
        return cls(workers, dask)

    def compute(self, folder: TrialFolder) -> None:
        """Design the controllers, and compute the shards that are missing."""
        from glucoloop.reporting.descriptions import engine_notes
        from glucoloop.trials.engine import prepare, run_people

        missing = folder.missing()
        if missing:
            note([_begun(folder.trial)])
        with stage("Designing controllers"):
            prepared = prepare(folder.trial)
        note(engine_notes(prepared.engines))
        if not missing:
            return
        from glucoloop.trials.computing import connected, run_here, run_on_cluster

        with contextlib.ExitStack() as stack:
            client = None
            if self.dask is not None:
                with stage("Connecting to the cluster"):
                    client = stack.enter_context(connected(self.dask, self.workers))
                if not client.nthreads():
                    note([f"No worker has come to {self.dask} yet; waiting for one."])
            more = stack.enter_context(counted(folder.trial.people, folder.people_done(), "people"))

            def done(people: float) -> None:
                more(people / len(folder.trial.cases))  # which come once under each controller

            if client is not None:
                run_on_cluster(folder, client, done)
                return
            run_here(
                folder,
                lambda label, person, traces: run_people(
                    prepared, label, person, traces=traces, threads=self.workers, done=done
                ),
            )


def _begun(trial: Trial) -> str:
    """Sentence on the work that begins; its first results may take minutes."""
    controllers = {case.controller.called: case.controller for case in trial.cases}
    labels = ", ".join(case.label for case in trial.cases)
    which = labels if len(trial.cases) <= _MAX_LABELS else f"{len(trial.cases)} cases of {', '.join(controllers)}"
    slow = [name for name, controller in controllers.items() if controller.slow]
    begun = f"Designing and compiling for {how_many(trial.people, 'person', 'people')} under {which}"
    return f"{begun}; compiling {' and '.join(slow)} takes up to a minute." if slow else f"{begun}."
