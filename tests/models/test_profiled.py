"""A person by profile: steps against SciPy, and insulin and carbohydrate that act as the profile says."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import glucoloop as gl
from glucoloop.models.profiled import ACTION_MIN, MEAL_G, GutCompartments, profiled_model
from glucoloop.patients.protocol import inputs_of
from glucoloop.simulation import linear_model, nonlinear_model
from glucoloop.therapy import Profile

GUT = GutCompartments(time_to_peak_min=40.0)
advance = jax.jit(lambda model, x, insulin, flux, step: model.advance(x, insulin, flux, step))


@functools.cache
def hovorka():
    return gl.patient("hovorka-2004")


@functools.cache
def nominal():
    return profiled_model(nonlinear_model(hovorka()), linear_model(hovorka()), GUT, 75.0)


def basal_mU_min():
    return float(hovorka().basal_insulin_mU_min)


def course(model, bolus_U, carbs_g, minutes=ACTION_MIN):
    """Glucose after each sample from a bolus and a meal on."""
    x, gut, found = nominal().nominal.state, jnp.array([1000.0 * carbs_g, 0.0]), []
    for k in range(round(minutes / 5.0)):
        flux = model.meal_gain * GUT.appearance_mg_min(gut, 5.0)
        x = advance(model, x, model.basal_mU_min + (200.0 * bolus_U if k == 0 else 0.0), flux, nominal().step_of(5.0))
        gut = GUT.after(gut, 5.0)
        found.append(float(model.glucose_mg_dl(x)))
    return np.array(found)


@pytest.mark.long
def test_a_meal_and_insulin_act_on_the_nominal_person_as_his_equations_say():
    x = solved = np.asarray(nominal().nominal.state)
    for insulin, flux in ((300.0, 200.0), (basal_mU_min(), 600.0), (0.0, 500.0), (0.0, 300.0), (10.0, 0.0)) * 3:

        def rates(t, x, insulin=insulin, flux=flux):
            return hovorka().derivative(0.0, jnp.asarray(x), inputs_of(jnp.asarray(insulin), jnp.asarray(flux)))

        solved = solve_ivp(jax.jit(rates), (0.0, 5.0), solved, rtol=1e-9, atol=1e-12).y[:, -1]
        x = advance(nominal(), x, insulin, flux, nominal().step_of(5.0))
        assert float(nominal().glucose_mg_dl(x)) == pytest.approx(float(hovorka().glucose_mg_dl(solved)), abs=0.3)
        np.testing.assert_allclose(x[3:], solved[3:], rtol=1e-7)  # insulin is linear, and its steps are exact


def test_a_long_step_goes_where_short_ones_go():
    far = nominal().step_of(30.0)
    x = short = nominal().nominal.state
    for insulin, flux in ((10.0, 300.0), (30.0, 200.0), (0.0, 100.0), (6.0, 0.0)):
        x = advance(nominal(), x, insulin, flux, far)
        for _ in range(6):
            short = advance(nominal(), short, insulin, flux, nominal().step_of(5.0))
        assert float(x[0]) == pytest.approx(float(short[0]), rel=0.03)
        np.testing.assert_allclose(x[3:], short[3:], rtol=1e-9)


def test_rest_is_rest_for_everybody():
    model = nominal().with_profile(Profile(basal_mU_min=20.0, setpoint_mg_dl=120.0, carb_ratio_g_U=9.0))
    np.testing.assert_allclose(
        advance(model, nominal().nominal.state, 20.0, 0.0, nominal().step_of(60.0)), nominal().nominal.state, rtol=1e-9
    )


@pytest.mark.parametrize(("ratio", "factor"), [(10.0, 40.0), (23.5, 90.0), (40.0, 60.0)])
def test_insulin_and_carbohydrate_act_as_the_profile_says(ratio, factor):
    model = nominal().with_profile(
        Profile(basal_mU_min=12.0, setpoint_mg_dl=120.0, carb_ratio_g_U=ratio, correction_mg_dl_U=factor)
    )
    # in the nominal person both are an hour's basal dose, for which the factor was found
    bolus_U = 60.0 / 1000.0 * basal_mU_min() / float(model.insulin_gain)
    assert 120.0 - course(model, bolus_U, 0.0).min() == pytest.approx(factor * bolus_U, rel=1e-6)
    carbs_g = MEAL_G / float(model.meal_gain)
    end = course(model, carbs_g / ratio, carbs_g)[-1]
    assert end == pytest.approx(120.0, abs=0.5)
    assert course(model, 0.8 * carbs_g / ratio, carbs_g)[-1] > 125.0


@pytest.mark.parametrize("daily_dose_U", [None, 60.0])
def test_a_profile_in_which_insulin_does_next_to_nothing_is_not_believed(daily_dose_U):
    profile = Profile(
        basal_mU_min=10.0,
        setpoint_mg_dl=120.0,
        carb_ratio_g_U=1.0,
        correction_mg_dl_U=2.0,
        total_daily_dose_U=daily_dose_U,
    )
    model = nominal().with_profile(profile)
    daily_U = daily_dose_U or 28.8  # twice 10 mU/min for a day
    factor = model.insulin_gain * model.own_correction_mg_dl_U
    ratio = model.insulin_gain * model.own_carb_ratio_g_U / model.meal_gain
    assert float(factor) == pytest.approx(0.43 * 1800.0 / daily_U)
    assert float(ratio) == pytest.approx(0.29 * 500.0 / daily_U)
    sensitive = nominal().with_profile(dataclasses.replace(profile, correction_mg_dl_U=500.0))
    assert float(sensitive.insulin_gain) == pytest.approx(500.0 / float(model.own_correction_mg_dl_U))


def test_the_nominal_person_is_believed_however_little_insulin_does():
    weak = dataclasses.replace(nominal(), own_correction_mg_dl_U=8.0, own_carb_ratio_g_U=4.0)
    for basal in (basal_mU_min(), 2.0 * basal_mU_min()):  # who needs twice as much answers half as much
        own = Profile(
            basal_mU_min=basal,
            setpoint_mg_dl=120.0,
            carb_ratio_g_U=4.0 * basal_mU_min() / basal,
            correction_mg_dl_U=8.0 * basal_mU_min() / basal,
        )
        told = weak.with_profile(own)
        assert float(told.insulin_gain) == pytest.approx(basal_mU_min() / basal)
        assert float(told.meal_gain) == pytest.approx(1.0)
        less = weak.with_profile(dataclasses.replace(own, correction_mg_dl_U=own.correction_mg_dl_U / 3.0))
        assert float(less.insulin_gain) == pytest.approx(basal_mU_min() / basal)


def test_a_reaction_is_the_factor_times_the_basal_rate_apart():
    """Small doses of two people whose factors differ by a factor of two move glucose by amounts that do so, too."""
    models = [
        nominal().with_profile(Profile(basal_mU_min=10.0, setpoint_mg_dl=120.0, correction_mg_dl_U=factor))
        for factor in (40.0, 80.0)
    ]
    first, second = (120.0 - course(model, 0.01, 0.0).min() for model in models)
    assert second == pytest.approx(2.0 * first, rel=0.01)


def test_what_is_not_known_follows_from_basal_rate_and_weight():
    heavy = nominal().with_profile(Profile(basal_mU_min=2.0 * basal_mU_min(), setpoint_mg_dl=120.0, weight_kg=100.0))
    assert float(heavy.insulin_gain) == pytest.approx(0.5)
    assert float(heavy.meal_gain) == pytest.approx(0.75)
    basal_alone = nominal().with_profile(Profile(basal_mU_min=basal_mU_min(), setpoint_mg_dl=120.0))
    assert (float(basal_alone.insulin_gain), float(basal_alone.meal_gain)) == (1.0, 1.0)


def test_people_whose_profiles_hold_more_or_less_have_the_models_of_each_alone():
    values = {"basal_mU_min": [6.0, 12.0, 9.0], "carb_ratio_g_U": [12.0, math.nan, 20.0]}
    values |= {"correction_mg_dl_U": [50.0, 70.0, math.nan]}
    many = nominal().with_profile(Profile(setpoint_mg_dl=120.0, **{name: jnp.array(of) for name, of in values.items()}))
    for i in range(3):
        one = nominal().with_profile(Profile(setpoint_mg_dl=120.0, **{name: of[i] for name, of in values.items()}))
        # XLA divides an array by a number as it multiplies by the reciprocal, which rounds otherwise
        assert float(one.insulin_gain) == pytest.approx(float(many.insulin_gain[i]), rel=1e-15)
        assert float(one.meal_gain) == pytest.approx(float(many.meal_gain[i]), rel=1e-15)


def test_meals_reach_glucose_and_not_insulin():
    assert nominal().fed_states() == (0, 1, 2)  # both compartments of glucose, and the interstitial one
    effect = jax.grad(
        lambda meal: hovorka().derivative(0.0, nominal().nominal.state, inputs_of(jnp.asarray(basal_mU_min()), meal))[0]
    )
    np.testing.assert_allclose(nominal().E, [float(effect(0.0)), *[0.0] * 8], rtol=1e-6)


def test_what_goes_into_the_gut_comes_out():
    content, appeared = jnp.array([3000.0, 1000.0]), 0.0
    for _ in range(200):
        appeared += 5.0 * float(GUT.appearance_mg_min(content, 5.0))
        content = GUT.after(content, 5.0)
    assert appeared == pytest.approx(4000.0, rel=1e-8)


def test_a_linear_model_without_meals_is_refused():
    linear = dataclasses.replace(linear_model(hovorka()), Psi=None)
    with pytest.raises(ValueError, match="does not say what a meal does; give one with a disturbance"):
        profiled_model(nominal().nominal, linear, GUT, None)
