"""Forecasts of controllers: what they say under the plan is what happens when the plan is followed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.component.effects import NoEffectWarning
from glucoloop.control import MPCTuning, design_linear_mpc, design_mpc_se, guarded, paced
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.protocol import forecast_of
from glucoloop.models.step_response import StepResponseModel
from glucoloop.simulation import linear_model, nonlinear_model
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop
from mpc_rows import IMPULSE, WIDE, observe
from naming import naming

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
forecast = jax.jit(forecast_of)
PREDICT = ("mpc", "mpc-se", "nlqdmc-se", "profile-mpc", "therapy-mpc", "meal-mpc", "oref0", "loop-like")


def glucose_by_convolution(start_mg_dl, rates):
    """Glucose ``(len(rates),)`` at the samples of a plant by its impulse response, at steady state before."""
    deviations = np.asarray(rates) - rates[0]
    return start_mg_dl + np.array([IMPULSE[:k][::-1] @ deviations[max(0, k - 36) : k] for k in range(len(rates))])


@pytest.mark.parametrize("settings", [{}, {"constraints": "qp"}, {"glucose_floor_mg_dl": 78.0}])
def test_linear_mpc_on_its_own_model_foretells_what_its_plan_does(settings):
    """A response that ends within the memory, so that convolution is exact, and a lasting error of 4 mg/dl."""
    model = StepResponseModel.from_impulse_response(IMPULSE, 5.0)
    controller = design_linear_mpc(model, MPCTuning(3, 12, 3.0, 1.0), WIDE, **settings)
    rates = [25.0]
    state = controller.init(observe(85.1, 25.0))
    for _ in range(9):
        glucose = glucose_by_convolution(85.1, [*rates, 0.0])[-1]
        state, decision = step(controller, state, observe(glucose, rates[-1]))
        rates.append(float(decision.insulin_mU_min))
    seen = observe(glucose_by_convolution(85.1, [*rates, 0.0])[-1], rates[-1])
    ahead = forecast(controller, state, seen)
    followed = [*rates, *np.asarray(ahead.insulin_mU_min)]
    np.testing.assert_allclose(ahead.ahead_min, 5.0 * np.arange(13))
    np.testing.assert_allclose(ahead.glucose_mg_dl, glucose_by_convolution(85.1, followed)[len(rates) :], rtol=1e-10)
    assert float(ahead.insulin_mU_min[0]) == pytest.approx(float(step(controller, state, seen)[1].insulin_mU_min))
    assert np.ptp(ahead.insulin_mU_min[:3]) > 0.1
    assert np.ptp(ahead.insulin_mU_min[3:]) == 0.0


def test_the_plan_keeps_the_limits_of_the_pump_rate_by_rate():
    """Against the least squares without limits, of which the pump gives what it can."""
    model, tuning = StepResponseModel.from_impulse_response(IMPULSE, 5.0), MPCTuning(4, 12, 1.0, 0.3)
    controller = design_linear_mpc(model, tuning, gl.dose_limits(max_change_mU_min=2.0, max_mU_min=30.0))
    seen = observe(100.0, 25.0)
    ahead = forecast(controller, controller.init(seen), seen)
    S = np.cumsum(IMPULSE)
    A = np.array([[S[i - j] if i >= j else 0.0 for j in range(4)] for i in range(12)])
    error = np.r_[np.full(12, 81.1 - 100.0), np.zeros(4)]
    planned = 25.0 + np.cumsum(np.linalg.lstsq(np.r_[A, 0.3 * np.eye(4)], error, rcond=None)[0])
    rate, rates = 25.0, []
    for wanted in planned:
        rate = min(max(rate - 2.0, min(rate + 2.0, wanted)), 30.0)
        rates.append(rate)
    np.testing.assert_allclose(ahead.insulin_mU_min[:4], rates, rtol=1e-9)
    assert planned.max() > 30.0


def test_state_estimation_on_the_linear_plant_foretells_what_its_plan_does(patient_81):
    model = linear_model(patient_81)
    n = model.Gamma.size
    for dead_time in (0, 2):
        controller = design_mpc_se(model, np.ones(n), limits=WIDE, offset_free="none", dead_time_samples=dead_time)
        Phi, Gamma, C = (np.asarray(part) for part in (model.Phi, model.Gamma, model.C))
        basal, rest = float(model.insulin_mU_min), float(model.glucose_mg_dl)
        seen = dataclasses.replace(observe(rest, basal), setpoint_mg_dl=jnp.asarray(rest - 9.0))
        ahead = forecast(controller, controller.init(seen), seen)
        x, glucose = np.zeros(n), [0.0] * (1 + dead_time)
        for rate in np.asarray(ahead.insulin_mU_min)[: len(ahead.ahead_min) - 1 - dead_time]:
            x = Phi @ x + Gamma * (rate - basal)
            glucose.append(C @ x)
        np.testing.assert_allclose(np.asarray(ahead.glucose_mg_dl) - rest, glucose, atol=1e-9)
        assert glucose[-1] < -3.0


@pytest.mark.long
def test_on_the_patient_that_it_models_the_plan_does_what_was_foretold(patient_81, script):
    """Without meals and noise, at a setpoint below glucose at rest; a plan is followed from the fourth sample on."""
    nonlinear, linear = nonlinear_model(patient_81), linear_model(patient_81)
    noise = np.ones(nonlinear.state.size)
    lower = gl.Scenario([], 90.0, setpoint_mg_dl=79.0)
    for name, controller, error in (
        ("meal-mpc", gl.control.design_meal_mpc(nonlinear, limits=WIDE, measurement_variance=0.01), 0.01),
        # the effect of moves is that of a linearisation
        ("nlqdmc-se", gl.control.design_nlqdmc_se(nonlinear, noise, limits=WIDE), 0.001),
        ("mpc-se", design_mpc_se(linear, noise, limits=WIDE), 0.01),
    ):
        with naming(name):
            pump = gl.LimitedPump(limits=WIDE)
            trace = gl.simulate(patient_81, controller, pump=pump, scenario=lower, forecasts=True)
            first, rates = trace.forecast, np.asarray(trace.insulin_mU_min)
            points = first.ahead_min.shape[1]
            followed = gl.simulate(
                patient_81,
                script([*rates[:3], *np.asarray(first.insulin_mU_min)[3]]),
                pump=pump,
                scenario=gl.Scenario([], 5.0 * (2 + points)),
            )
            expected = np.asarray(followed.glucose_mg_dl)[3:]
            size = np.abs(expected - 81.14).max()
            np.testing.assert_allclose(first.glucose_mg_dl[3][: len(expected)], expected, atol=error * size)
            assert size > 0.5


@pytest.mark.long
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_forecasts_change_no_dose_and_begin_with_it(controller):
    meals = {"patient": "hovorka-2004", "meals": ["50g@10min"], "duration_min": 60.0, "announce_meals": True}
    plain, asked_for = (
        close_the_loop(run, run.case).trace
        for run in (
            configured(Run, {**meals, "controller": controller, "forecasts": forecasts, "allow_unusual": True})
            for forecasts in (False, True)
        )
    )
    for name in ("glucose_mg_dl", "command_mU_min", "command_bolus_mU"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(asked_for, name))
    assert plain.forecast is None
    assert (asked_for.forecast is None) == (controller not in PREDICT)
    if asked_for.forecast is None:
        assert asked_for.forecasts_to_polars().is_empty()
        return
    ahead = asked_for.forecast
    assert np.all(np.asarray(ahead.ahead_min)[:, 0] == 0.0)
    table = asked_for.forecasts_to_polars()
    assert table.height == np.asarray(ahead.ahead_min).size
    assert table["t_min"].n_unique() == 12
    assert table["glucose_mg_dl"].is_finite().all()
    first = np.asarray(ahead.insulin_mU_min)[:, 0]
    if controller in ("oref0", "loop-like"):
        np.testing.assert_allclose(first, float(asked_for.basal_insulin_mU_min), rtol=1e-9)
        return
    dose = np.asarray(asked_for.command_mU_min)
    if asked_for.command_bolus_mU is not None:
        dose = dose + np.asarray(asked_for.command_bolus_mU) / 5.0
    np.testing.assert_allclose(first, dose, rtol=1e-6, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("controller", ["profile-mpc", "therapy-mpc"])
def test_forecasts_by_profile_are_those_of_the_equations_in_short_steps(controller):
    """Of a reading above the target: the steps of up to an hour beside those of 5 min, one after another."""
    run = configured(Run, {"patient": "hovorka-2004", "controller": controller, "meals": []})
    from glucoloop.build.designs import controller_of
    from glucoloop.control import Observation

    of = controller_of(run, run.case)
    seen = Observation(
        glucose_mg_dl=jnp.asarray(150.0),
        valid=jnp.asarray(True),
        setpoint_mg_dl=jnp.asarray(120.0),
        delivered_mU_min=jnp.asarray(float(of.model.basal_mU_min)),
        announced_carbs_g=jnp.asarray(0.0),
        delivered_bolus_mU=jnp.asarray(0.0),
    )
    ahead = forecast(of, of.init(seen), seen)
    estimate = of._planned(of.init(seen), seen).estimate
    short = of.model.step_of(5.0)
    x, t, glucose = estimate.x, 0.0, {0.0: float(of.model.glucose_mg_dl(estimate.x))}
    ends, rates = np.asarray(ahead.ahead_min), np.asarray(ahead.insulin_mU_min)
    advance = jax.jit(lambda x, rate, flux: of.model.advance(x, rate, flux, short))
    gut, content = of.filter.gut_of(estimate), estimate.gut_mg
    fading, disturbance = of.filter.disturbance_min, float(estimate.disturbance_mg_min)
    while t < ends[-1]:
        left = np.exp(-5.0 / fading)
        flux = float(of.filter.meal_gain_of(of.model, estimate)) * gut.appearance_mg_min(content, 5.0)
        flux = flux + disturbance * (1.0 - left) * fading / 5.0
        x = advance(x, rates[np.searchsorted(ends, t, side="right") - 1], flux)
        content, disturbance, t = gut.after(content, 5.0), disturbance * left, t + 5.0
        glucose[t] = float(of.model.glucose_mg_dl(x))
    expected = [glucose[float(end)] for end in ends]
    np.testing.assert_allclose(ahead.glucose_mg_dl, expected, atol=0.6)
    assert np.ptp(expected) > 10.0


def test_wrappers_pass_a_forecast_on_and_none_where_there_is_none(script):
    controller = design_linear_mpc(StepResponseModel.from_impulse_response(IMPULSE, 5.0), MPCTuning(3, 12, 3.0, 1.0))
    seen = observe(90.0, 25.0)
    bare = forecast(controller, controller.init(seen), seen)
    for wrapped in (guarded(controller, basal_mU_min=25.0), paced(controller, 1.0)):
        through = forecast(wrapped, wrapped.init(seen), seen)
        np.testing.assert_allclose(through.glucose_mg_dl, bare.glucose_mg_dl, rtol=1e-12)
        own = dataclasses.replace(wrapped, inner=script([25.0]))
        assert forecast_of(own, own.init(seen), seen) is None
    slow = paced(controller, 1.0)
    state, _ = step(slow, slow.init(seen), seen)
    assert np.all(np.isnan(forecast(slow, state, seen).ahead_min))


def test_a_controller_without_forecasts_is_noted(patient_81):
    with pytest.warns(NoEffectWarning, match="forecasts has no effect: the controller OpenLoop"):
        trace = gl.simulate(patient_81, gl.design_open_loop(), scenario=gl.Scenario([], 30.0), forecasts=True)
    assert trace.forecast is None
