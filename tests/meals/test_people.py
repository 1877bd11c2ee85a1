"""Meals of many people, jump by jump, against the sum over all jumps at every step."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.meals import Eaten, HovorkaGut, Ingestion, LehmannDeutsch, absorb
from glucoloop.meals.absorption import JumpsInSteps
from glucoloop.meals.lehmann_deutsch import GUT_TIME_CONSTANT_MIN
from glucoloop.meals.linear import appearance_moments, linear_digestion

STEPS, MEALS = 48, 3
STEP_MIN = 2.5
GUTS = (LehmannDeutsch(), HovorkaGut(), Ingestion())


@jax.jit
def by_jumps(absorption, step_min):
    """Moments of every step, summed over all jumps."""
    return jax.vmap(lambda t: appearance_moments(t, step_min, absorption))(step_min * jnp.arange(STEPS))


@functools.partial(jax.jit, static_argnums=2)
def scan(table, model, step_min):
    """Moments of every step and states at their ends, one step after the other, of people who trail."""
    gut = linear_digestion(model, 1, step_min)
    axes = jax.tree.map(lambda leaf: -1 if leaf.ndim > 2 else None, gut)

    def one(state, inside):
        over = jax.vmap(lambda gut, state, inside: gut.sample(state, inside[None]), (axes, -1, -1), -1)
        state, moments = over(gut, state, inside)
        return state, (moments[0], state)

    states = table.shape[1] - 3
    return jax.lax.scan(one, jnp.zeros((states, table.shape[2])), table)[1]


def digested(model, meals, step_min):
    return scan(JumpsInSteps(absorb(model, meals), step_min).table(0, STEPS).dense(), model, step_min)


def assert_same(model, meals, step_min):
    moments, _ = digested(model, meals, step_min)
    expected = by_jumps(absorb(model, meals), step_min)
    np.testing.assert_allclose(moments, expected, rtol=1e-12, atol=2e-9)


def column(values):
    return np.asarray(values, float).reshape(MEALS, 1)


SIZES = st.one_of(st.floats(0.01, 200.0), st.sampled_from([0.0, 0.05, 0.5, 10.8, 11.0]))
TIMES = st.one_of(st.floats(0.0, 130.0), st.sampled_from([0.0, 2.5, 5.0, 7.499999999999999, 60.0, 119.99999, 120.0]))
EATING = st.one_of(st.just(0.0), st.floats(1.0, 90.0))


def three(values):
    return st.lists(values, min_size=MEALS, max_size=MEALS)


@pytest.mark.long
@settings(max_examples=60)
@given(st.sampled_from(GUTS), three(TIMES), three(SIZES), three(EATING))
@example(LehmannDeutsch(), [0.0, 0.0, 0.0], [0.05, 0.1, 0.5], [0.0] * 3)  # all jumps of three meals within a step
@example(LehmannDeutsch(), [10.0, 10.0, 10.0], [40.0, 40.0, 40.0], [0.0] * 3)
@example(LehmannDeutsch(), [117.6, 118.0, 119.0], [60.0, 5.0, 0.2], [0.0] * 3)  # with jumps beyond the last step
def test_jumps_one_by_one_are_the_sum_over_all_of_them(model, t_min, carbs_g, eating_min):
    meals = Eaten(t_min=column(t_min), carbs_g=column(carbs_g), eating_min=column(eating_min))
    assert_same(model, meals, STEP_MIN)


PEOPLE = 40
RNG = np.random.default_rng(0)
VARIED = {
    "lehmann-deutsch": LehmannDeutsch(
        plateau_mg_min=RNG.uniform(200.0, 500.0, PEOPLE),
        ramp_min=RNG.uniform(10.0, 45.0, PEOPLE),
        gut_time_constant_min=RNG.uniform(20.0, 90.0, PEOPLE),
    ),
    "hovorka": HovorkaGut(
        time_to_maximum_min=RNG.uniform(15.0, 90.0, PEOPLE), bioavailability=RNG.uniform(0.7, 1.2, PEOPLE)
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", VARIED)
def test_each_person_has_meals_and_a_gut_of_their_own(name):
    people = VARIED[name]
    meals = Eaten(
        t_min=RNG.uniform(0.0, 110.0, (MEALS, PEOPLE)),
        carbs_g=RNG.uniform(0.0, 120.0, (MEALS, PEOPLE)),
        eating_min=np.where(RNG.uniform(size=(MEALS, PEOPLE)) < 0.5, 0.0, 40.0),
    )
    assert_same(people, meals, STEP_MIN)
    moments, _ = digested(people, meals, STEP_MIN)
    for person in (0, 17, 39):
        alone, _ = digested(
            jax.tree.map(lambda a, i=person: float(a[i]), people),
            jax.tree.map(lambda a, i=person: a[:, [i]], meals),
            STEP_MIN,
        )
        np.testing.assert_allclose(moments[..., person], alone[..., 0], rtol=1e-12, atol=1e-10)


def test_what_is_left_in_the_gut_fades_with_its_time_constant():
    meals = Eaten(t_min=column([5.0, 0.0, 0.0]), carbs_g=column([2.0, 0.0, 0.0]), eating_min=column([0.0] * 3))
    _, after = digested(LehmannDeutsch(), meals, 5.0)
    np.testing.assert_allclose(after[-1, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(after[41, 0] / after[40, 0], np.exp(-5.0 / GUT_TIME_CONSTANT_MIN), rtol=1e-6)


@pytest.mark.parametrize("model", GUTS)
def test_nothing_eaten_is_nothing_told(model):
    none = np.zeros((1, 3))
    meals = absorb(model, Eaten(t_min=none, carbs_g=none, eating_min=none))
    np.testing.assert_array_equal(JumpsInSteps(meals, 2.5).table(0, 4).dense(), 0.0)
