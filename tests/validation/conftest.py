"""Runs whose numbers are known: glucose that is written down, run by run."""

import numpy as np
import pytest

from meal_aware.claims import judged
from meal_aware.measures import Runs, numbers_at_samples, numbers_by_minute
from meal_aware.situations import CONTROLLERS

SETPOINT = 81.1
T_MIN = np.arange(601.0)


@pytest.fixture(name="written", scope="session")
def _written():
    """Make runs whose glucose dips once, at 200 min, by so many mg/dl, run by run."""

    def make(undershoots, *, late=None, variation=100.0, quiet=None):
        dip = np.exp(-(((T_MIN - 200.0) / 40.0) ** 2))
        glucose = SETPOINT - dip[:, None] * np.asarray(undershoots, float)
        if late is not None:
            glucose[400:] += late[:, None]
        runs = glucose.shape[1]
        metrics = {
            "undershoot_mg_dl": SETPOINT - glucose.min(axis=0),
            "overshoot_mg_dl": glucose.max(axis=0) - SETPOINT,
            "minimum_mg_dl": glucose.min(axis=0),
            "insulin_total_variation_mU_min": np.full(runs, variation),
        }
        numbers = numbers_by_minute(metrics, T_MIN, glucose, SETPOINT)
        crossings, turns = (np.nan, np.nan) if quiet is None else quiet
        numbers |= {"quiet_crossings": np.asarray([crossings]), "quiet_turns": np.asarray([turns])}
        return Runs(run=np.arange(1, runs + 1), numbers=numbers)

    return make


@pytest.fixture(scope="session")
def at_samples():
    """Make runs in which the model is wrong: glucose is at 81 mg/dl, and lower by so many mg/dl at some samples."""

    def make(undershoots, *, samples=1):
        glucose = np.full((121, len(undershoots)), 81.0)
        glucose[20 : 20 + samples] -= undershoots
        numbers = numbers_at_samples(glucose, np.full((120, len(undershoots)), 25.6), 81.0, 5.0)
        return Runs(run=np.arange(len(undershoots)), numbers=numbers)

    return make


@pytest.fixture(scope="session")
def found_of():
    """Judge the claims about a few situations; each controller's runs are those of the meal-aware one unless given."""

    def make(situations, others=None):
        runs = {name: {one: (others or {}).get(one) or own for one in CONTROLLERS} for name, own in situations.items()}
        return {row.claim.id: row for row in judged(runs)}

    return make
