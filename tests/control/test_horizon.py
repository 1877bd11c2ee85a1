"""Horizons that suit a model: a controller has to see that insulin lowers glucose, in designs and in loops."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop.control import MealTuning, MPCTuning, StateTuning, design_linear_mpc, design_meal_mpc, design_mpc_se
from glucoloop.control.horizon import DEFAULT_SHARE, MIN_SHARE, suited
from glucoloop.models.state_space import step_response
from glucoloop.models.step_response import StepResponseModel

SLOW = ("hovorka-2004", "wilinska-2010")


def of_lags(gain, taus_min, samples=600, sample_time_min=5.0):
    """Step response of lags in series, by convolution."""
    t_min = sample_time_min * np.arange(1, samples + 1)
    rise = np.ones(samples)
    for tau in taus_min:
        pulse = np.exp(-t_min / tau)
        rise = np.convolve(pulse / pulse.sum(), rise)[:samples]
    return gain * rise


@given(
    gain=st.floats(-80.0, -0.5),
    taus_min=st.lists(st.floats(10.0, 120.0), min_size=1, max_size=4),
    horizon=st.integers(2, 100),
)
def test_a_horizon_is_refused_by_what_it_sees_and_the_told_one_will_do(gain, taus_min, horizon):
    S = of_lags(gain, taus_min)
    tuning = MPCTuning(2, horizon, 1.0, 1.0)
    if S[horizon - 1] / gain >= MIN_SHARE:
        assert suited(tuning, S, gain) is tuning
        return
    with pytest.raises(ValueError, match=f"horizon of {horizon} samples sees") as refused:
        suited(tuning, S, gain)
    enough = int(re.search(r"give a prediction horizon of (\d+) or more", str(refused.value))[1])
    assert S[enough - 2] / gain < MIN_SHARE <= S[enough - 1] / gain


def test_insulin_that_seems_to_raise_glucose_is_told():
    h = np.concatenate([np.full(14, 0.2), np.full(60, -0.4)])
    model = StepResponseModel.from_impulse_response(h, 5.0)
    with pytest.raises(ValueError, match=r"sees -7\.5 % of the gain of insulin, so that insulin seems to raise"):
        design_linear_mpc(model, MPCTuning(2, 8, 1.0, 3.0))
    with pytest.raises(ValueError, match="insulin lowers glucose"):
        design_linear_mpc(StepResponseModel.from_impulse_response(-h, 5.0))


def test_a_horizon_that_is_not_given_suits_the_model():
    slow = StepResponseModel.from_impulse_response(np.diff(of_lags(-20.0, [80.0, 80.0, 80.0]), prepend=0.0), 5.0)
    p = design_linear_mpc(slow).horizons[1]
    share = np.asarray(slow.step_response) / float(slow.gain)
    assert share[p - 2] < DEFAULT_SHARE <= share[p - 1]
    fast = StepResponseModel.from_impulse_response(-np.ones(10), 5.0)
    assert design_linear_mpc(fast).horizons == (2, 8)  # the paper's


@pytest.mark.long
def test_the_papers_patient_keeps_the_papers_horizon(identified_81, identified_22):
    assert design_linear_mpc(identified_81.model).horizons == (2, 8)
    assert design_linear_mpc(identified_22.model).horizons == (2, 8)


@pytest.mark.long
@pytest.mark.parametrize("name", SLOW)
def test_designs_on_the_equations_see_what_the_patient_shows(name):
    person = gl.patient(name)
    linear, nonlinear = gl.linear_model(person), gl.nonlinear_model(person)
    gain = float(linear.C @ jnp.linalg.solve(jnp.eye(linear.Gamma.size) - linear.Phi, linear.Gamma))
    share = np.asarray(step_response(linear, 288)) / gain
    enough = int(np.argmax(share >= MIN_SHARE)) + 1
    noise = np.ones(linear.Gamma.size)
    short, asked = StateTuning(2, 8, 1.0, 3.0), StateTuning(2, 0, 1.0, 3.0)
    for design in (lambda t: design_mpc_se(linear, noise, t), lambda t: gl.design_nlqdmc_se(nonlinear, noise, t)):
        with pytest.raises(ValueError, match=f"sees .* % of the gain of insulin; .*horizon of {enough} or more"):
            design(short)
        assert design(asked).horizons[1] == int(np.argmax(share >= DEFAULT_SHARE)) + 1
    with pytest.raises(ValueError, match=f"horizon of {enough} or more, or 0 for one that suits the model"):
        design_meal_mpc(nonlinear, MealTuning())
    usual = [design_mpc_se(linear, noise), gl.design_nlqdmc_se(nonlinear, noise)]
    assert [one.horizons[1] for one in usual] == [design(asked).horizons[1]] * 2
    assert design_meal_mpc(nonlinear).prediction_horizon == usual[0].horizons[1]


@pytest.mark.long
def test_designs_on_the_equations_see_enough_of_the_papers_patient():
    person = gl.patient()
    linear, nonlinear = gl.linear_model(person), gl.nonlinear_model(person)
    noise = np.ones(linear.Gamma.size)
    assert design_mpc_se(linear, noise).horizons == (2, 7)
    assert gl.design_nlqdmc_se(nonlinear, noise).horizons == (2, 7)  # at 5 the model has less than 30 % of its gain
    assert design_meal_mpc(nonlinear).prediction_horizon == 12


@pytest.mark.long
@pytest.mark.parametrize("name", SLOW)
def test_a_usual_design_for_insulin_under_the_skin_does_no_harm(name):
    """Without a word on tuning the loop is at least as good as the basal rate, and nobody is low."""
    person = gl.patient(name)
    model = gl.identify(person).model
    loop = np.asarray(gl.simulate(person, design_linear_mpc(model)).fine_glucose_mg_dl)
    rest = np.asarray(gl.simulate(person, gl.design_open_loop()).fine_glucose_mg_dl)
    assert loop.min() > 80.0
    assert np.mean(np.abs(loop - 120.0)) < np.mean(np.abs(rest - 120.0))
