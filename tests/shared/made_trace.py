"""A run written down by hand, without a patient."""

import jax.numpy as jnp
import numpy as np

from glucoloop.simulation import Trace


def trace_of(fine_glucose, insulin=None, *, setpoint=80.0, basal=20.0, meal_sample=10, inside=5, **fields):
    """A run whose glucose on the grid of one minute is given, `inside` points to a sample; people trail."""
    fine = np.asarray(fine_glucose, float)
    samples = (len(fine) - 1) // inside
    assert len(fine) == inside * samples + 1
    people = fine.shape[1:]
    insulin = np.full((samples, *people), basal) if insulin is None else np.asarray(insulin, float)
    carbs_g = np.zeros(samples)
    if meal_sample is not None:
        carbs_g[meal_sample] = 50.0
    values = {
        "t_min": inside * np.arange(samples, dtype=float),
        "glucose_mg_dl": fine[:-1:inside],
        "reading_mg_dl": fine[:-1:inside],
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
