"""Meals of many people, kink by kink, against the sum over all kinks at every step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from glucoloop.meals.lehmann_deutsch import (
    GUT_TIME_CONSTANT_MIN,
    appearance_mg_min,
    appearance_moments,
    emptying,
    emptying_mg_min,
)
from glucoloop.meals.people import ENTRIES, digest, fasting, kink_table

STEPS, MEALS = 48, 3
LENGTHS = (2.5, 5.0)


@jax.jit
def by_kinks(t_min, carbs_g, step_min):
    kinks = emptying(t_min, carbs_g)
    starts = step_min * jnp.arange(STEPS)
    moments = jax.vmap(lambda t: appearance_moments(t, step_min, kinks))(starts)
    ends = step_min * jnp.arange(1, STEPS + 1)
    return (
        moments,
        jax.vmap(lambda t: appearance_mg_min(t, kinks))(ends),
        jax.vmap(lambda t: emptying_mg_min(t, kinks))(ends),
    )


@pytest.fixture(scope="module")
def digested():
    """Moments of every step, and r, E and E' at their ends, of people one after the other step."""

    def scan(table, step_min):
        def one(state, kinks):
            state, moments = digest(state, kinks, step_min)
            return state, (moments, state)

        return jax.lax.scan(one, fasting(table[0, 0]), table)[1]

    scan = jax.jit(scan, static_argnums=1)
    return lambda t_min, carbs_g, step_min: scan(
        kink_table(emptying(t_min, carbs_g), steps=STEPS, step_min=step_min), step_min
    )


def assert_same(digested, t_min, carbs_g, step_min):
    t_min, carbs_g = np.asarray(t_min, float).reshape(MEALS, -1), np.asarray(carbs_g, float).reshape(MEALS, -1)
    moments, after = digested(t_min, carbs_g, step_min)
    expected, appearance, stomach = by_kinks(t_min, carbs_g, step_min)
    np.testing.assert_allclose(moments, expected, rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(after.appearance_mg_min, appearance, rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(after.emptying_mg_min, stomach, rtol=0.0, atol=2e-9)


SIZES = st.one_of(st.floats(0.01, 200.0), st.sampled_from([0.0, 0.05, 0.5, 10.8, 11.0]))
TIMES = st.one_of(st.floats(0.0, 130.0), st.sampled_from([0.0, 2.5, 5.0, 7.499999999999999, 60.0, 119.99999, 120.0]))


@settings(max_examples=150)
@given(st.lists(TIMES, min_size=MEALS, max_size=MEALS), st.lists(SIZES, min_size=MEALS, max_size=MEALS))
@example([0.0, 0.0, 0.0], [0.05, 0.1, 0.5])  # all kinks of three meals within a step
@example([10.0, 10.0, 10.0], [40.0, 40.0, 40.0])
@example([117.6, 118.0, 119.0], [60.0, 5.0, 0.2])  # with kinks beyond the last step
def test_kinks_one_by_one_are_the_sum_over_all_of_them(digested, t_min, carbs_g):
    for step_min in LENGTHS:
        assert_same(digested, t_min, carbs_g, step_min)


def test_everybody_has_meals_of_his_own(digested):
    rng = np.random.default_rng(0)
    t_min, carbs_g = rng.uniform(0.0, 110.0, (MEALS, 40)), rng.uniform(0.0, 120.0, (MEALS, 40))
    moments, _ = digested(t_min, carbs_g, 2.5)
    assert_same(digested, t_min, carbs_g, 2.5)
    for person in (0, 17, 39):
        alone, _ = digested(t_min[:, [person]], carbs_g[:, [person]], 2.5)
        np.testing.assert_array_equal(moments[..., person], alone[..., 0])


def test_after_a_meal_all_of_it_has_appeared():
    t_min, carbs_g, h = np.array([[20.0]]), np.array([[50.0]]), 5.0
    table = kink_table(emptying(t_min, carbs_g), steps=400, step_min=h)
    _, (moments, end) = jax.lax.scan(
        lambda state, kinks: (lambda state, m: (state, (m, state)))(*digest(state, kinks, h)),
        fasting(table[0, 0]),
        table,
    )
    np.testing.assert_allclose(h * moments[:, 0].sum(), 50_000.0, rtol=1e-9)
    np.testing.assert_allclose(end.slope_mg_min2[-1], 0.0, atol=1e-12)
    # what is left in the gut fades with its time constant
    ratio = end.appearance_mg_min[60] / end.appearance_mg_min[59]
    np.testing.assert_allclose(ratio, np.exp(-h / GUT_TIME_CONSTANT_MIN), rtol=1e-6)


def test_a_table_may_be_added_to():
    t_min, carbs_g = np.array([[20.0, 40.0], [60.0, 80.0]]), np.array([[50.0, 30.0], [20.0, 10.0]])
    whole = kink_table(emptying(t_min, carbs_g), steps=STEPS, step_min=2.5)
    first = kink_table(emptying(t_min[:1], carbs_g[:1]), steps=STEPS, step_min=2.5)
    again = kink_table(emptying(t_min[1:], carbs_g[1:]), steps=STEPS, step_min=2.5, table=first)
    assert again is first
    assert whole.shape == (STEPS, ENTRIES, 2)
    np.testing.assert_allclose(again, whole, rtol=1e-12, atol=1e-12)


def test_nothing_eaten_is_nothing_told():
    np.testing.assert_array_equal(kink_table(emptying(np.zeros((1, 3)), np.zeros((1, 3))), steps=4, step_min=2.5), 0.0)
