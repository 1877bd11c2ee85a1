"""Linear MPC whose model goes on after its memory by a small linear system."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import MPCTuning, design_linear_mpc
from glucoloop.identification import laguerre_functions, laguerre_realisation
from glucoloop.models.state_space import step_response
from glucoloop.models.step_response import Realisation, StepResponseModel
from glucoloop.patients import patient
from glucoloop.simulation import linear_model
from mpc_rows import IMPULSE, WIDE, follow, observe

POLE = 0.98
COEFFICIENTS = np.array([-0.9, 0.3, -0.2, 0.1])


def of_functions(memory):
    """Model of four slow Laguerre functions over a memory that they outlast, and the same one kept whole."""
    h = COEFFICIENTS @ np.asarray(laguerre_functions(POLE, 4, 2000))
    realisation = laguerre_realisation(COEFFICIENTS, POLE, memory)
    return (
        StepResponseModel.from_impulse_response(h[:memory], 5.0, realisation=realisation),
        StepResponseModel.from_impulse_response(h, 5.0),
    )


@pytest.mark.long
def test_the_states_of_a_realisation_forecast_as_the_convolution_does():
    tuning, rng = MPCTuning(2, 20, 1.0, 3.0), np.random.default_rng(1)
    readings = 81.1 + np.cumsum(rng.normal(0.0, 5.0, 400))
    doses, _, state = follow(design_linear_mpc(of_functions(100)[0], tuning), readings, np.ones(400, bool), 25.0)
    free = np.asarray(state.free_response)
    assert free.shape == (400, 21)
    moves = np.diff(np.r_[25.0, np.asarray(doses)])
    h = COEFFICIENTS @ np.asarray(laguerre_functions(POLE, 4, 500))
    answer = np.cumsum(h)
    for k in (10, 150, 399):  # before the memory is full, and long after
        expected = [answer[i + np.arange(k)] @ moves[k - 1 :: -1] for i in range(21)]
        np.testing.assert_allclose(free[k], expected, rtol=1e-10, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("late", [0, 3, 40])
def test_a_realisation_is_the_same_as_a_response_that_never_ends(late):
    tuning = MPCTuning(2, 20 + late, 1.0, 3.0)
    readings = jnp.asarray(81.1 + 40.0 * np.exp(-((np.arange(200) - 20.0) ** 2) / 200.0))
    short, endless = (
        follow(design_linear_mpc(model.delayed(late), tuning, WIDE), readings, jnp.ones(200, bool), 500.0)[0]
        for model in of_functions(100)
    )
    np.testing.assert_allclose(short, endless, rtol=1e-9)


def test_a_realisation_that_begins_late_keeps_what_comes_before():
    readings = jnp.asarray(81.1 + 40.0 * np.exp(-((np.arange(200) - 20.0) ** 2) / 200.0))
    later = Realisation(transition=np.array([[0.97]]), start=IMPULSE[-1:] * 0.97, output=np.ones(1), after=36)
    whole = np.r_[IMPULSE, IMPULSE[-1] * 0.97 ** np.arange(1, 600)]
    kept, endless = (
        follow(design_linear_mpc(model, MPCTuning(2, 20, 1.0, 3.0), WIDE), readings, jnp.ones(200, bool), 500.0)
        for model in (
            StepResponseModel.from_impulse_response(IMPULSE, 5.0, realisation=later),
            StepResponseModel.from_impulse_response(whole, 5.0),
        )
    )
    assert kept[2].free_response.shape[1] == 36
    np.testing.assert_allclose(kept[0], endless[0], rtol=1e-9)


@pytest.mark.long
def test_a_realisation_makes_room_for_a_longer_horizon():
    model, tuning = of_functions(100)[0], MPCTuning(2, 10, 1.0, 3.0)
    short, long = (design_linear_mpc(model, dataclasses.replace(tuning, prediction_horizon=p)) for p in (10, 30))
    padded = short.padded(2, 30)
    for found, expected in (
        (padded.step_response, long.step_response),
        (padded.realisation.start, long.realisation.start),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert jax.tree.structure(padded.realisation) == jax.tree.structure(long.realisation)


def test_a_dose_under_the_skin_has_no_echo_when_the_model_forgets_it():
    """The patient's own linearisation, a day and a half after a disturbance, under models of 24 h that go on or end."""
    person = patient("hovorka-2004")
    plant = linear_model(person)
    true = np.asarray(step_response(plant, 1800))
    h = np.diff(true, prepend=0.0)
    disturbed = jnp.zeros(432).at[12:60].set(2.0)

    @jax.jit
    def glucose(controller):
        def sample(carry, too_much):
            x, state, delivered = carry
            y = person.setpoint_mg_dl + plant.C @ x
            state, decision = controller.step(state, observe(y, delivered, person.setpoint_mg_dl))
            dose = decision.insulin_mU_min
            u = dose - person.basal_insulin_mU_min - too_much
            return (plant.Phi @ x + plant.Gamma * u, state, dose), y

        start = controller.init(observe(person.setpoint_mg_dl, person.basal_insulin_mU_min, person.setpoint_mg_dl))
        return jax.lax.scan(sample, (jnp.zeros(plant.C.size), start, person.basal_insulin_mU_min), disturbed)[1]

    ratio = h[288] / h[287]
    later = Realisation(transition=ratio.reshape(1, 1), start=h[288:289], output=np.ones(1), after=288)
    endless, going_on, ending = (
        np.asarray(glucose(design_linear_mpc(model, MPCTuning(2, 36, 1.0, 3.0), WIDE)))
        for model in (
            StepResponseModel.from_impulse_response(h, 5.0),
            StepResponseModel.from_impulse_response(h[:288], 5.0, realisation=later),
            StepResponseModel.from_impulse_response(h[:288], 5.0),
        )
    )
    np.testing.assert_allclose(going_on[288:], endless[288:], atol=0.05)
    assert np.max(np.abs(ending[288:] - endless[288:])) > 2.0
