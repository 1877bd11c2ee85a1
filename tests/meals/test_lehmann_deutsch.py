import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.meals import (
    Eaten,
    LehmannDeutsch,
    absorb,
    appearance_mg_min,
    appearance_moments,
    emptying_mg_min,
)

CARBS = st.one_of(st.just(0.0), st.floats(0.5, 10.8), st.floats(10.8, 150.0))
MEALS = st.lists(st.tuples(st.floats(0.0, 300.0), CARBS), min_size=3, max_size=3)

appearance = jax.jit(jax.vmap(appearance_mg_min, in_axes=(0, None)))
empties = jax.jit(jax.vmap(emptying_mg_min, in_axes=(0, None)))
moments = jax.jit(appearance_moments)


def meals_of(t_min, carbs_g, eating_min=None):
    """Meals of the published gut."""
    eating_min = np.zeros(np.shape(t_min)) if eating_min is None else eating_min
    return absorb(LehmannDeutsch(), Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min))


@pytest.fixture(scope="module")
def test_meal():
    """The oral glucose test: 50 g at 50 min."""
    return meals_of(np.array([50.0]), np.array([50.0]))


def trapezoid(t, carbs_g):
    """Emptying in mg/min, t minutes after a meal, drawn by hand."""
    ramp = min(30.0, carbs_g * 1000.0 / 360.0)
    fall = carbs_g * 1000.0 / 360.0 if carbs_g >= 10.8 else ramp
    return np.interp(t, [0.0, ramp, fall, fall + ramp], [0.0, 360.0, 360.0, 0.0], left=0.0, right=0.0)


def test_appearance_at_known_times(test_meal):
    known = [0.0, 76.702075, 157.00817, 310.04218]
    np.testing.assert_allclose(appearance(np.array([50.0, 80.0, 100.0, 200.0]), test_meal), known, rtol=1e-7)


def test_appearance_is_the_closed_form(test_meal, meal_by_hand):
    t = np.linspace(0.0, 900.0, 601)
    truth = [meal_by_hand(minute, 50.0, 50.0) for minute in t]
    np.testing.assert_allclose(appearance(t, test_meal), truth, rtol=1e-11, atol=1e-9)


def test_peak(test_meal):
    found = scipy.optimize.minimize_scalar(
        lambda t: -float(appearance_mg_min(t, test_meal)), bounds=(180.0, 210.0), method="bounded"
    )
    assert found.x == pytest.approx(192.6, abs=0.05)
    assert -found.fun == pytest.approx(315.278, abs=5e-4)


@pytest.mark.parametrize("carbs_g", [1.0, 5.0, 10.8, 50.0, 120.0])
def test_all_that_is_eaten_empties_and_appears(carbs_g):
    kinks = meals_of(np.array([20.0]), np.array([carbs_g]))
    corners = np.unique(np.asarray(kinks.jumps.t_min))
    emptied = scipy.integrate.trapezoid(np.asarray(empties(corners, kinks)), x=corners)
    assert emptied == pytest.approx(carbs_g * 1000.0, rel=1e-12)
    # what is left in the gut decays with its time constant of 60 min
    t = np.unique(np.r_[corners, np.arange(20.0, 600.0, 0.05)])
    appeared = scipy.integrate.trapezoid(np.asarray(appearance(t, kinks)), x=t)
    left = 60.0 * float(appearance_mg_min(t[-1], kinks))
    assert appeared + left == pytest.approx(carbs_g * 1000.0, rel=1e-6)


@pytest.mark.parametrize("carbs_g", [0.5, 5.0, 10.8, 50.0])
def test_emptying_is_a_trapezoid(carbs_g):
    t = np.linspace(-10.0, 300.0, 3101)
    found = empties(t, meals_of(np.array([0.0]), np.array([carbs_g])))
    np.testing.assert_allclose(found, trapezoid(t, carbs_g), atol=1e-8)


