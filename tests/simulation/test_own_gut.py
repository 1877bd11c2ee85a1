"""A patient who digests in states of its own is the same patient fed by a meal model with the same gut."""

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.control import design_open_loop
from glucoloop.meals import HovorkaGut, Ingestion, Meal, Scenario
from glucoloop.simulation import Adaptive, simulate

TIME_TO_MAXIMUM_MIN = 40.0


@pytree
class Digesting:
    """Glucose, and two compartments of a gut that is fed with the rate of eating."""

    meal_model: object = Ingestion()
    basal_insulin_mU_min: object = 20.0
    setpoint_mg_dl: object = 100.0

    def steady_state(self, insulin_mU_min):
        return jnp.array([100.0 - (insulin_mU_min - 20.0), 0.0, 0.0])

    def insulin_for(self, glucose_mg_dl):
        return 120.0 - glucose_mg_dl

    def derivative(self, t_min, x, inputs):
        G, D1, D2 = x
        k = 1.0 / TIME_TO_MAXIMUM_MIN
        G_rate = (100.0 - G - inputs.insulin_mU_min + 20.0) / 50.0 + k * D2 / 200.0
        return jnp.stack([G_rate, inputs.meal_mg_min - k * D1, k * (D1 - D2)])

    def glucose_mg_dl(self, x):
        return x[0]


@pytree
class Fed(Digesting):
    """The same glucose, fed with what appears in the blood."""

    meal_model: object = HovorkaGut(time_to_maximum_min=TIME_TO_MAXIMUM_MIN, bioavailability=1.0)

    def derivative(self, t_min, x, inputs):
        k = 1.0 / TIME_TO_MAXIMUM_MIN
        none = jnp.zeros_like(x[0])
        return jnp.stack(
            [(100.0 - x[0] - inputs.insulin_mU_min + 20.0) / 50.0 + inputs.meal_mg_min / 200.0, -k * x[1], none]
        )


# beginning and end of eating at samples, within them, and one meal within another
SCENARIO = Scenario([Meal(30.0, 20.0, 15.0), Meal(12.0, 41.3, 30.4), Meal(20.0, 60.0, 1.0)], 200.0)


def test_a_patient_with_a_gut_of_its_own_needs_no_other():
    traces = [
        simulate(patient, design_open_loop(20.0), scenario=SCENARIO, integrator=Adaptive(1e-10))
        for patient in (Digesting(), Fed())
    ]
    own, fed = (np.asarray(trace.fine_glucose_mg_dl) for trace in traces)
    assert np.ptp(own) > 30.0
    np.testing.assert_allclose(own, fed, rtol=0.0, atol=1e-6)


def test_no_other_gut_feeds_a_patient_who_digests():
    scenario = Scenario([Meal(30.0, 20.0)], 100.0, meal_model="hovorka")
    with pytest.raises(ValueError, match="Digesting digests meals in its own states, so no other meal model can feed"):
        simulate(Digesting(), design_open_loop(20.0), scenario=scenario)
