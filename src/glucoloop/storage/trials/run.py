"""Trial in this process: shard after shard, each written while the next is computed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from glucoloop.storage.trials.folder import TrialFolder
from glucoloop.storage.trials.shard import Simulate, compute_shard

Progress = Callable[[int], None]
"""Callback after each controller of a shard, with the number of people simulated."""


def run_here(folder: TrialFolder, simulate: Simulate, progress: Progress) -> None:
    """Compute the shards that are missing and put them into the folder; ValueError if one cannot be written."""
    trial = folder.trial
    with ThreadPoolExecutor(1, thread_name_prefix="writer") as writer:
        writing: Future[None] | None = None
        for index in folder.missing():
            people = trial.shard(index).size
            files = compute_shard(trial, index, simulate, lambda people=people: progress(people))  # type: ignore[misc]
            if writing is not None:
                writing.result()  # one at a time, so that what waits does not pile up
            writing = writer.submit(folder.put, index, files)
        if writing is not None:
            writing.result()
