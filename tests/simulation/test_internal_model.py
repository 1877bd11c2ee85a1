"""Models handed to controllers: the linear one against differences, the nonlinear one against another integrator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from glucoloop.build.designs import controller_of
from glucoloop.control import Observation, design_open_loop
from glucoloop.models.nonlinear import advance_with_rough_tangents, individual_model, roughly
from glucoloop.models.state_space import step_response
from glucoloop.patients import patient
from glucoloop.simulation import linear_model, nonlinear_model
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial


def sampled_by_hand(sorensen, x, u):
    """Differences of the balances and SciPy's exponential: transition, insulin and meal over one sample."""
    h = 1e-4
    A = np.stack([(sorensen(x + h * e, u, 0.0) - sorensen(x - h * e, u, 0.0)) / (2 * h) for e in np.eye(19)], axis=1)
    B = (sorensen(x, u + 1e-2, 0.0) - sorensen(x, u - 1e-2, 0.0)) / 2e-2
    E = (sorensen(x, u, 1.0) - sorensen(x, u, -1.0)) / 2.0
    held = scipy.linalg.expm(5.0 * np.block([[A, np.stack([B, E], axis=1)], [np.zeros((2, 21))]]))
    return held[:19, :19], held[:19, 19], held[:19, 20]


@pytest.mark.parametrize("insulin", [None, 15.0])
def test_the_linear_model_is_that_of_the_balances(patient_81, sorensen_by_hand, insulin):
    model = linear_model(patient_81, insulin_mU_min=insulin)
    u = float(patient_81.basal_insulin_mU_min) if insulin is None else insulin
    x = np.asarray(model.state)
    np.testing.assert_allclose(sorensen_by_hand(x, u, 0.0), 0.0, atol=1e-9)
    Phi, Gamma, Psi = sampled_by_hand(sorensen_by_hand, x, u)
    np.testing.assert_allclose(model.Phi, Phi, atol=2e-6)
    np.testing.assert_allclose(model.Gamma, Gamma, atol=1e-7)
    np.testing.assert_allclose(model.Psi, Psi, atol=1e-7)
    np.testing.assert_array_equal(model.C, np.eye(19)[2])
    assert float(model.insulin_mU_min) == u
    assert float(model.glucose_mg_dl) == x[2]
    assert model.sample_time_min == 5.0


def test_the_known_dynamics_at_the_papers_setpoint(patient_81):
    model = linear_model(patient_81)
    S = np.asarray(step_response(model, 36))
    np.testing.assert_allclose(S[[0, 5, 11, 35]], [-0.010266601, -0.77305708, -1.741683, -2.8207981], rtol=1e-7)
    assert np.abs(np.linalg.eigvals(model.Phi)).max() == pytest.approx(0.954500318, rel=1e-8)
    gain = model.C @ np.linalg.solve(np.eye(19) - model.Phi, model.Gamma)
    assert float(gain) == pytest.approx(-3.17618654, rel=1e-7)


@pytest.fixture(scope="module")
def imagined(patient_81):
    return nonlinear_model(patient_81)


@pytest.mark.parametrize("setpoint", [80.0, 110.0, 140.0])
def test_the_nonlinear_model_rests_at_the_setpoint(patient_81, sorensen_by_hand, setpoint):
    model = nonlinear_model(patient_81, setpoint_mg_dl=setpoint)
    assert float(model.glucose_mg_dl(model.state)) == pytest.approx(setpoint, abs=1e-9)
    np.testing.assert_allclose(
        sorensen_by_hand(np.asarray(model.state), float(model.insulin_mU_min), 0.0), 0.0, atol=1e-7
    )


def test_the_linear_model_rests_where_the_nonlinear_one_does(patient_81):
    linear, nonlinear = (model(patient_81, setpoint_mg_dl=125.0) for model in (linear_model, nonlinear_model))
    np.testing.assert_array_equal(linear.state, nonlinear.state)
    assert float(linear.insulin_mU_min) == float(nonlinear.insulin_mU_min)
    assert float(linear.glucose_mg_dl) == pytest.approx(125.0, abs=1e-9)
    own = float(patient_81.setpoint_mg_dl)
    at_basal, named = linear_model(patient_81), linear_model(patient_81, setpoint_mg_dl=own)
    for one, other in zip(jax.tree.leaves(at_basal), jax.tree.leaves(named), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="an infusion and a setpoint were given"):
        linear_model(patient_81, insulin_mU_min=20.0, setpoint_mg_dl=125.0)


@pytest.mark.long
def test_mpc_se_is_designed_where_its_setpoint_is():
    """At rest there it does nothing: its model knows the glucose, so that nothing is left to be corrected."""
    trial = configured(Trial, controller="mpc-se", setpoint_mg_dl=125.0)
    controller = controller_of(trial, trial.cases[0])
    assert float(controller.basal_glucose_mg_dl) == pytest.approx(125.0, abs=1e-9)
    rate = float(controller.basal_mU_min)
    seen = Observation(
        glucose_mg_dl=jnp.asarray(125.0),
        valid=jnp.asarray(True),
        setpoint_mg_dl=jnp.asarray(125.0),
        delivered_mU_min=jnp.asarray(rate),
        announced_carbs_g=jnp.asarray(0.0),
    )
    _, decision = controller.step(controller.init(seen), seen)
    assert float(decision.insulin_mU_min) == pytest.approx(rate, abs=1e-6)


