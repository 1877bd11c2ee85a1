"""A patient who digests in states of its own is fed at the rate of eating, against the matrix exponential."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from glucoloop._pytree import pytree
from glucoloop.control import design_open_loop
from glucoloop.meals import Ingestion, Meal, Scenario
from glucoloop.simulation import Adaptive, simulate
from glucoloop.simulation.plant import SampleGrid

# what glucose falls back by, what a compartment of the gut passes on, and how glucose rises by it
RATES = np.array([[-0.02, 0.0, 1.25e-4], [0.0, -0.025, 0.0], [0.0, 0.025, -0.025]])


@pytree
class Digesting:
    """Glucose, and two compartments of a gut that is fed with the rate of eating."""

    meal_model: object = Ingestion()
    basal_insulin_mU_min: object = 20.0
    setpoint_mg_dl: object = 100.0

    def steady_state(self, insulin_mU_min):
        return jnp.array([120.0 - insulin_mU_min, 0.0, 0.0])

    def insulin_for(self, glucose_mg_dl):
        return 120.0 - glucose_mg_dl

    def derivative(self, t_min, x, inputs):
        enters = jnp.stack([0.02 * (120.0 - inputs.insulin_mU_min), inputs.meal_mg_min, jnp.zeros(())])
        return jnp.asarray(RATES) @ x + enters

    def glucose_mg_dl(self, x):
        return x[0]


# beginning and end of eating at samples, within them, and within one another
SCENARIO = Scenario([Meal(30.0, 20.0, 15.0), Meal(12.0, 41.3, 30.4), Meal(20.0, 60.0, 1.0)], 200.0)


def eating_since(z_min):
    """State z minutes after eating began at a rate of 1 mg/min."""
    with_rate = np.zeros((4, 4))
    with_rate[:3, :3], with_rate[1, 3] = RATES, 1.0
    return scipy.linalg.expm(with_rate * max(z_min, 0.0))[:3, 3]


@pytest.mark.long
def test_what_is_eaten_is_digested_by_the_patient():
    patient, grid = Digesting(), SampleGrid(sample_time_min=5.0, samples=40)
    plant, starts = Adaptive(1e-10).prepare(patient, SCENARIO.absorbed_by(patient), grid)
    advance = jax.jit(lambda x, start: plant.advance(x, jnp.asarray(20.0), start))
    _, found = jax.lax.scan(advance, patient.steady_state(20.0), starts)
    truth = [
        100.0
        + sum(
            1000.0 * meal.carbs_g / meal.eating_min * (eating_since(t - meal.t_min) - eating_since(t - end_min))[0]
            for meal in SCENARIO.meals
            for end_min in [meal.t_min + meal.eating_min]
        )
        for t in grid.fine_t_min[1:]
    ]
    assert np.ptp(truth) > 30.0
    np.testing.assert_allclose(np.ravel(found), truth, rtol=0.0, atol=1e-6)


def test_no_other_gut_feeds_a_patient_who_digests():
    scenario = Scenario([Meal(30.0, 20.0)], 100.0, meal_model="hovorka")
    with pytest.raises(ValueError, match="Digesting digests meals in its own states, so no other meal model can feed"):
        simulate(Digesting(), design_open_loop(20.0), scenario=scenario)
