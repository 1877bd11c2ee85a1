"""JAX's transformations through the loop: gradients against finite differences, jit and vmap against plain calls."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree, static
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control import Decision
from glucoloop.models.step_response import StepResponseModel

HORIZON_MIN = 100.0
AT = (0.5, 150.0, 20.0, 12.0, 1.45, 90.0, 100.0)
NAMES = ("gain", "integral time", "carbohydrate", "meal time", "noise variance", "setpoint", "initial glucose")


@pytest.fixture(scope="module")
def cost(patient_81):
    """Mean squared error, of everything that may be traced at once."""

    def cost(gain, integral_min, carbs_g, meal_min, variance, setpoint, initial):
        controller = gl.design_pid(gl.PIDTuning(gain, integral_min, 2.0), gl.dose_limits(max_mU_min=200.0))
        scenario = gl.Scenario(
            [gl.Meal(carbs_g, meal_min)], HORIZON_MIN, setpoint_mg_dl=setpoint, initial_glucose_mg_dl=initial
        )
        pump = gl.LimitedPump(limits=gl.dose_limits(max_mU_min=200.0))
        trace = gl.simulate(patient_81, controller, gl.white_noise(variance), pump, scenario, 1)
        return jnp.mean((trace.glucose_mg_dl - 90.0) ** 2)

    return cost


def test_gradients_are_finite_differences(cost):
    gradient, value = jax.jit(jax.grad(cost, argnums=tuple(range(len(AT)))))(*AT), jax.jit(cost)
    for i, (name, found) in enumerate(zip(NAMES, gradient, strict=True)):
        h = 1e-4 * AT[i]
        above, below = (value(*(at + sign * h * (k == i) for k, at in enumerate(AT))) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found, (above - below) / (2.0 * h), rtol=1e-5, err_msg=name)
        assert float(found) != 0.0, name


def test_compiling_and_mapping_are_the_plain_loop(cost):
    gains = jnp.array([0.4, 0.5, 0.8])
    plain = np.array([cost(gain, *AT[1:]) for gain in gains.tolist()])
    mapped = jax.jit(jax.vmap(lambda gain: cost(gain, *AT[1:])))(gains)
    np.testing.assert_allclose(mapped, plain, rtol=1e-11)


def test_the_weights_of_linear_mpc_are_differentiated_in_its_closed_form():
    model = StepResponseModel.from_impulse_response([-0.5, -0.4, -0.3, -0.2], sample_time_min=5.0)

    def first(weight):
        return gl.design_linear_mpc(model, gl.MPCTuning(1, 3, output_weight=weight, move_weight=2.0)).gain[0]

    # one move: K = w^2 S / (w^2 S'S + 4), with S = (-.5, -.9, -1.2)
    squares = 0.5**2 + 0.9**2 + 1.2**2
    np.testing.assert_allclose(first(3.0), -0.5 * 9.0 / (9.0 * squares + 4.0), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(first)(3.0), -0.5 * 2 * 3.0 * 4.0 / (9.0 * squares + 4.0) ** 2, rtol=1e-10)
    np.testing.assert_allclose(jax.vmap(first)(jnp.array([1.0, 3.0])), [first(1.0), first(3.0)], rtol=1e-12)


@pytree
class Net:
    """A controller that holds a function beside its numbers, as a neural network does."""

    weight: jax.Array
    layers: dict
    sample_time_min: float = static(default=5.0)

    def init(self, observation):
        """The basal rate."""
        return observation.delivered_mU_min

    def step(self, state, observation):
        """Basal rate and what the function says."""
        error = observation.glucose_mg_dl - observation.setpoint_mg_dl
        more = self.layers["activation"](self.weight * error / 50.0)
        return state, Decision(insulin_mU_min=state * (1.0 + more), status=jnp.asarray(0))


def test_a_controller_may_hold_functions(patient_81):
    scenario = gl.Scenario([gl.Meal(50.0, 10.0)], 60.0)

    def peak(weight, activation=jnp.tanh):
        controller = Net(weight=weight, layers={"activation": activation})
        return gl.simulate(patient_81, controller, scenario=scenario).glucose_mg_dl[-1]

    h = 1e-5
    difference = (peak(0.5 + h) - peak(0.5 - h)) / (2.0 * h)
    np.testing.assert_allclose(jax.grad(peak)(0.5), difference, rtol=1e-6)
    assert float(peak(0.5, jnp.arctan)) != float(peak(0.5))  # another function is another program


class Bergman(gl.patients.OdePatient):
    """The minimal model with a constant infusion."""

    nominal: ClassVar = {"p_1": 0.02, "p_2": 0.025, "p_3": 1.3e-5, "n": 0.09, "basal_glucose": 150.0}
    near_rest = (90.0, 0.015, 25.0)
    near_basal_mU_min = 27.0

    def derivative(self, t_min, x, inputs):
        c, (glucose, effect, insulin) = self.parameters, x
        return jnp.stack(
            [
                c["p_1"] * (c["basal_glucose"] - glucose) - effect * glucose + inputs.meal_mg_min / 120.0,
                -c["p_2"] * effect + c["p_3"] * insulin,
                inputs.insulin_mU_min / 12.0 - c["n"] * insulin,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[0]


INTEGRATORS = {"default": None, "adaptive": gl.Adaptive(), "explicit": gl.Explicit(steps_per_min=4)}


def last_glucose(gain, effect, integrator, meal_model="lehmann-deutsch"):
    """Glucose after a meal, of a person whose constants change what holds the person at steady state."""
    person = Bergman.resting_at(90.0, p_3=1.3e-5 * effect)
    controller = gl.design_pid(gl.PIDTuning(gain, 150.0, 2.0), gl.dose_limits(max_mU_min=200.0))
    scenario = gl.Scenario([gl.Meal(50.0, 5.0)], 90.0, meal_model=meal_model)
    return gl.simulate(person, controller, scenario=scenario, integrator=integrator).glucose_mg_dl[-1]


@pytest.mark.long
@pytest.mark.parametrize("meal_model", ["lehmann-deutsch", "dalla-man"])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_patient_of_ones_own_is_differentiated_in_either_mode(name, meal_model):
    def value(gain, effect):
        return last_glucose(gain, effect, INTEGRATORS[name], meal_model)

    at, h = (0.5, 1.2), 1e-4
    by_gain = (value(0.5 + h, 1.2) - value(0.5 - h, 1.2)) / (2.0 * h)
    by_effect = (value(0.5, 1.2 + h) - value(0.5, 1.2 - h)) / (2.0 * h)
    both = (float(by_gain), float(by_effect))
    assert min(np.abs(both)) > 0.01
    for gradient in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(gradient(value, argnums=(0, 1))(*at), both, rtol=1e-4)
    np.testing.assert_allclose(jax.jvp(value, at, (1.0, 1.0))[1], sum(both), rtol=1e-4)
    mapped = jax.vmap(jax.grad(value, argnums=1), in_axes=(None, 0))(0.5, jnp.array([1.2, 1.2]))
    np.testing.assert_allclose(mapped, [both[1], both[1]], rtol=1e-4)


def test_the_rate_of_a_person_at_rest_has_the_derivatives_of_its_closed_form():
    def rate(effect):
        return Bergman.resting_at(90.0, p_3=effect).basal_insulin_mU_min

    # rate = 12 n p_2 p_1 (G_b - G) / (G p_3)
    exact = 12.0 * 0.09 * 0.025 * 0.02 * 60.0 / 90.0
    p_3 = 1.3e-5
    np.testing.assert_allclose(rate(p_3), exact / p_3, rtol=1e-9)
    for gradient in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(gradient(rate)(p_3), -exact / p_3**2, rtol=1e-9)
        np.testing.assert_allclose(gradient(gradient(rate))(p_3), 2.0 * exact / p_3**3, rtol=1e-9)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda p: gl.simulate(p, gl.design_open_loop()),
            r"the patient is traced by JAX, but the matrices.*integrator=Adaptive\(\)",
        ),
        (lambda p: gl.identify(p), "identify cannot be differentiated.*; patient is traced"),
        (lambda p: gl.linear_model(p), "linear_model cannot be differentiated.*; patient is traced"),
    ],
)
def test_what_cannot_be_traced_says_why(patient_81, call, sentence):
    with pytest.raises(ArgumentTypeError, match=sentence):
        jax.jit(call)(patient_81)
