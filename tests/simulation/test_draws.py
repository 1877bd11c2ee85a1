"""Controllers that draw random numbers by the key of each sample."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.control.protocol import Decision, Status
from glucoloop.firmware.exported import export
from glucoloop.patients.population import population, virtual_people
from glucoloop.refusal import Refusal

SCENARIO = gl.Scenario([gl.Meal(50.0, 60.0)], 300.0, announced=True)


@pytree
class Guesses:
    """A person who gives the basal rate, and for a meal a rate by a guess of its carbohydrate."""

    basal_mU_min: jax.Array | float
    sample_time_min: ClassVar[float] = 5.0
    draws: ClassVar[bool] = True

    def with_basal(self, insulin_mU_min):
        return Guesses(basal_mU_min=insulin_mU_min)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        guess = 1.0 + 0.3 * jax.random.normal(observation.key, observation.glucose_mg_dl.shape)
        state = jnp.where(observation.announced_carbs_g > 0.0, guess * observation.announced_carbs_g, 0.9 * state)
        rate = self.basal_mU_min * (1.0 + 0.004 * state)
        return state, Decision(insulin_mU_min=rate, status=jnp.full(rate.shape, int(Status.OK)))


@pytest.mark.long
def test_the_same_key_gives_the_same_numbers_and_another_one_others():
    patient = gl.patient()
    controller = Guesses(basal_mU_min=patient.basal_insulin_mU_min)
    runs = [gl.simulate(patient, controller, scenario=SCENARIO, key=key) for key in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0].command_mU_min, runs[1].command_mU_min)
    asked = [float(run.command_mU_min[12]) for run in runs]
    assert abs(asked[0] - asked[2]) > 0.1
    # without noise of the sensor nothing else is drawn
    np.testing.assert_array_equal(runs[0].command_mU_min[:12], runs[2].command_mU_min[:12])


@pytest.mark.long
def test_a_guard_and_a_pace_hand_the_key_on():
    patient = gl.patient()
    controller = Guesses(basal_mU_min=patient.basal_insulin_mU_min)
    guarded = gl.control.guarded(controller, gl.control.GuardSettings(), gl.usual_limits(patient))
    assert guarded.draws  # it holds the first of these doses at 1.2 times the basal rate
    bare, safe = (gl.simulate(patient, c, scenario=SCENARIO, key=3) for c in (controller, guarded))
    np.testing.assert_allclose(safe.command_mU_min[13], bare.command_mU_min[13], rtol=1e-12)
    assert gl.control.paced(controller, 1.0).draws


@pytest.mark.long
@pytest.mark.parametrize("engine", ["native", "xla"])
def test_people_guess_each_for_themselves(engine):
    people = virtual_people(population("parker2000"), 5, np.arange(4))
    found = gl.simulate_people(people, Guesses(basal_mU_min=25.6), scenario=SCENARIO, seed=5, engine=engine)
    alike = gl.simulate_people(people, Guesses(basal_mU_min=25.6), scenario=SCENARIO, seed=5, engine="xla")
    np.testing.assert_allclose(found.insulin_mU_min, alike.insulin_mU_min, rtol=1e-9)
    share = found.insulin_mU_min[12] / people.basal_insulin_mU_min
    assert np.ptp(share) > 0.05
    one = people.at(np.array([2]))
    alone = gl.simulate_people(one, Guesses(basal_mU_min=25.6), scenario=SCENARIO, seed=5, engine=engine)
    np.testing.assert_array_equal(alone.insulin_mU_min[:, 0], found.insulin_mU_min[:, 2])


def test_c_has_no_random_numbers():
    controller = Guesses(basal_mU_min=25.6)
    patient = gl.patient()
    observation = gl.Stepper(patient, sample_time_min=5.0).observation()
    with pytest.raises(Refusal, match=r"^Guesses draws random numbers, which C has not; export one that draws none"):
        export(controller, gl.usual_limits(patient), observation, [])
