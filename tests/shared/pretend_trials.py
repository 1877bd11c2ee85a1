"""A trial without a simulator: what becomes of a person is a formula of his random numbers."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from glucoloop.metrics.metric import default_results
from glucoloop.patients.population import draw
from glucoloop.situations.situation import configured
from glucoloop.threefry import uniforms
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.shard import compute_shard, edges
from glucoloop.trials.trial import Trial

METRIC_NAMES = [result.name for result in default_results()]


def pretend(trial):
    """What `engine.run_people` would say, made up; one person in a hundred is not feasible."""
    bins = edges(trial)

    def count(values, quantity):
        low = bins[quantity]
        number = np.clip(np.searchsorted(low, values, "right") - 1, 0, low.size - 2)
        return np.stack([np.bincount(row, minlength=low.size - 1) for row in number]).astype(np.int64)

    def simulate(label, person, traces):
        drawn = uniforms(trial.seed, f"pretend {label}", person)
        luck = uniforms(trial.seed, "luck", person)
        feasible = luck > 0.01
        missing = np.where(feasible, 0.0, np.nan)
        t_min = trial.sample_time_min * np.arange(trial.samples + 1)[:, None]
        glucose = (81.1 + 60.0 * drawn * np.sin(t_min / 90.0)).astype(np.float32)
        insulin = np.maximum(20.0 + 30.0 * drawn * np.cos(t_min[:-1] / 90.0), 0.0).astype(np.float32)
        metrics = {}
        for number, name in enumerate(METRIC_NAMES):
            if name.startswith("settled") or name.endswith("satisfied"):
                metrics[name] = drawn > 0.3
            elif name.startswith("samples"):
                metrics[name] = (10 * luck).astype(np.int64)
            else:
                metrics[name] = (number + 1) * drawn + missing
        minimum = glucose.min(axis=0).astype(float) + missing
        metrics |= {
            "minimum_mg_dl": minimum,
            "peak_mg_dl": glucose.max(axis=0).astype(float) + missing,
            "undershoot_mg_dl": 81.1 - minimum,
            "time_below_60_pct": np.where(minimum < 60.0, 5.0 * drawn, 0.0) + missing,
        }
        return SimpleNamespace(
            person=person,
            feasible=feasible,
            profile={},
            drawn=dict(draw(trial.population, trial.seed, person).values),
            basal_insulin_mU_min=15.0 + 60.0 * luck + missing,
            metrics=metrics,
            glucose_counts=count(glucose[:, feasible], "glucose"),
            insulin_counts=count(insulin[:, feasible], "insulin"),
            week_counts=np.zeros((0, 600), np.int64),
            glucose_mg_dl=glucose if traces else None,
            insulin_mU_min=insulin if traces else None,
        )

    return simulate


@pytest.fixture(name="pretend")
def _pretend():
    return pretend


def make_trial(**keys):
    keys = {"people": 300, "seed": 4, "duration_min": 300.0, "meals": ["50g@50min"], "shard_people": 64, **keys}
    return configured(Trial, {"controller": ["mpc", "pid"], **keys})


@pytest.fixture(name="make_trial")
def _make_trial():
    """A trial of 300 people under two controllers in shards of 64, or another one."""
    return make_trial


@dataclasses.dataclass(frozen=True)
class Tiny:
    """A trial of some shards of one person, whose contents are there already."""

    trial: Trial
    shards: list[dict[str, bytes]]

    final: ClassVar = {"summary.json": b"{}", "report.html": b"<html>"}

    def run(self, path: Path, *, overwrite: bool = False) -> None:
        """What a command does, without computing anything."""
        with trial_folder(path, self.trial, overwrite=overwrite) as folder:
            if folder.finished:
                return
            for index in folder.missing():
                folder.put(index, self.shards[index])
            folder.finish(self.final)


def tiny(shards, **keys):
    keys = {"controller": ["basal"], "people": shards, "shard_people": 1, "duration_min": 30.0, "meals": [], **keys}
    trial = make_trial(**keys)
    return Tiny(trial, [compute_shard(trial, index, pretend(trial)) for index in range(shards)])


@pytest.fixture(scope="session", name="tiny")
def _tiny():
    """A small trial, and another one of another seed and size."""
    return tiny(2), tiny(3, seed=5)
