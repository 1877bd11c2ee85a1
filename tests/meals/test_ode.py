"""A gut given by its equations: against a closed form, against SciPy, and what is eaten appears."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree
from glucoloop.meals import DallaManGut, Eaten, HovorkaGut, Meal, OdeMealModel, absorb, eaten, meal_model, ode
from glucoloop.meals.absorption import digestion, digestion_inputs
from glucoloop.meals.moments import moments_of_steps

PUBLISHED = DallaManGut()
STEEP = DallaManGut(k_max=0.05, k_min=0.012, k_abs=0.2, b=0.95, d=0.2, bioavailability=0.9)
"""About the steepest stomach of the thirty people of the simulator of 2008."""
SLOWLY_EATEN = [Meal(45.0, 30.0, 9.0), Meal(70.0, 95.0, 14.0), Meal(15.0, 101.0, 3.0)]


@functools.partial(jax.jit, static_argnums=(1, 2, 3))
def course(absorption, samples, substeps, step_min):
    """Moments of all steps by carrying the gut from sample to sample, and the state at the end."""

    def one(state, index):
        moments, after = absorption.goes_on(state).at_sample(index, substeps, step_min)
        return after, moments

    return jax.lax.scan(one, absorption.state, jnp.arange(samples))[::-1]


@pytree
class HovorkaByEquations:
    """The gut of Hovorka et al. (2004) without its closed form."""

    time_to_maximum_min: object = 40.0
    bioavailability: object = 0.8

    def init(self):
        return jnp.zeros(2)

    def at_point(self, state, eaten_mg, begins):
        return state

    def derivative(self, state, eating_mg_min):
        first, second = state / self.time_to_maximum_min
        return jnp.stack([self.bioavailability * eating_mg_min - first, first - second])

    def appearance_mg_min(self, state):
        return state[1] / self.time_to_maximum_min

    def emptying_mg_min(self, state):
        return state[0] / self.time_to_maximum_min


@pytest.mark.long
@pytest.mark.parametrize(("substeps", "step_min"), [(10, 0.5), (1, 5.0), (2, 2.5), (3, 5.0 / 3.0), (15, 1.0)])
def test_a_linear_gut_by_its_equations_is_its_closed_form(substeps, step_min):
    meals, samples = eaten([Meal(50.0, 31.0, 10.0), Meal(20.0, 36.0, 1.0), Meal(80.0, 60.0, 24.0)]), 60
    found = absorb(HovorkaByEquations(), meals).moments(samples, substeps, step_min)
    truth = absorb(HovorkaGut(), meals).moments(samples, substeps, step_min)
    # appearance bends where eating begins, and quadratics over a quarter of a minute follow it elsewhere
    np.testing.assert_allclose(found, truth, rtol=0.0, atol=2e-4 if step_min != 1.0 else 1e-4)
    assert np.max(truth) > 100.0


def minute_by_scipy(gut, eating, D, start):
    """State and appearance after a minute by the published equations; `D` is what the stomach remembers."""
    k_max, k_min, k_abs, b, d, f = (getattr(gut, field.name) for field in dataclasses.fields(gut))

    def rates(_, y):
        stomach = y[0] + y[1]
        empties = k_max
        if D > 0.0:
            slows = np.tanh(2.5 / D / (1.0 - b) * (stomach - b * D))
            hastens = np.tanh(2.5 / D / d * (stomach - d * D))
            empties = k_min + (k_max - k_min) / 2.0 * (slows - hastens + 2.0)
        appears = f * k_abs * y[2]
        return [eating - k_max * y[0], k_max * y[0] - empties * y[1], empties * y[1] - k_abs * y[2], appears]

    return scipy.integrate.solve_ivp(rates, (0.0, 1.0), [*start, 0.0], "DOP853", rtol=1e-11, atol=1e-9).y[:, -1]


def by_scipy(gut, meals, minutes):
    """Appearance integrated over each minute, and the state at the end, by the published equations minute by minute."""
    solid = liquid = inside = remembered = 0.0
    appeared = []
    for minute in range(minutes):
        eating = sum(
            1000.0
            * m.carbs_g
            / m.eating_min
            * np.clip(min(minute + 1, m.t_min + m.eating_min) - max(minute, m.t_min), 0, 1)
            for m in meals
        )
        if any(int(m.t_min) == minute for m in meals):
            remembered = solid + liquid
        remembered += eating
        solid, liquid, inside, appears = minute_by_scipy(gut, eating, remembered, (solid, liquid, inside))
        appeared.append(appears)
    return np.array(appeared), np.array([solid, liquid, inside, remembered])


@pytest.mark.long
@pytest.mark.parametrize(("gut", "within_mg"), [(PUBLISHED, 0.15), (STEEP, 1.5)], ids=["published", "steep"])
def test_the_gut_is_that_of_the_published_equations(gut, within_mg):
    truth, state = by_scipy(gut, SLOWLY_EATEN, 240)
    absorption = absorb(gut, eaten(SLOWLY_EATEN))
    moments, at_end = course(absorption, 48, 10, 0.5)
    np.testing.assert_array_equal(moments, absorption.moments(48, 10, 0.5))
    found = np.asarray(moments)[..., 0].reshape(240, 2).mean(axis=1)
    assert np.max(truth) > 150.0
    # in mg of what has appeared by then, of which 1.5 change the glucose of the average person by 0.01 mg/dl
    np.testing.assert_allclose(np.cumsum(found), np.cumsum(truth), rtol=0.0, atol=within_mg)
    np.testing.assert_allclose(at_end, state, rtol=0.0, atol=within_mg)


@pytest.mark.long
def test_the_method_is_of_fifth_order(monkeypatch):
    # a stomach that slows down over many minutes, in the middle of its way
    gut = DallaManGut(b=0.3, d=0.25, k_max=2.0, k_abs=1.0)
    start = jnp.array([20_000.0, 30_000.0, 5_000.0, 100_000.0])

    def after(steps):
        monkeypatch.setattr(ode, "STEPS_PER_POINT", steps)
        return np.asarray(digestion(gut, 1, 1.0).sample(start, jnp.zeros((1, 2)))[0])

    truth = minute_by_scipy(gut, 0.0, 100_000.0, start[:3])[:3]
    with jax.disable_jit():  # what was compiled would keep its number of steps
        errors = [np.max(np.abs(after(steps)[:3] - truth)) for steps in (2, 4, 8)]
    assert errors[-1] < 1.0
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 4.3)


TIMES, EATING = st.floats(0.0, 200.0), st.one_of(st.just(0.0), st.floats(1.0, 60.0))
SIZES = st.one_of(st.just(0.0), st.floats(0.01, 150.0))
MEALS = st.lists(st.tuples(TIMES, SIZES, EATING), min_size=3, max_size=3)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(MEALS)
def test_all_that_is_eaten_appears_or_is_still_inside(meals):
    t_min, carbs_g, eating_min = np.array(meals).T
    run = absorb(PUBLISHED, Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min))
    moments, at_end = map(np.asarray, course(run, 100, 10, 0.5))
    left = at_end[:3].sum() * PUBLISHED.bioavailability
    assert at_end.min() >= -1e-9
    total = PUBLISHED.bioavailability * 1000.0 * carbs_g.sum()
    # the appearance is integrated by quadratics
    assert 0.5 * moments[..., 0].sum() + left == pytest.approx(total, rel=1e-4, abs=1e-6)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(MEALS, st.sampled_from([2.5, 5.0, 7.0, 15.0]))
def test_what_people_eat_is_told_point_by_point(meals, sample_time_min):
    t_min, carbs_g, eating_min = (column[:, None] for column in np.array(meals).T)
    samples = int(300.0 / sample_time_min)
    eaten = Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min)
    told = digestion_inputs(PUBLISHED, eaten, 1, sample_time_min)(0, samples)
    assert told.shape == (samples, *digestion(PUBLISHED, 1, sample_time_min).inputs, 1)
    points = told.dense().reshape(-1, 2)
    assert points[:, 0].sum() == pytest.approx(1000.0 * carbs_g.sum(), rel=1e-12, abs=1e-9)
    alone = Eaten(t_min=t_min[:, 0], carbs_g=carbs_g[:, 0], eating_min=eating_min[:, 0])
    one = ode.eaten_of(alone, np.arange(points.shape[0]), sample_time_min)
    np.testing.assert_allclose(points, one, rtol=1e-12, atol=1e-9)
    begins = set(np.flatnonzero(points[:, 1]).tolist())
    point_min = sample_time_min / round(sample_time_min)
    assert begins == {int(t / point_min + 1e-9) for t, carbs, _ in meals if carbs > 0.0}


@pytest.mark.long
def test_the_stomach_remembers_what_was_in_it_when_the_meal_began():
    gut, state = PUBLISHED, jnp.array([4_000.0, 6_000.0, 500.0, 50_000.0])
    begun = gut.at_point(state, jnp.asarray(5_000.0), jnp.asarray(True))
    assert float(begun[3]) == 15_000.0
    assert float(gut.at_point(begun, jnp.asarray(2_000.0), jnp.asarray(False))[3]) == 17_000.0
    # meals do not superpose: the second of two is not what one alone would be
    both, first, second = (
        np.asarray(absorb(gut, eaten(meals)).moments(60, 10, 0.5)).sum()
        for meals in ([Meal(60.0, 10.0, 5.0), Meal(60.0, 60.0, 5.0)], [Meal(60.0, 10.0, 5.0)], [Meal(60.0, 60.0, 5.0)])
    )
    assert abs(both - first - second) > 0.01 * both


@pytest.mark.long
def test_nothing_subnormal_is_left_after_days_without_a_meal():
    gut = jax.tree.map(jnp.float32, PUBLISHED)
    inside = digestion(gut, 10, 0.5)
    state, nothing = jnp.array([1e4, 1e4, 1e4, 5e4], jnp.float32), jnp.zeros((5, 2), jnp.float32)
    day = jax.jit(lambda state: jax.lax.scan(lambda s, _: (inside.sample(s, nothing)[0], s), state, length=2880)[1])
    amounts = np.abs(np.asarray(day(state)))
    assert amounts.dtype == np.float32
    assert not np.any((amounts > 0.0) & (amounts < np.finfo(np.float32).tiny))
    assert not amounts[-1, :3].any()


def test_moments_of_steps_that_do_not_end_together_keep_what_they_hold():
    rates = np.random.default_rng(0).normal(size=(4, 3, 2))
    for steps in (1, 2, 3, 6, 10):
        of_steps = np.asarray(moments_of_steps(jnp.asarray(rates), steps))
        np.testing.assert_allclose(of_steps[:, 0].mean(axis=0), rates[:, 0].mean(axis=0), rtol=1e-12)
    # the moments of a straight line, 1 to 9 over all of it
    line = np.array([[2.0, 1.0, 0.0], [4.0, 1.0, 0.0], [6.0, 1.0, 0.0], [8.0, 1.0, 0.0]]) / [1.0, 3.0, 1.0]
    np.testing.assert_allclose(moments_of_steps(jnp.asarray(line), 1)[0], [5.0, 4.0 / 3.0, 0.0], atol=1e-12)


def test_a_gut_by_its_equations_is_a_meal_model():
    assert isinstance(meal_model("dalla-man"), OdeMealModel)
    assert isinstance(HovorkaByEquations(), OdeMealModel)
    assert not isinstance(HovorkaGut(), OdeMealModel)
    with pytest.raises(ValueError, match=r"dalla-man: b is 1\.2; give a number above 0 and up to 0\.99"):
        meal_model("dalla-man, b=1.2")
