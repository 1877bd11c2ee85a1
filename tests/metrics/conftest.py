"""Runs written down by hand, without a patient."""

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.simulation import Trace


def _trace(fine_glucose, insulin=None, *, setpoint=80.0, basal=20.0, meal_sample=10, **fields):
    fine = np.asarray(fine_glucose, float)
    samples = (len(fine) - 1) // 5
    assert len(fine) == 5 * samples + 1
    people = fine.shape[1:]
    insulin = np.full((samples, *people), basal) if insulin is None else np.asarray(insulin, float)
    carbs_g = np.zeros(samples)
    if meal_sample is not None:
        carbs_g[meal_sample] = 50.0
    values = {
        "t_min": 5.0 * np.arange(samples),
        "glucose_mg_dl": fine[:-1:5],
        "reading_mg_dl": fine[:-1:5],
        "reading_valid": np.ones((samples, *people), bool),
        "command_mU_min": insulin,
        "insulin_mU_min": insulin,
        "reported_mU_min": insulin,
        "status": np.zeros((samples, *people), int),
        "carbs_g": carbs_g,
        "states": np.zeros((samples + 1, 1, *people)),
        "fine_t_min": np.arange(len(fine), dtype=float),
        "fine_glucose_mg_dl": fine,
        "setpoint_mg_dl": np.full(people, setpoint),
        "basal_insulin_mU_min": np.full(people, basal),
        "lowest_valid_mg_dl": np.full(people, 40.0),
    }
    return Trace(**{name: jnp.asarray(value) for name, value in (values | fields).items()})


@pytest.fixture(scope="session")
def make_trace():
    """A run of 5-min samples whose glucose on the grid of one minute is given; people trail."""
    return _trace
