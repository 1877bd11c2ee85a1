"""Meals of a run of many days: each jump taken once, against the sum over all jumps and against SciPy."""

import itertools

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from glucoloop.meals import DallaManGut, Eaten, HovorkaGut, Ingestion, LehmannDeutsch, RoyParkerGut, absorb
from glucoloop.meals.linear import appearance_moments

PEOPLE = 4
STEP_MIN = 2.5
GUTS = (LehmannDeutsch(), HovorkaGut(), RoyParkerGut(), Ingestion())


def ate(days, *, before=0.0):
    """Four meals a day, half of them eaten at once, from some time before the start on."""
    rng = np.random.default_rng(4)
    number = 4 * days
    t_min = np.sort(rng.uniform(-before, 1440.0 * days, number))
    return Eaten(t_min=t_min, carbs_g=rng.uniform(5.0, 90.0, number), eating_min=np.where(np.arange(number) % 2, 0, 25))


def summed(absorption, samples):
    of_step = jax.jit(lambda t: appearance_moments(t, STEP_MIN, absorption))
    return jax.lax.map(of_step, STEP_MIN * jnp.arange(2 * samples)).reshape(samples, 2, 3, -1)


@pytest.mark.parametrize("gut", GUTS, ids=lambda gut: type(gut).__name__)
def test_moments_of_days_are_the_sum_over_all_jumps_also_over_those_before_the_start(gut):
    absorption = absorb(gut, ate(3, before=300.0))
    moments = np.asarray(absorption.moments(3 * 288, 2, STEP_MIN))[..., None]
    truth = np.asarray(summed(absorption, 3 * 288))
    assert moments == pytest.approx(truth, abs=1e-11 * np.abs(truth).max())


@pytest.mark.parametrize("gut", GUTS, ids=lambda gut: type(gut).__name__)
def test_sample_by_sample_is_the_whole_run_to_the_bit(gut):
    absorption = absorb(gut, ate(1, before=300.0))
    whole = absorption.moments(288, 2, STEP_MIN)

    @jax.jit
    def one(of, index):
        moments, after = of.at_sample(index, 2, STEP_MIN)
        return moments, of.goes_on(after)

    now, alone = absorption, []
    for index in range(288):
        moments, now = one(now, index)
        alone.append(moments)
    np.testing.assert_array_equal(np.stack(alone), whole)


def test_people_have_the_moments_of_their_own_guts():
    model = HovorkaGut(
        time_to_maximum_min=jnp.array([30.0, 40.0, 55.0, 70.0]), bioavailability=jnp.array([0.7, 0.8, 1.0, 0.9])
    )
    for gut in (model, LehmannDeutsch()):
        eaten = Eaten(
            t_min=np.tile(np.array([[-40.0], [3.3], [61.0], [400.0]]), PEOPLE),  # before the start, and after the end
            carbs_g=np.array([[30.0], [50.0], [0.0], [40.0]]) * np.linspace(0.5, 2.0, PEOPLE),
            eating_min=np.zeros((4, PEOPLE)),
        )
        absorption = absorb(gut, eaten)
        moments, truth = absorption.moments(60, 2, STEP_MIN), np.asarray(summed(absorption, 60))
        assert moments.shape == (60, 2, 3, PEOPLE)
        assert np.asarray(moments) == pytest.approx(truth, abs=1e-11 * np.abs(truth).max())


@pytest.mark.long
def test_a_year_of_meals_appears_as_scipy_integrates_the_last_days():
    """Rounding of a year neither grows nor stays: the equations of the last two days, started from nothing."""
    days = 366
    meals = ate(days)
    moments = np.asarray(absorb(LehmannDeutsch(), meals).moments(288 * days, 2, STEP_MIN))
    assert STEP_MIN * moments[..., 0].sum() == pytest.approx(1000.0 * meals.carbs_g.sum(), rel=2e-3)  # less a last meal

    first = 1440.0 * (days - 3)  # what was eaten before has left a gut of 60 min to 1e-10 two days later
    late = meals.t_min >= first
    absorbed = absorb(LehmannDeutsch(), Eaten(**{name: part[late] for name, part in vars(meals).items()}))
    corners = np.unique(np.concatenate([np.asarray(absorbed.jumps.t_min), [first, 1440.0 * days]]))
    ends = STEP_MIN * np.arange(2 * 288 * (days - 1), 2 * 288 * days + 1)

    def derivative(t, state):
        q, _ = state
        slopes, since = np.asarray(absorbed.jumps.size[0]), t - np.asarray(absorbed.jumps.t_min)
        return [np.sum(slopes * np.maximum(since, 0.0)) - q / 60.0, q / 60.0]

    state, totals = np.zeros(2), {}
    for start, end in itertools.pairwise(corners):
        inside = ends[(ends >= start) & (ends <= end)]
        solved = scipy.integrate.solve_ivp(
            derivative, (start, end), state, "DOP853", np.unique([*inside, end]), rtol=1e-11, atol=1e-9
        )
        totals |= dict(zip(solved.t.tolist(), solved.y[1].tolist(), strict=True))
        state = solved.y[:, -1]
    appeared = np.diff([totals[t] for t in ends.tolist()])
    found = STEP_MIN * moments[-288:, :, 0].ravel()
    np.testing.assert_allclose(found, appeared, rtol=0.0, atol=2e-5)


def largest_array(function, *arguments):
    """Number of the numbers of the largest array that a program of JAX makes."""

    def sizes(jaxpr):
        for equation in jaxpr.eqns:
            yield from (variable.aval.size for variable in equation.outvars)
            for inside in jax.extend.core.jaxprs_in_params(equation.params):
                yield from sizes(inside)

    return max(sizes(jax.make_jaxpr(function)(*arguments).jaxpr))


@pytest.mark.parametrize("gut", [*GUTS, DallaManGut()], ids=lambda gut: type(gut).__name__)
@pytest.mark.parametrize("what", ["moments", "emptying_mg_min"])
def test_memory_grows_with_the_days_and_not_with_their_square(gut, what):
    largest = []
    for days in (10, 40):
        lengths = (2, STEP_MIN) if what == "moments" else (2 * STEP_MIN,)
        absorption = absorb(gut, ate(days))
        largest.append(
            largest_array(lambda of, days=days, of_run=lengths: getattr(of, what)(288 * days, *of_run), absorption)
        )
    assert largest[1] <= 4.1 * largest[0]