@pytest.mark.parametrize("model", [linear_model, nonlinear_model])
def test_a_setpoint_that_no_infusion_holds_is_refused(patient_81, model):
    with pytest.raises(ValueError, match="no infusion holds the patient at 900 mg/dl"):
        model(patient_81, setpoint_mg_dl=900.0)


def test_the_nonlinear_model_follows_an_adaptive_integrator(imagined, sorensen_by_hand):
    """Four hours of changes as large as the pump makes in a sample; the error of its one step is of their square."""
    follow = jax.jit(
        lambda rates: jax.lax.scan(lambda x, u: (imagined.advance(x, u),) * 2, imagined.state, rates)[1][:, 2]
    )
    errors = {}
    for change in (4.175, 8.35):
        rates = float(imagined.insulin_mU_min) + change * np.where(np.arange(48) // 8 % 2, -1.0, 1.0)
        x, expected = np.asarray(imagined.state), []
        for rate in rates:
            x = scipy.integrate.solve_ivp(
                lambda _, x, u=rate: sorensen_by_hand(x, u, 0.0), (0.0, 5.0), x, method="LSODA", rtol=1e-9, atol=1e-9
            ).y[:, -1]
            expected.append(x[2])
        assert np.ptp(expected) > 2.0 * change
        errors[change] = np.abs(follow(jnp.asarray(rates)) - np.array(expected)).max()
    assert errors[8.35] < 1e-3
    assert errors[4.175] < errors[8.35] / 3.5


def test_the_nonlinear_model_is_the_fasting_patient(imagined, patient_81, sorensen_by_hand):
    x = np.asarray(imagined.state) * (1.0 + 0.05 * np.sin(np.arange(19)))
    np.testing.assert_allclose(
        imagined.derivative(jnp.asarray(x), jnp.asarray(30.0)), sorensen_by_hand(x, 30.0, 0.0), atol=1e-9
    )
    assert float(imagined.insulin_mU_min) == float(patient_81.basal_insulin_mU_min)
    assert float(imagined.glucose_mg_dl(imagined.state)) == pytest.approx(81.1, rel=1e-12)
    np.testing.assert_allclose(imagined.advance(imagined.state, imagined.insulin_mU_min), imagined.state, rtol=1e-11)


def test_both_models_agree_on_small_changes(imagined, patient_81):
    linear = linear_model(patient_81)
    moved = imagined.advance(imagined.state, imagined.insulin_mU_min + 1e-3)
    np.testing.assert_allclose((moved - imagined.state) / 1e-3, linear.Gamma, atol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("insulin", [10.0, 24.0, 60.0])
def test_rough_derivatives_of_an_hour_are_near_those_of_the_forecast_whose_values_stay(patient_81, insulin):
    model = individual_model(nonlinear_model(patient_81), 24.0)

    def forecast(advance):
        def glucose(moves):
            x, seen = model.state, []
            for rate in insulin + jnp.append(moves[:1], jnp.full(11, jnp.sum(moves))):
                x = advance(x, rate, jnp.array([150.0, 20.0, 0.0]))
                seen.append(model.glucose_mg_dl(x))
            return jnp.stack(seen)

        return glucose(jnp.zeros(2)), jax.jacfwd(glucose)(jnp.zeros(2))

    value, exact = forecast(model.advance_fed)
    kept, rough = forecast(lambda *at: advance_with_rough_tangents(model, *at))
    np.testing.assert_array_equal(kept, value)
    far = np.abs(rough - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert (far > 1e-4).all()
    assert (far < 0.05).all()


def test_a_model_whose_integrator_has_no_rough_step_is_linearised_by_it():
    model = nonlinear_model(patient("uva-padova-2008"))
    assert roughly(model) is model


def test_the_sample_time_is_that_of_the_model(patient_81, imagined):
    longer = nonlinear_model(patient_81, sample_time_min=10.0)
    twice = imagined.advance(imagined.advance(imagined.state, jnp.asarray(30.0)), jnp.asarray(30.0))
    np.testing.assert_allclose(longer.advance(longer.state, jnp.asarray(30.0)), twice, atol=1e-3)
    assert (longer.sample_time_min, imagined.sample_time_min) == (10.0, 5.0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"insulin_mU_min": -1.0}, "insulin infusion of -1 mU/min is not possible; give a finite rate of 0 or more"),
        ({"insulin_mU_min": np.nan}, "insulin infusion of nan mU/min is not possible"),
        ({"insulin_mU_min": 60.0}, "no physiological steady state exists at 60 mU/min.*give less than"),
        ({"sample_time_min": 0.0}, "sample time must be positive and finite, but it is 0.0 min"),
        ({"sample_time_min": np.inf}, "sample time must be positive and finite, but it is inf min"),
    ],
)
def test_a_point_without_a_model_is_refused(patient_81, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        linear_model(patient_81, **arguments)


def test_a_patient_that_the_integrator_cannot_carry_is_refused():
    with pytest.raises(TypeError, match="patient is an OpenLoop; give a patient, an object with"):
        nonlinear_model(design_open_loop())


@pytest.mark.parametrize("minutes", [0.0, -5.0, np.nan, np.inf])
def test_a_sample_time_that_is_not_possible_is_refused(patient_81, minutes):
    with pytest.raises(ValueError, match=rf"sample time of {minutes:g} min is not possible; give a finite value above"):
        nonlinear_model(patient_81, sample_time_min=minutes)
