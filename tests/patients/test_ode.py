"""Patients given by their equations: the rest that is found for them against closed forms, and what is refused."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop.patients import Inputs, OdePatient
from glucoloop.patients.capabilities import process_noise, rest_at


class Bergman(OdePatient):
    """The minimal model with insulin into a vein; its glucose stops at zero."""

    nominal: ClassVar = {"p_1": 0.02, "p_2": 0.025, "p_3": 1.3e-5, "n": 0.09, "G_b": 150.0}
    near_rest = (90.0, 0.015, 25.0)
    near_basal_mU_min = 27.0

    def derivative(self, t_min, x, inputs):
        c, (glucose, effect, insulin) = self.parameters, x
        falls = c["p_1"] * (c["G_b"] - glucose) - effect * glucose + inputs.meal_mg_min / 120.0
        return jnp.stack(
            [
                jnp.where(glucose > 0.0, falls, jnp.maximum(falls, 0.0)) - 0.0 * t_min,
                c["p_3"] * insulin - c["p_2"] * effect,
                inputs.insulin_mU_min / 12.0 - c["n"] * insulin,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[0]


class Frozen(Bergman):
    """The same without glucose below zero at all, so that every state beyond is at steady state."""

    def derivative(self, t_min, x, inputs):
        rates = super().derivative(t_min, x, inputs)
        return jnp.where(x[:1] < 0.0, 0.0, rates)


def at(c, insulin_mU_min):
    """Steady state in closed form."""
    insulin = insulin_mU_min / 12.0 / c["n"]
    effect = c["p_3"] / c["p_2"] * insulin
    return np.array([c["p_1"] * c["G_b"] / (c["p_1"] + effect), effect, insulin])


@settings(max_examples=40)
@given(
    st.fixed_dictionaries({name: st.floats(0.3, 3.0) for name in Bergman.nominal}),
    st.floats(0.0, 500.0),
)
def test_rest_is_the_closed_form_for_any_constants(factors, insulin_mU_min):
    constants = {name: factors[name] * value for name, value in Bergman.nominal.items()}
    person = Bergman(parameters=constants, basal_insulin_mU_min=jnp.asarray(0.0), setpoint_mg_dl=jnp.asarray(90.0))
    x = person.steady_state(insulin_mU_min)
    np.testing.assert_allclose(x, at(constants, insulin_mU_min), rtol=1e-9, atol=1e-12)
    inputs = Inputs(insulin_mU_min=jnp.asarray(insulin_mU_min), meal_mg_min=jnp.zeros(()))
    assert np.max(np.abs(person.derivative(jnp.zeros(()), x, inputs))) < 1e-9
    glucose = float(person.glucose_mg_dl(x))
    assert float(person.insulin_for(glucose)) == pytest.approx(insulin_mU_min, rel=1e-6, abs=1e-6)


def test_many_people_rest_at_once_and_each_as_alone():
    effects = Bergman.nominal["p_3"] * np.array([0.2, 1.0, 4.0])
    people = Bergman.resting_at(95.0, p_3=effects)
    alone = [Bergman.resting_at(95.0, p_3=effect) for effect in effects]
    np.testing.assert_allclose(people.basal_insulin_mU_min, [one.basal_insulin_mU_min for one in alone], rtol=1e-12)
    np.testing.assert_allclose(people.steady_state(people.basal_insulin_mU_min)[0], 95.0, rtol=1e-9)


def test_whom_no_rate_holds_is_nan_where_it_is_traced_and_refused_otherwise():
    person = Bergman.resting_at(90.0)
    rate, x = jax.jit(rest_at)(person, jnp.array([80.0, 151.0]))
    assert np.isfinite(rate[0])
    assert np.all(np.isfinite(x[:, 0]))
    assert np.isnan(rate[1])
    assert np.all(np.isnan(x[:, 1]))
    with pytest.raises(ValueError, match=r"no insulin infusion holds glucose at 151 mg/dl; .* at most 150\.00 mg/dl"):
        person.insulin_for(151.0)
    with pytest.raises(ValueError, match="an insulin infusion of -1 mU/min is not possible"):
        person.steady_state(-1.0)


@pytest.mark.long
@pytest.mark.parametrize("near", [(90.0, 0.015, 25.0), (5.0, 1.0, 900.0), (600.0, 1e-4, 0.1)])
def test_no_spurious_rest_beyond_zero_is_taken(near):
    class Rough(Frozen):
        near_rest = near

    for held in (20.0, 60.0, 140.0):
        person = Rough.resting_at(held)
        truth = at(Bergman.nominal, float(person.basal_insulin_mU_min))
        np.testing.assert_allclose(person.steady_state(person.basal_insulin_mU_min), truth, rtol=1e-8)
        assert truth[0] == pytest.approx(held)


def test_a_constant_that_the_patient_does_not_have_is_refused():
    with pytest.raises(ValueError, match=r"unknown parameter 'p_4'; did you mean 'p_\d'\?"):
        Bergman.resting_at(90.0, p_4=1.0)


def test_the_noise_of_states_follows_their_sizes_at_rest():
    person = Bergman.resting_at(90.0)
    x = np.asarray(person.steady_state(person.basal_insulin_mU_min))
    np.testing.assert_allclose(process_noise(person, 4.0, 1.0, 1.0), 4.0 * (x / x[0]) ** 2, rtol=1e-12)


@pytest.mark.long
def test_every_controller_is_designed_for_equations_alone():
    person = Bergman.resting_at(90.0)
    scenario = gl.Scenario([gl.Meal(40.0, 30.0)], 300.0)
    linear, nonlinear = gl.linear_model(person), gl.nonlinear_model(person)
    noise = process_noise(person, 1.0, 1.0, 1.0)
    made = [
        gl.design_linear_mpc(gl.identify(person).model),
        gl.design_mpc_se(linear, noise),
        gl.design_nlqdmc_se(nonlinear, noise),
    ]
    for controller in made:
        glucose = np.asarray(gl.simulate(person, controller, scenario=scenario).fine_glucose_mg_dl)
        assert 90.0 < glucose.max() < 250.0
        assert glucose.min() > 40.0
        assert abs(glucose[-1] - 90.0) < 15.0
