"""Meals found by enumeration: Bayes' rule by hand, a true meal, and readings that are none."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.estimation.noise_level import LEVELS_MG_DL
from glucoloop.estimation.unknown_meal import MealHabits, Sensed, design_meal_horizon
from glucoloop.estimation.unknown_meal.expectation import expectation
from glucoloop.meals.stomach import FAST_GUT_MIN, digest, empty_stomach, gut_of

H, N = 5.0, 72
A, G = ((0.92, -0.6), (0.0, 0.8)), (0.04, 0.0)  # of the person in conftest.py
RARE = MealHabits(0.05, 36.0)
STEPS = jax.jit(
    lambda model, estimator, first, sensed: jax.lax.scan(
        lambda state, entry: (lambda new, told: (new, (told, jnp.sum(new.probability, axis=0))))(
            *estimator.step(model, state, entry)
        ),
        estimator.init(model, first),
        sensed,
    )[1]
)


def told(model, estimator, readings, insulin=None, reported=True):
    """Estimates and probabilities along a record that begins at steady state; fewer than N readings are missing."""
    short = N - np.size(readings)
    readings = np.append(np.asarray(readings, float), np.full(short, np.nan))
    insulin = np.full(N, float(model.insulin_mU_min)) if insulin is None else np.append(insulin, np.full(short, 20.0))
    known = np.isfinite(readings)
    sensed = Sensed(
        glucose_mg_dl=jnp.asarray(np.where(known, readings, 0.0)),
        known=jnp.asarray(known),
        insulin_mU_min=jnp.asarray(insulin),
        reported=jnp.broadcast_to(jnp.asarray(reported), N),
        announced_carbs_g=jnp.zeros(N),
    )
    first = Sensed(
        glucose_mg_dl=model.glucose_mg_dl(model.state),
        known=jnp.asarray(True),
        insulin_mU_min=model.insulin_mU_min,
        reported=jnp.asarray(True),
        announced_carbs_g=jnp.zeros(()),
    )
    return STEPS(model, estimator, first, sensed)


# Bayes' rule, by hand -------------------------------------------------------------------------------------------------


def by_hand(linear, appears, readings, insulin, begins, ends, disturbance_variance, R):
    """Probability of a meal after each reading: every history followed to its own end, none merged."""
    A, B, G = map(np.asarray, linear)
    Phi = np.block([[A, G[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    C, Q = np.array([1.0, 0.0, 0.0]), np.diag([0.0, 0.0, disturbance_variance])
    P = scipy.linalg.solve_discrete_are(Phi.T, C[:, None], Q, np.array([[R]]))
    S = C @ P @ C + R
    gain = P @ C / S
    told = []
    for n in range(1, len(readings) + 1):
        weight = {}
        for eaten in itertools.product((0, 1), repeat=n):
            x, d, p = np.zeros(2), 0.0, 1.0
            for k in range(n):
                before = eaten[k - 1] if k else 0
                probability = ends if before else begins
                p *= probability if eaten[k] != before else 1.0 - probability
                x = A @ x + B * (insulin[k] - 20.0) + G * (appears(eaten, k) + d)
                innovation = readings[k] - 80.0 - x[0]
                p *= np.exp(-0.5 * innovation**2 / S) + 1e-3
                x, d = x + gain[:2] * innovation, d + gain[2] * innovation
            weight[eaten] = p
        total = sum(weight.values())
        told.append(sum(p for eaten, p in weight.items() if eaten[-1]) / total)
    return np.array(told)


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(3)
    rise = np.array([0.0, 0.0, 0.0, 0.4, 1.6, 3.6, 6.2, 9.0])
    return 80.0 + rise + rng.normal(0.0, 0.8, rise.size), 20.0 + rng.choice([-3.0, 3.0], rise.size)


@pytest.mark.long
@pytest.mark.parametrize(
    ("habits", "samples"),
    [
        (MealHabits(0.6, 1e9), 8),  # a meal that has begun goes on, so that one history stands for each hypothesis
        (MealHabits(3.0, 6.0), 2),  # the four histories of two samples are four hypotheses
    ],
)
def test_probabilities_are_those_of_all_histories(two_states, linear, appears, record, habits, samples):
    readings, insulin = (values[:samples] for values in record)
    as_told = {
        "noise_drift": 0.0,
        "largest_disturbance_mg_min": 1e6,
        "failures_per_h": 0.0,
        "fast_meals": 0.0,
        "horizon": 10,
    }
    estimator = design_meal_horizon(two_states, habits, disturbance_variance=4.0, measurement_variance=0.7, **as_told)
    estimate, _ = told(two_states, estimator, readings, insulin)
    truth = by_hand(linear, appears, readings, insulin, habits.begins(H), habits.ends(H), 4.0, 0.7)
    np.testing.assert_allclose(estimate.eating[:samples], truth, rtol=0, atol=1e-6)
    assert samples == 2 or truth[-1] > 0.5 > truth[0]  # the record tells of a meal


# Readings of any kind -------------------------------------------------------------------------------------------------

any_reading = st.one_of(
    st.floats(40.0, 400.0), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -50.0, 1e6, -1e6, 1e300])
)


def test_a_bound_on_the_disturbance_is_above_0(two_states):
    with pytest.raises(ValueError, match="a largest disturbance of 0 mg/min is not possible"):
        design_meal_horizon(two_states, largest_disturbance_mg_min=0.0)


@pytest.mark.long
@given(st.lists(any_reading, min_size=24, max_size=24), st.sampled_from([0.0, 20.0, 67.0, 1e4]))
@settings(max_examples=30)
def test_any_readings_leave_probabilities(two_states, readings, insulin):
    estimator = design_meal_horizon(two_states)
    estimate, probability = told(two_states, estimator, readings, np.full(24, insulin))
    np.testing.assert_allclose(probability.sum(axis=1), 1.0, rtol=1e-12)
    assert (probability > 0.0).all()
    for leaf in jax.tree.leaves(estimate):
        assert np.isfinite(leaf).all()
    assert (estimate.carbs_g >= 0.0).all()
    assert (estimate.carbs_g <= N * 1.8 + 1e-9).all()


@pytest.mark.long
def test_much_insulin_without_an_effect_is_not_met_with_glucose(two_states):
    """Readings rise far above the model under three times the basal rate: the disturbance stays within its bound."""
    readings = 80.0 + np.minimum(np.arange(N), 24.0) * 5.0

    def largest(bound):
        estimator = design_meal_horizon(two_states, RARE, largest_disturbance_mg_min=bound, failures_per_h=0.0)
        return np.asarray(told(two_states, estimator, readings, np.full(N, 60.0))[0].disturbance_mg_min).max()

    assert largest(40.0) <= 40.0 + 1e-9
    assert largest(1e6) > 60.0


# Insulin that does not arrive -----------------------------------------------------------------------------------------

BLOCKED = slice(20, 44)


def without_insulin(record_of, told_of):
    """Readings of somebody who gets none of the insulin that the pump tells of, for two hours."""
    arrived = np.array(told_of)
    arrived[BLOCKED] = 0.0
    return record_of(np.zeros(N), arrived) + np.random.default_rng(7).normal(0.0, 1.2, N)


@pytest.mark.parametrize("rate", [40.0, 60.0])
def test_insulin_that_does_not_arrive_is_found_and_is_not_on_board(two_states, record_of, rate):
    insulin = np.full(N, 20.0)
    insulin[24:] = rate
    estimate, _ = told(two_states, design_meal_horizon(two_states), without_insulin(record_of, insulin), insulin)
    lost = np.asarray(estimate.lost)
    assert lost[:20].max() < 0.01
    assert lost[36:44].min() > 0.7
    assert lost[50:].max() < 0.1
    # the effect of insulin, which rests at 3, goes to 3 - 20 / 4 / (1 - 0.8) without the basal rate
    effect = np.asarray(estimate.x)[:, 1]
    assert effect[43] < -17.0
    trusting = design_meal_horizon(two_states, failures_per_h=0.0)
    believed, _ = told(two_states, trusting, without_insulin(record_of, insulin), insulin)
    assert np.asarray(believed.x)[43, 1] > 15.0


def test_a_pump_that_reports_nothing_is_doubted_sooner(two_states, record_of):
    reported = np.ones(N, bool)
    reported[BLOCKED] = False
    readings, estimator = without_insulin(record_of, np.full(N, 20.0)), design_meal_horizon(two_states)
    silent, unsaid = (
        np.asarray(told(two_states, estimator, readings, None, said)[0].lost) for said in (reported, True)
    )
    assert silent[BLOCKED].sum() > unsaid[BLOCKED].sum() + 1.0
    assert silent[BLOCKED][2:].min() > 0.9


def test_a_meal_is_not_taken_for_insulin_that_does_not_arrive(two_states, record_of):
    insulin = 20.0 + np.repeat([0.0, 5.0, -5.0], 24)
    estimate, _ = told(two_states, design_meal_horizon(two_states), record_of(served(28), insulin), insulin)
    assert np.asarray(estimate.lost).max() < 0.1


# Meals free of noise --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def quiet(two_states):
    """For readings known to be free of noise, and meals that are rare: what is served for sure is told whole."""
    return design_meal_horizon(
        two_states, RARE, disturbance_variance=0.1, measurement_variance=0.01, noise_drift=0.0, failures_per_h=0.0
    )


def served(samples, begins=10):
    eaten = np.zeros(N)
    eaten[begins : begins + samples] = 1.0
    return eaten


@pytest.mark.parametrize("samples", [3, 12, 28])
def test_a_true_meal_is_found_and_sized(two_states, record_of, quiet, samples):
    insulin = 20.0 + np.repeat([0.0, 5.0, -5.0], 24)
    estimate, _ = told(two_states, quiet, record_of(served(samples), insulin), insulin)
    eating, sized = np.asarray(estimate.eating), np.asarray(estimate.carbs_g)
    assert eating[:10].max() < 0.01
    # the reading at the end of a sample is the first to tell of it
    assert 10 <= np.argmax(eating > 0.5) <= 12
    late = 10 + samples - 1 + 12
    assert sized[late] == pytest.approx(1.8 * samples, abs=1.8)
    assert eating[late] < 0.05


def test_evidence_tells_a_fast_gut_from_the_usual_one(two_states, record_of):
    """Digested at half the time the same food is over sooner, which a record shows long before it ends."""
    insulin, eaten = np.full(N, 20.0), served(10)
    stomach, x, fast = empty_stomach(jnp.zeros(()), H), np.zeros(2), []
    for share in eaten:
        stomach, moments = digest(stomach, jnp.asarray(share), H, gut_of(FAST_GUT_MIN, H))
        x = np.asarray(A) @ x + np.asarray(G) * float(moments[0])
        fast.append(80.0 + x[0])
    estimator = design_meal_horizon(two_states, RARE, measurement_variance=0.1)
    of_fast, of_usual = (told(two_states, estimator, readings)[0] for readings in (fast, record_of(eaten, insulin)))
    assert of_fast.gut_min[18] < 35.0 < 50.0 < of_usual.gut_min[18]
    held = [float(of.stomach.gut_mg[30]) for of in (of_fast, of_usual)]
    assert held[0] < 0.5 * held[1]
    assert 30.0 <= of_fast.gut_min.min() <= of_usual.gut_min.max() <= 60.0


def test_without_readings_a_meal_is_taken_to_end(two_states, record_of, quiet):
    insulin = np.full(N, 20.0)
    estimate, _ = told(two_states, quiet, record_of(served(28), insulin)[:20], insulin[:20])
    eating = np.asarray(estimate.eating)
    assert eating[19] > 0.9
    np.testing.assert_allclose(eating[19:40], eating[19] * 0.7 ** np.arange(21), atol=1e-6)


@pytest.mark.long
def test_the_noisier_the_sensor_the_more_of_a_meal_is_expected_at_rest(two_states):
    expected = expectation(design_meal_horizon(two_states, noise_patience=0.0), two_states)
    assert expected.eating.shape == (len(LEVELS_MG_DL),)
    assert (np.diff(expected.eating) > 0.0).all()
    # but for a patience that expects fewer meals then
    patient = expectation(design_meal_horizon(two_states, noise_patience=0.5), two_states)
    assert (patient.eating[1:] < expected.eating[1:]).all()
    assert patient.eating[0] == expected.eating[0]


def test_what_has_been_served_tells_when_a_meal_began(two_states, record_of, quiet):
    estimate, _ = told(two_states, quiet, record_of(served(28), np.full(N, 20.0)))
    began_min = H * np.arange(14, 38) + H - np.asarray(estimate.carbs_g)[14:38] / 0.36
    np.testing.assert_allclose(began_min, 50.0, atol=2.0 * H)


def test_without_a_meal_nothing_is_found(two_states, record_of, quiet):
    insulin = 20.0 + np.repeat([0.0, 6.0, -6.0, 3.0], 18)
    estimate, _ = told(two_states, quiet, record_of(np.zeros(N), insulin), insulin)
    # a meal that began just now cannot be told from none; one that began some samples ago can
    assert (estimate.eating > 0.9 * RARE.begins(H)).all()
    assert (estimate.eating < 3.0 * RARE.begins(H)).all()
    assert np.abs(estimate.disturbance_mg_min).max() < 2.0


@pytest.mark.parametrize("gap", [slice(5, 12), slice(11, 20), slice(13, 60)])
def test_a_gap_never_makes_a_meal_likelier(two_states, record_of, quiet, gap):
    readings = record_of(served(28), np.full(N, 20.0))
    readings[gap] = np.nan
    eating = np.asarray(told(two_states, quiet, readings)[0].eating)
    assert (np.diff(eating[gap.start - 1 : gap.stop]) <= 1e-9).all()


# Design ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"horizon": 1}, "a meal horizon of 1 samples is not possible; give a whole number from 2 to 100"),
        ({"horizon": 101}, "a meal horizon of 101 samples"),
        ({"horizon": 5.0}, "a meal horizon of 5.0 samples"),
        ({"horizon": True}, "a meal horizon of True samples"),
        ({"disturbance_variance": 0.0}, "a disturbance variance of 0 is not possible; give a finite value above 0"),
        ({"disturbance_variance": np.inf}, "a disturbance variance of inf"),
        ({"measurement_variance": -1.0}, "a measurement variance of -1"),
        ({"measurement_variance": np.nan}, "a measurement variance of nan"),
        ({"noise_patience": -0.1}, "a patience with noise of -0.1 is not possible; give a finite value of 0 or more"),
        ({"failures_per_h": np.inf}, "a rate of failures per hour of inf is not possible"),
        ({"failure_min": 0.0}, "failures of 0 min are not possible; give a finite time above 0"),
    ],
)
def test_a_design_that_cannot_be_is_refused(two_states, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        design_meal_horizon(two_states, **arguments)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"meals_per_h": 0.0}, "0 meals per hour are not possible; give a finite value above 0"),
        ({"meals_per_h": np.nan}, "nan meals per hour"),
        ({"mean_carbs_g": -3.0}, "-3 g of a mean meal"),
        ({"mean_carbs_g": np.inf}, "inf g of a mean meal"),
    ],
)
def test_habits_that_cannot_be_are_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        MealHabits(**arguments)


@pytest.mark.long
def test_probabilities_of_a_sample_follow_from_habits():
    habits = MealHabits(0.6, 36.0)  # a meal of 36 g is served in 100 min
    assert habits.begins(60.0) == pytest.approx(1.0 - np.exp(-0.6))
    assert habits.ends(100.0) == pytest.approx(1.0 - np.exp(-1.0))