def test_small_and_large_meals_meet_where_the_plateau_vanishes():
    t = np.linspace(0.0, 400.0, 401)
    below, at, above = (
        appearance(t, meals_of(np.array([0.0]), np.array([g]))) for g in (10.8 - 1e-6, 10.8, 10.8 + 1e-6)
    )
    np.testing.assert_allclose(below, at, atol=1e-4)
    np.testing.assert_allclose(above, at, atol=1e-4)


def test_meals_superpose():
    t = np.linspace(0.0, 600.0, 601)
    times, carbs = np.array([10.0, 47.3, 60.0]), np.array([50.0, 5.0, 30.0])
    alone = sum(appearance(t, meals_of(times[i : i + 1], carbs[i : i + 1])) for i in range(3))
    np.testing.assert_allclose(appearance(t, meals_of(times, carbs)), alone, rtol=1e-12, atol=1e-10)


def test_a_meal_of_nothing_is_nothing():
    assert float(appearance_mg_min(100.0, meals_of(np.array([0.0]), np.array([0.0])))) == 0.0
    assert float(appearance_mg_min(100.0, meals_of(np.zeros(0), np.zeros(0)))) == 0.0


def test_gut_content_follows_its_equation():
    times, carbs = [0.0, 33.3, 95.0], [40.0, 6.0, 25.0]
    kinks = meals_of(np.array(times), np.array(carbs))
    ends = np.unique([0.0, *np.asarray(kinks.jumps.t_min), 400.0])
    q, t_all, q_all = 0.0, [], []
    for start, end in itertools.pairwise(ends):
        run = scipy.integrate.solve_ivp(
            lambda t, q: sum(trapezoid(t - at, g) for at, g in zip(times, carbs, strict=True)) - q / 60.0,
            (start, end),
            [q],
            method="DOP853",
            rtol=1e-11,
            atol=1e-9,
        )
        q = run.y[0, -1]
        t_all.append(end)
        q_all.append(q)
    np.testing.assert_allclose(appearance(np.array(t_all), kinks), np.array(q_all) / 60.0, rtol=1e-8)


@settings(max_examples=40)
@given(MEALS, st.floats(0.0, 400.0), st.sampled_from([1.0, 2.5, 5.0, 15.0]))
def test_moments_are_those_of_quadrature_with_every_kink(meals, start, step):
    kinks = meals_of(np.array([t for t, _ in meals]), np.array([g for _, g in meals]))
    inside = [(t - start) / step for t in np.asarray(kinks.jumps.t_min) if start < t < start + step]
    at = jax.jit(appearance_mg_min)
    for n, found in enumerate(moments(start, step, kinks)):
        legendre = np.polynomial.legendre.Legendre.basis(n)
        truth, _ = scipy.integrate.quad(
            lambda s, legendre=legendre: float(at(start + step * s, kinks)) * legendre(2.0 * s - 1.0),
            0.0,
            1.0,
            points=sorted(set(inside)) or None,
            epsabs=1e-10,
            epsrel=1e-12,
        )
        assert float(found) == pytest.approx(truth, abs=1e-8)


@pytest.mark.long
def test_meals_of_a_cohort_are_those_of_its_people():
    times, carbs = np.array([[0.0, 20.0], [90.0, 95.0]]), np.array([[50.0, 4.0], [0.0, 70.0]])
    together = meals_of(times, carbs)
    for i in range(2):
        alone = meals_of(times[:, i], carbs[:, i])
        np.testing.assert_allclose(appearance_mg_min(150.0, together)[i], appearance_mg_min(150.0, alone), rtol=1e-13)
        np.testing.assert_allclose(
            moments(92.0, 5.0, together)[:, i], moments(92.0, 5.0, alone), rtol=1e-12, atol=1e-12
        )


@pytest.mark.long
def test_appearance_can_be_differentiated_by_the_size_of_the_meal():
    def at(carbs_g):
        return appearance_mg_min(jnp.asarray(150.0), meals_of(jnp.array([0.0]), carbs_g[None]))

    slope = (at(jnp.asarray(30.001)) - at(jnp.asarray(29.999))) / 0.002
    assert float(jax.grad(at)(jnp.asarray(30.0))) == pytest.approx(float(slope), rel=1e-6)
