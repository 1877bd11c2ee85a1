"""The emptying of the stomach by an extended Kalman filter, against the textbook's linear one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.estimation.unknown_meal import Sensed, design_meal_kalman

H, T, N = 5.0, 60.0, 72
STEPS = jax.jit(
    lambda model, estimator, first, sensed: jax.lax.scan(
        lambda state, entry: (lambda new, told: (new, (told, new)))(*estimator.step(model, state, entry)),
        estimator.init(model, first),
        sensed,
    )[1]
)


def told(model, estimator, readings, insulin):
    short = N - np.size(readings)
    readings = np.append(np.asarray(readings, float), np.full(short, np.nan))
    known = np.isfinite(readings)
    sensed = Sensed(
        glucose_mg_dl=jnp.asarray(np.where(known, readings, 0.0)),
        known=jnp.asarray(known),
        insulin_mU_min=jnp.asarray(np.append(insulin, np.full(short, 20.0))),
        announced_carbs_g=jnp.zeros(N),
        reported=jnp.ones(N, bool),
    )
    first = Sensed(
        glucose_mg_dl=model.glucose_mg_dl(model.state),
        known=jnp.asarray(True),
        insulin_mU_min=model.insulin_mU_min,
        announced_carbs_g=jnp.zeros(()),
        reported=jnp.ones((), bool),
    )
    return STEPS(model, estimator, first, sensed)


def test_on_a_linear_model_it_is_the_linear_filter(two_states, linear):
    rng = np.random.default_rng(1)
    n = 24
    readings, insulin = 80.0 + np.cumsum(rng.normal(0.0, 1.0, n)), 20.0 + rng.normal(0.0, 2.0, n)
    readings[[4, 9, 10]] = np.nan
    estimator = design_meal_kalman(two_states, emptying_variance=900.0, state_variance=0.02, measurement_variance=1.1)
    _, states = told(two_states, estimator, readings, insulin)

    # x' = f + G q / T over a sample by Simpson's rule, q' = E - q / T, E' = 0
    A, B, G = map(np.asarray, linear)
    half, whole = np.exp(-H / 2.0 / T), np.exp(-H / T)
    of_q = (1.0 + 4.0 * half + whole) / 6.0 / T
    of_E = (4.0 * (1.0 - half) + (1.0 - whole)) / 6.0
    F = np.zeros((4, 4))
    F[:2, :2], F[:2, 2], F[:2, 3] = A, G * of_q, G * of_E
    F[2, 2], F[2, 3], F[3, 3] = whole, T * (1.0 - whole), 1.0
    Q, C = np.diag([0.02, 0.02, 0.02, 900.0]), np.array([1.0, 0.0, 0.0, 0.0])
    m, P = np.zeros(4), np.asarray(estimator.start)
    for k in range(n):
        m = F @ m + np.append(B, [0.0, 0.0]) * (insulin[k] - 20.0)
        P = F @ P @ F.T + Q
        if np.isfinite(readings[k]):
            gain = P @ C / (C @ P @ C + 1.1)
            m, P = m + gain * (readings[k] - 80.0 - m[0]), (np.eye(4) - np.outer(gain, C)) @ P
        np.testing.assert_allclose(states.mean[k] - np.array([80.0, 3.0, 0.0, 0.0]), m, rtol=0, atol=1e-8)
        np.testing.assert_allclose(states.covariance[k], P, rtol=1e-9, atol=1e-9)


@pytest.mark.long
@given(
    st.lists(
        st.one_of(st.floats(40.0, 400.0), st.sampled_from([np.nan, np.inf, -np.inf, -50.0, 1e6, 1e300])),
        min_size=24,
        max_size=24,
    ),
    st.sampled_from([0.0, 20.0, 1e4]),
)
@settings(max_examples=30)
def test_any_readings_leave_an_estimate(two_states, readings, insulin):
    estimate, states = told(two_states, design_meal_kalman(two_states), readings, np.full(24, insulin))
    for leaf in jax.tree.leaves((estimate, states)):
        assert np.isfinite(leaf).all()
    assert (estimate.eating >= 0.0).all()
    assert (estimate.eating <= 1.0).all()
    assert (np.linalg.eigvalsh(states.covariance) >= -1e-6).all()


@pytest.fixture(scope="module")
def quiet(two_states):
    return design_meal_kalman(two_states, measurement_variance=0.01)


@pytest.fixture(scope="module")
def readings(record_of):
    eaten = np.zeros(N)
    eaten[10:38] = 1.0
    return record_of(eaten, np.full(N, 20.0))


def test_a_true_meal_is_found_and_sized(two_states, quiet, readings):
    estimate, _ = told(two_states, quiet, readings, np.full(N, 20.0))
    eating = np.asarray(estimate.eating)
    assert eating[:10].max() < 0.01
    assert 10 <= np.argmax(eating > 0.5) <= 16  # a rate that walks is accepted later than a meal
    emptying = jax.vmap(lambda stomach: stomach.emptying_mg_min)(estimate.stomach)
    np.testing.assert_allclose(emptying[24:37], 360.0, rtol=0.02)
    assert float(estimate.carbs_g[-1]) == pytest.approx(28 * 1.8, abs=1.8)


@pytest.mark.parametrize("gap", [slice(5, 12), slice(13, 20), slice(15, 60)])
def test_a_gap_never_makes_a_meal_likelier(two_states, quiet, readings, gap):
    known = readings.copy()
    known[gap] = np.nan
    eating = told(two_states, quiet, known, np.full(N, 20.0))[0].eating
    assert (np.diff(eating[gap.start - 1 : gap.stop]) <= 1e-9).all()


@pytest.mark.parametrize("name", ["emptying_variance", "state_variance", "measurement_variance"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_a_variance_that_cannot_be_is_refused(two_states, name, value):
    with pytest.raises(ValueError, match=f"variance of {value:g} is not possible; give a finite value above 0"):
        design_meal_kalman(two_states, **{name: value})
