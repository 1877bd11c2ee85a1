"""A study whose numbers are known: glucose that is written down, run by run."""

import numpy as np
import pytest

from glucoloop.papers.meal_aware.experiments import ComparisonRuns, ControllerRuns
from glucoloop.papers.meal_aware.measures import MEASURES, numbers_at_samples, numbers_of
from glucoloop.papers.meal_aware.mismatched_loops import MismatchRuns
from glucoloop.papers.meal_aware.mismatches import MISMATCHES
from glucoloop.papers.meal_aware.situations import CONTROLLERS, SITUATIONS, read_asked

SETPOINT = 81.1
T_MIN = np.arange(601.0)


def written(undershoots, *, late=None, variation=100.0, quiet=None):
    """Loops whose glucose dips once, at 200 min, by so many mg/dl, run by run."""
    dip = np.exp(-(((T_MIN - 200.0) / 40.0) ** 2))
    glucose = SETPOINT - dip[:, None] * np.asarray(undershoots, float)
    if late is not None:
        glucose[400:] += late[:, None]
    runs = glucose.shape[1]
    metrics = {measure.name: np.zeros(runs) for measure in MEASURES}
    metrics |= {
        "undershoot_mg_dl": SETPOINT - glucose.min(axis=0),
        "overshoot_mg_dl": glucose.max(axis=0) - SETPOINT,
        "minimum_mg_dl": glucose.min(axis=0),
        "insulin_total_variation_mU_min": np.full(runs, variation),
    }
    return ControllerRuns(
        run=np.arange(1, runs + 1),
        numbers=numbers_of(metrics, T_MIN, glucose, SETPOINT),
        t_min=T_MIN,
        glucose_mg_dl=glucose,
        insulin_t_min=T_MIN[:-1:5],
        insulin_mU_min=np.full((120, runs), 25.6),
        setpoint_mg_dl=SETPOINT,
        quiet=quiet,
    )


@pytest.fixture(scope="session")
def study_of():
    """Make a study of a few situations; each controller's loops are those of the meal-aware one unless given."""

    def make(situations, others=None, rows=None, **keys):
        loops = {
            name: {one: ((others or {}).get(one) or own) for one in CONTROLLERS} for name, own in situations.items()
        }
        asked = read_asked({"seeds": 3, "people": 3, **keys})
        return ComparisonRuns(
            asked=asked,
            loops=loops,
            situations=tuple(one for one in SITUATIONS if one.name in situations),
            bounds={},
            step_ms={"meal-mpc": 0.5},
            rows=tuple(row for row in MISMATCHES if row.name in (rows or {})),
            of_rows={name: dict.fromkeys(CONTROLLERS, own) for name, own in (rows or {}).items()},
        )

    return make


@pytest.fixture(scope="session")
def at_samples():
    """Make runs in which the model is wrong: glucose is at 81 mg/dl, and lower by so many mg/dl at some samples."""

    def make(undershoots, *, samples=1):
        glucose = np.full((121, len(undershoots)), 81.0)
        glucose[20 : 20 + samples] -= undershoots
        numbers = numbers_at_samples(glucose, np.full((120, len(undershoots)), 25.6), 81.0, 5.0)
        return MismatchRuns(run=np.arange(len(undershoots)), numbers=numbers, infeasible=0)

    return make


@pytest.fixture(name="written", scope="session")
def _written():
    return written
