"""Every meal model: closed forms against the equations integrated by SciPy, mass balance, and superposition."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.meals import (
    DallaManGut,
    Eaten,
    HovorkaGut,
    Ingestion,
    LehmannDeutsch,
    MealModel,
    RoyParkerGut,
    absorb,
    appearance_mg_min,
    appearance_moments,
    meal_model,
    meal_model_of,
)
from glucoloop.meals.models import MEAL_MODELS, check_meal_model

T_MIN = st.floats(0.0, 100.0)
CARBS_G = st.floats(0.5, 150.0)
EATING_MIN = st.one_of(st.just(0.0), st.floats(1.0, 300.0))
GUTS = st.one_of(
    st.builds(
        LehmannDeutsch,
        plateau_mg_min=st.floats(150.0, 600.0),
        ramp_min=st.floats(5.0, 60.0),
        gut_time_constant_min=st.floats(10.0, 120.0),
    ),
    st.builds(HovorkaGut, time_to_maximum_min=st.floats(10.0, 120.0), bioavailability=st.floats(0.5, 1.2)),
    st.just(Ingestion()),
)

appearance = jax.jit(jax.vmap(appearance_mg_min, in_axes=(0, None)))
moments = jax.jit(jax.vmap(appearance_moments, in_axes=(0, None, None)))


def one_meal(model, t_min, carbs_g, eating_min):
    return absorb(model, Eaten(t_min=np.array([t_min]), carbs_g=np.array([carbs_g]), eating_min=np.array([eating_min])))


def rates_of(model):
    """A of the model's equations, written out by hand."""
    if isinstance(model, LehmannDeutsch):
        k = 1.0 / model.gut_time_constant_min
        return np.array([[-k, k, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    if isinstance(model, HovorkaGut):
        k = 1.0 / model.time_to_maximum_min
        return np.array([[-k, k, 0.0], [0.0, -k, k], [0.0, 0.0, 0.0]])
    return np.zeros((1, 1))


@settings(max_examples=40)
@given(GUTS, st.floats(0.0, 400.0))
def test_the_propagator_is_the_exponential_of_the_equations(model, z_min):
    truth = scipy.linalg.expm(rates_of(model) * z_min)
    np.testing.assert_allclose(model.propagator(jnp.asarray(z_min)), truth, rtol=1e-10, atol=1e-10)


def equations(model, t_min, carbs_g, eating_min):
    """Corners of what enters the gut, its state after the first one, its derivative, and the row of the appearance."""
    dose = 1000.0 * carbs_g
    if isinstance(model, LehmannDeutsch):
        # what the stomach passes on is limited by its plateau rate and by eating, and smoothed over a ramp
        lasting = max(dose / model.plateau_mg_min, eating_min)
        ramp, k = min(model.ramp_min, lasting), 1.0 / model.gut_time_constant_min

        def derivative(t, q):
            passed = [dose * np.clip((at - t_min) / lasting, 0.0, 1.0) for at in (t, t - ramp)]
            return (passed[0] - passed[1]) / ramp - k * q

        return t_min + np.array([0.0, ramp, lasting, lasting + ramp]), np.zeros(1), derivative, np.array([k])
    k, dose = 1.0 / model.time_to_maximum_min, dose * model.bioavailability
    end = t_min + eating_min

    def derivative(t, D):
        eats = dose / eating_min if t < end else 0.0
        return np.array([eats - k * D[0], k * (D[0] - D[1])])

    return np.array([t_min, end]), np.array([0.0 if eating_min else dose, 0.0]), derivative, np.array([0.0, k])


@pytest.mark.long
@settings(max_examples=25)
@given(GUTS.filter(lambda model: not isinstance(model, Ingestion)), T_MIN, CARBS_G, EATING_MIN)
def test_the_appearance_is_that_of_the_equations(model, t_min, carbs_g, eating_min):
    corners, state, derivative, row = equations(model, t_min, carbs_g, eating_min)
    times = t_min + np.array([0.5, 3.0, 17.0, 60.0, 150.0, 400.0, 700.0])
    truth = {}
    begin = t_min
    for end in np.unique(np.r_[times, corners[corners > t_min]]):
        inside = (end - begin) * 1e-12  # a stage at the very end belongs to this side of a corner
        run = scipy.integrate.solve_ivp(
            lambda t, s, last=end - inside: derivative(min(t, last), s),
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-8,
        )
        begin, state = end, run.y[:, -1]
        truth[end] = row @ state
    found = appearance(times, one_meal(model, t_min, carbs_g, eating_min))
    np.testing.assert_allclose(found, [truth[t] for t in times], rtol=1e-8, atol=1e-6)


@pytest.mark.long
@settings(max_examples=60)
@given(GUTS, T_MIN, CARBS_G, EATING_MIN)
def test_all_that_is_eaten_and_available_appears(model, t_min, carbs_g, eating_min):
    meal = one_meal(model, t_min, carbs_g, eating_min)
    appeared = 15.0 * float(moments(15.0 * np.arange(400), 15.0, meal)[:, 0].sum())
    available = getattr(model, "bioavailability", 1.0)
    assert appeared == pytest.approx(1000.0 * carbs_g * available, rel=1e-9)


@pytest.mark.long
@settings(max_examples=25)
@given(GUTS, T_MIN, CARBS_G, EATING_MIN, st.floats(0.0, 300.0), st.sampled_from([1.0, 5.0, 15.0]))
def test_moments_are_those_of_quadrature_between_jumps(model, t_min, carbs_g, eating_min, start, step_min):
    meal = one_meal(model, t_min, carbs_g, eating_min)
    jumps = np.asarray(meal.jumps.t_min)
    inside = np.unique(np.clip(np.r_[jumps, start, start + step_min], start, start + step_min))
    nodes, weights = np.polynomial.legendre.leggauss(20)
    truth = np.zeros(3)
    for begin, end in itertools.pairwise(inside):
        t = begin + (end - begin) * (nodes + 1.0) / 2.0
        rates = np.asarray(appearance(t, meal)) * weights * (end - begin) / 2.0 / step_min
        truth += [
            rates @ np.polynomial.legendre.Legendre.basis(n)(2.0 * (t - start) / step_min - 1.0) for n in range(3)
        ]
    found = moments(np.array([start]), step_min, meal)[0]
    np.testing.assert_allclose(found, truth, rtol=1e-9, atol=1e-9 * (1.0 + carbs_g * 1000.0))


@settings(max_examples=25)
@given(T_MIN, CARBS_G, st.floats(1.0, 600.0))
def test_a_stomach_that_is_full_anyway_does_not_mind_how_fast_one_eats(t_min, carbs_g, eating_min):
    times = t_min + np.arange(0.0, 900.0, 7.0)
    slow, at_once = (appearance(times, one_meal(LehmannDeutsch(), t_min, carbs_g, d)) for d in (eating_min, 0.0))
    if eating_min <= carbs_g / 0.36:
        np.testing.assert_array_equal(slow, at_once)
    else:
        # no more empties than was eaten
        assert np.asarray(slow).max() <= 1000.0 * carbs_g / eating_min + 1e-9


def test_a_meal_of_hovorka_peaks_at_its_time_to_maximum():
    meal = one_meal(HovorkaGut(), 10.0, 50.0, 0.0)
    t = np.array([0.0, 9.99, 49.9, 50.0, 50.1])
    rates = np.asarray(appearance(t, meal))
    np.testing.assert_array_equal(rates[:2], 0.0)
    assert rates[3] == pytest.approx(0.8 * 50_000.0 / 40.0 * np.exp(-1.0), rel=1e-12)
    assert rates[3] > rates[2]
    assert rates[3] > rates[4]


def test_eating_ever_faster_comes_to_eating_at_once():
    times = np.arange(0.0, 300.0, 9.0) + 5.0
    at_once, in_a_minute = (appearance(times, one_meal(HovorkaGut(), 0.0, 50.0, d)) for d in (0.0, 1.0))
    late_by_half = appearance(times - 0.5, one_meal(HovorkaGut(), 0.0, 50.0, 0.0))
    np.testing.assert_allclose(in_a_minute, late_by_half, rtol=1e-2)
    assert np.abs(np.asarray(in_a_minute) - np.asarray(at_once)).max() > 1.0


def test_what_is_ingested_is_the_rate_of_eating():
    rates = appearance(np.array([19.9, 20.0, 34.9, 35.0]), one_meal(Ingestion(), 20.0, 30.0, 15.0))
    np.testing.assert_allclose(rates, [0.0, 2000.0, 2000.0, 0.0])
    rates = appearance(np.array([20.0, 20.9, 21.1]), one_meal(Ingestion(), 20.0, 30.0, 0.0))
    np.testing.assert_allclose(rates, [30_000.0, 30_000.0, 0.0])


def test_models_are_known_by_their_names():
    known = {LehmannDeutsch, HovorkaGut, RoyParkerGut, DallaManGut}
    assert {type(meal_model(name)) for name in MEAL_MODELS} == known
    assert all(isinstance(meal_model(name), MealModel) for name in MEAL_MODELS)
    with pytest.raises(
        ValueError, match=r"^unknown meal model 'dalla-men'; did you mean 'dalla-man'\? the known ones are: leh"
    ):
        meal_model("dalla-men")


def test_a_patient_has_a_gut_of_its_own_or_the_published_one():
    class Eats:
        meal_model = HovorkaGut(time_to_maximum_min=55.0)

    class Digests:
        meal_model = Ingestion()

    assert meal_model_of(object()) == LehmannDeutsch()
    assert meal_model_of(Eats()) == HovorkaGut(time_to_maximum_min=55.0)
    assert meal_model_of(Eats(), LehmannDeutsch()) == LehmannDeutsch()
    assert meal_model_of(Digests()) == Ingestion()
    with pytest.raises(ValueError, match="Digests digests meals in its own states, so no other meal model can feed it"):
        meal_model_of(Digests(), HovorkaGut())


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, np.array([40.0, 0.0])])
def test_an_impossible_meal_model_is_refused(value):
    with pytest.raises(ValueError, match=r"^time_to_maximum_min of .* is not possible for a meal model; give a finite"):
        check_meal_model(HovorkaGut(time_to_maximum_min=value))
