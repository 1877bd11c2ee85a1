"""Work of long runs: in proportion to their days, counted by the numbers that are computed and not by the clock."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.meals import MEAL_MODELS, Eaten, absorb
from glucoloop.meals.linear import appearance_mg_min, meals_of_samples
from glucoloop.meals.ode import eaten_of
from glucoloop.pumps import LimitedPump
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.sensors import IdealSensor
from glucoloop.simulation.plant import SampleGrid
from glucoloop.simulation.stepper import scenario_stepper, simulate_stepped

MINUTES = 5.0
SAMPLES_A_DAY = 288


def meals(days):
    """Meals every 4 h, eaten for 20 min, one before the run begins."""
    begin = 240.0 * np.arange(-1, 6 * days) + 7.0
    return Eaten(t_min=begin, carbs_g=np.full(begin.size, 40.0), eating_min=np.full(begin.size, 20.0))


def work(jaxpr, times=1):
    """Numbers that a program computes, each turn of a loop of known length counted."""
    total = 0
    for equation in jaxpr.eqns:
        inner = [
            getattr(value, "jaxpr", value)
            for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda of: hasattr(of, "eqns"))
            if hasattr(value, "eqns") or hasattr(value, "jaxpr")
        ]
        turns = times * (equation.params["length"] if equation.primitive.name == "scan" else 1)
        total += sum(work(one, turns) for one in inner)
        if not inner:
            total += times * sum(math.prod(out.aval.shape) for out in equation.outvars)
    return total


def work_of(function, *arguments):
    return work(jax.make_jaxpr(function)(*arguments).jaxpr)


@pytest.fixture(params=["dalla-man", "lehmann-deutsch", "hovorka"])
def absorbed(request):
    model = MEAL_MODELS[request.param]().made()
    return lambda days: absorb(model, meals(days))


def test_the_appearance_of_meals(absorbed):
    def of(days):
        absorption = absorbed(days)
        return work_of(lambda: absorption.moments(days * SAMPLES_A_DAY, 5, 1.0))

    assert 1000 < of(4)
    assert of(32) < 8.5 * of(4)


def test_a_sample_of_the_adaptive_integrator(absorbed, patient_81):
    rest = gl.simulate(patient_81, gl.design_open_loop(), scenario=gl.Scenario([], 5.0)).states[0]

    def of(days):
        grid = SampleGrid(MINUTES, days * SAMPLES_A_DAY)
        plant, outside = gl.Adaptive().prepare(patient_81, absorbed(days), grid)
        first = jax.tree.map(lambda leaf: leaf[0], outside)
        return work_of(lambda outside: plant.advance(rest, jnp.asarray(20.0), outside), first)

    assert 100 < of(1) == of(8)


def test_what_is_eaten_in_a_run_is_what_is_eaten_in_each_sample():
    absorption = absorb(MEAL_MODELS["dalla-man"]().made(), meals(2))
    each = [eaten_of(absorption.eaten, 5 * k + jnp.arange(5), MINUTES) for k in range(2 * SAMPLES_A_DAY)]
    np.testing.assert_array_equal(absorption.eaten_in_run(2 * SAMPLES_A_DAY, MINUTES), np.stack(each))


@pytest.mark.parametrize("traced", [False, True])
def test_the_meals_of_samples_appear_as_all_meals_in_closed_form(traced):
    model = MEAL_MODELS["lehmann-deutsch"]().made()
    eaten, at_min = meals(1), np.arange(0.0, 1440.0, 1.7)

    def appearing(carbs_g):
        absorption = absorb(model, Eaten(t_min=eaten.t_min, carbs_g=carbs_g, eating_min=eaten.eating_min))
        samples = meals_of_samples(absorption, SAMPLES_A_DAY, MINUTES)
        of = jax.tree.map(lambda leaf: leaf[(at_min // MINUTES).astype(int)], samples)
        return jax.vmap(lambda meals, t: meals.appearance_mg_min(t, model))(of, jnp.asarray(at_min))

    result = jax.jit(appearing)(eaten.carbs_g) if traced else appearing(eaten.carbs_g)
    exact = jax.vmap(lambda t: appearance_mg_min(t, absorb(model, eaten)))(jnp.asarray(at_min))
    np.testing.assert_allclose(result, exact, rtol=1e-9, atol=1e-7)


@pytest.mark.long
@pytest.mark.parametrize("integrator", [None, gl.Adaptive(1e-6)], ids=["usual", "adaptive"])
@pytest.mark.parametrize("meal_model", ["dalla-man", "lehmann-deutsch"])
def test_a_stepper_forgets_meals_that_are_over_and_is_the_simulation_to_the_bit(patient_81, integrator, meal_model):
    days = 1 if integrator else 4
    eaten = [gl.Meal(20.0, 60.0 * k + 7.0, 20.0 * (k % 2)) for k in range(24 * days - 1)]
    scenario = gl.Scenario(eaten, 1440.0 * days, meal_model=meal_model)
    controller = gl.design_open_loop(patient_81.basal_insulin_mU_min)
    whole = gl.simulate(patient_81, controller, scenario=scenario, integrator=integrator)
    stepper = scenario_stepper(
        patient_81,
        IdealSensor(),
        LimitedPump(limits=PARKER_1999_LIMITS),
        scenario,
        sample_time_min=MINUTES,
        key=0,
        integrator=integrator,
    )
    state = controller.init(stepper.observation())
    stepped = simulate_stepped(stepper, scenario, lambda index, seen: controller.step(state, seen)[1])
    np.testing.assert_array_equal(stepped.states, whole.states)
    assert stepper._now.eaten.t_min.size <= 16
