import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.estimation import (
    KalmanState,
    filter_gain,
    kalman_step,
    predict,
    riccati_step,
    steady_state_covariance,
    steady_state_gain,
    update,
)


def a_model(seed, n=4, radius=0.95):
    rng = np.random.default_rng(seed)
    Phi = rng.normal(size=(n, n))
    Phi *= radius / np.abs(np.linalg.eigvals(Phi)).max()
    root = rng.normal(size=(n, n))
    return Phi, rng.normal(size=n), root @ root.T, 1.45


# Design


@pytest.mark.parametrize("seed", range(5))
def test_the_gain_agrees_with_python_control_and_scipy(seed):
    Phi, C, Q, R = a_model(seed)
    design = steady_state_gain(Phi, C, Q, R)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # python-control's own use of NumPy
        import control  # of a second, which the collection need not take

        L, P, _ = control.dlqe(Phi, np.eye(4), C[None], Q, np.array([[R]]))
    np.testing.assert_allclose(design.prediction_covariance, P, rtol=1e-8)
    # dlqe gives the gain of the predictor form, Phi K.
    np.testing.assert_allclose(Phi @ design.gain, L[:, 0], rtol=1e-8, atol=1e-10)
    truth = scipy.linalg.solve_discrete_are(Phi.T, C[:, None], Q, np.array([[R]]))
    np.testing.assert_allclose(design.prediction_covariance, truth, rtol=1e-9)
    np.testing.assert_allclose(design.innovation_covariance, C @ truth @ C + R, rtol=1e-9)


def test_two_sensors_agree_with_the_information_form():
    Phi, C, Q, R = a_model(7)
    rows, noise = np.stack([C, np.ones(4)]), np.array([[R, 0.3], [0.3, 0.8]])
    design = steady_state_gain(Phi, rows, Q, noise)
    P = np.asarray(design.prediction_covariance)
    posterior = np.linalg.inv(np.linalg.inv(P) + rows.T @ np.linalg.solve(noise, rows))
    np.testing.assert_allclose(design.filtered_covariance, posterior, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(design.gain, posterior @ rows.T @ np.linalg.inv(noise), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(P, Phi @ posterior @ Phi.T + Q, rtol=1e-9)


def test_a_scalar_noise_counts_for_every_sensor():
    Phi, C, Q, R = a_model(8)
    rows = np.stack([C, np.ones(4)])
    np.testing.assert_allclose(
        steady_state_gain(Phi, rows, Q, R).gain, steady_state_gain(Phi, rows, Q, R * np.eye(2)).gain
    )


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**16),
    st.integers(1, 8),
    st.floats(0.05, 1.2),
    st.sampled_from([1e-3, 0.1, 10.0]),
    st.sampled_from([1e-2, 1.0, 100.0]),
)
def test_the_filter_is_stable_and_its_covariances_are_such(seed, n, radius, process, R):
    Phi, C, Q, _ = a_model(seed, n, radius)
    Q = process * (Q / np.trace(Q) + 0.01 * np.eye(n))
    design = steady_state_gain(Phi, C, Q, R)
    K, P, after = (np.asarray(a) for a in (design.gain, design.prediction_covariance, design.filtered_covariance))
    assert np.abs(np.linalg.eigvals((np.eye(n) - np.outer(K, C)) @ Phi)).max() < 1
    for covariance in (P, after, P - after):
        assert np.linalg.eigvalsh(covariance)[0] >= -1e-9 * np.abs(P).max()
    np.testing.assert_allclose(riccati_step(P, Phi, C, Q, R), P, rtol=0, atol=1e-7 * np.abs(P).max())
    np.testing.assert_allclose(filter_gain(P, C, R), K, rtol=0, atol=1e-9 * np.abs(K).max())


def test_without_process_noise_a_stable_model_needs_no_sensor():
    Phi, C, _, R = a_model(1)
    np.testing.assert_allclose(steady_state_gain(Phi, C, np.zeros((4, 4)), R).gain, 0.0, atol=1e-12)


I2 = np.eye(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.ones((2, 3)), [1.0, 0.0], I2, 1.0), "Phi must be square"),
        ((0.5 * I2, [1.0, 0.0, 0.0], I2, 1.0), "C must be"),
        ((0.5 * I2, [1.0, 0.0], np.eye(3), 1.0), "Q must be"),
        ((0.5 * I2, [1.0, 0.0], I2, I2), "R must be a scalar"),
        ((0.5 * I2, [1.0, 0.0], [[1.0, 0.5], [0.0, 1.0]], 1.0), "Q must be symmetric"),
        ((0.5 * I2, I2, I2, [[1.0, 0.5], [0.0, 1.0]]), "R must be symmetric"),
        ((0.5 * I2, [1.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], 1.0), "Q must be positive semi-definite"),
        ((0.5 * I2, [1.0, 0.0], I2, 0.0), "R must be positive definite"),
        ((0.5 * I2, [1.0, 0.0], I2, -1.0), "R must be positive definite"),
        ((0.5 * I2, I2, I2, [[1.0, 1.0], [1.0, 1.0]]), "R must be positive definite"),
        ((np.nan * I2, [1.0, 0.0], I2, 1.0), "Phi must be finite"),
        ((0.5 * I2, [np.inf, 0.0], I2, 1.0), "C must be finite"),
        ((0.5 * I2, [1.0, 0.0], np.nan * I2, 1.0), "Q must be finite"),
        ((0.5 * I2, [1.0, 0.0], I2, np.nan), "R must be finite"),
        ((np.diag([0.5, 1.1]), [1.0, 0.0], I2, 1.0), "no stabilising solution"),
        ((np.diag([0.5, 1.0]), [1.0, 0.0], I2, 1.0), "no stabilising solution"),
        ((np.diag([0.5, 1.0]), [1.0, 1.0], np.diag([1.0, 0.0]), 1.0), "no stabilising solution"),
    ],
)
def test_a_design_that_cannot_be_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        steady_state_gain(*arguments)


# At every sample


@pytest.mark.parametrize("radius", [0.3, 0.954, 1.1])
def test_doubling_agrees_with_the_design(radius):
    Phi, C, Q, R = a_model(2, 19, radius)
    truth = np.asarray(steady_state_gain(Phi, C, Q, R).prediction_covariance)
    found = jax.jit(steady_state_covariance)(Phi, C, Q, R)
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-9 * np.abs(truth).max())
    np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("seed", range(5))
def test_what_a_doubling_adds_bounds_all_that_is_missing(seed):
    Phi, C, Q, R = a_model(seed, 6, 0.9)
    Q = Q + 0.01 * np.eye(6)
    steady = np.asarray(steady_state_gain(Phi, C, Q, R).prediction_covariance)
    covariances = [np.zeros((6, 6))]
    for _ in range(32):
        covariances.append(np.asarray(riccati_step(covariances[-1], Phi, C, Q, R)))
    for steps in (4, 8, 16):
        before, after = covariances[steps], covariances[2 * steps]
        added = scipy.linalg.eigh(after - before, before, eigvals_only=True)[-1]
        missing = scipy.linalg.eigh(steady - after, before, eigvals_only=True)[-1]
        assert added < 1.0
        assert missing <= added**2 / (1.0 - added) + 1e-12


@pytest.mark.long
def test_doublings_stand_for_steps_of_the_riccati_equation():
    Phi, C, Q, R = a_model(3)
    P = np.zeros((4, 4))
    for _ in range(8):
        P = riccati_step(P, Phi, C, Q, R)
    np.testing.assert_allclose(steady_state_covariance(Phi, C, Q, R, doublings=3), P, rtol=1e-10)
    with pytest.raises(ValueError, match="At least 1 doubling"):
        steady_state_covariance(Phi, C, Q, R, doublings=0)


def a_record(seed, samples=6):
    Phi, C, Q, R = a_model(seed, 3)
    rng = np.random.default_rng(seed)
    forcing, readings = rng.normal(size=(samples, 3)), rng.normal(size=samples)
    root = rng.normal(size=(3, 3))
    return Phi, C, Q, R, forcing, readings, rng.normal(size=3), root @ root.T


@pytest.mark.parametrize("seed", range(3))
def test_the_filter_is_the_posterior_of_the_whole_record(seed):
    """All states and readings are jointly normal: condition the last state on the readings in one step."""
    Phi, C, Q, R, forcing, readings, mean, P = a_record(seed)
    seen = [0, 1, 3, 4, 5]  # the reading at sample 2 is missing
    state = KalmanState(mean=jnp.asarray(mean), covariance=jnp.asarray(P))
    means, moments = [mean], {(0, 0): P}
    for k in range(len(readings)):
        if k == 0:
            state, _ = update(state, readings[0], C, R)
            continue
        state, _ = kalman_step(state, readings[k], Phi, C, Q, R, forcing=forcing[k - 1], valid=k in seen)
        means.append(Phi @ means[-1] + forcing[k - 1])
        for j in range(k):
            moments[k, j] = Phi @ moments[k - 1, j]
            moments[j, k] = moments[k, j].T
        moments[k, k] = Phi @ moments[k - 1, k - 1] @ Phi.T + Q
    last = len(readings) - 1
    cross = np.stack([moments[last, j] @ C for j in seen], axis=1)
    among = np.array([[C @ moments[i, j] @ C for j in seen] for i in seen]) + R * np.eye(len(seen))
    surprise = np.array([readings[j] - C @ means[j] for j in seen])
    np.testing.assert_allclose(state.mean, means[last] + cross @ np.linalg.solve(among, surprise), rtol=1e-9)
    np.testing.assert_allclose(
        state.covariance, moments[last, last] - cross @ np.linalg.solve(among, cross.T), rtol=1e-8, atol=1e-10
    )


def test_a_long_run_settles_at_the_design():
    Phi, C, Q, R = a_model(5)
    design = steady_state_gain(Phi, C, Q, R)

    def step(state, reading):
        return kalman_step(state, reading, Phi, C, Q, R)

    start = KalmanState(mean=jnp.zeros(4), covariance=100 * jnp.eye(4))
    end, innovations = jax.jit(lambda: jax.lax.scan(step, start, jnp.ones(300)))()
    np.testing.assert_allclose(innovations.gain[-1], design.gain, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(end.covariance, design.filtered_covariance, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(innovations.variance[-1], design.innovation_covariance, rtol=1e-9)


@pytest.mark.parametrize("reading", [np.nan, np.inf])
def test_a_reading_that_is_none_changes_nothing(reading):
    _, C, _, R, _, _, mean, P = a_record(0)
    before = KalmanState(mean=jnp.asarray(mean), covariance=jnp.asarray(P))
    after, innovation = update(before, reading, C, R)
    np.testing.assert_array_equal(after.mean, mean)
    np.testing.assert_array_equal(after.covariance, P)
    assert innovation.error == 0
    assert not np.any(innovation.gain)


def test_an_almost_exact_reading_leaves_a_covariance():
    rng = np.random.default_rng(0)
    for _ in range(50):
        root = rng.normal(size=(5, 5)) * 10.0 ** rng.uniform(-3, 3, 5)
        state = KalmanState(mean=jnp.zeros(5), covariance=jnp.asarray(root @ root.T))
        after, _ = update(state, 1.0, rng.normal(size=5), 1e-12)
        smallest = np.linalg.eigvalsh(after.covariance)[0]
        assert smallest >= -1e-14 * np.linalg.eigvalsh(state.covariance)[-1]


@pytest.mark.long
@pytest.mark.parametrize("shared", ["nothing", "model", "covariance", "mean"])
def test_a_cohort_is_its_people(shared):
    people = [a_record(seed) for seed in range(4)]
    if shared == "model":
        people = [(*people[0][:4], *person[4:]) for person in people]
    if shared == "covariance":
        people = [(*people[0][:4], *person[4:7], people[0][7]) for person in people]
    if shared == "mean":
        people = [(*person[:6], *people[0][6:]) for person in people]

    def stacked(i):
        values = [np.asarray(person[i]) for person in people]
        return values[0] if all(np.array_equal(v, values[0]) for v in values) else np.stack(values, axis=-1)

    Phi, C, Q, R, forcing, readings, mean, P = (stacked(i) for i in range(8))
    valid = np.array([True, False, True, True])
    state, innovation = kalman_step(
        KalmanState(mean=jnp.asarray(mean), covariance=jnp.asarray(P)),
        readings[1],
        Phi,
        C,
        Q,
        R,
        forcing=forcing[0],
        valid=valid,
    )
    P_next = riccati_step(P, Phi, C, Q, R)
    steady = steady_state_covariance(Phi, C, Q, R)
    gain = filter_gain(P, C, R)

    def one(array, i, rank):
        return array[..., i] if array.ndim > rank else array

    for i, (Phi, C, Q, R, forcing, readings, mean, P) in enumerate(people):
        alone, told = kalman_step(
            KalmanState(mean=jnp.asarray(mean), covariance=jnp.asarray(P)),
            readings[1],
            Phi,
            C,
            Q,
            R,
            forcing=forcing[0],
            valid=valid[i],
        )
        close = {"rtol": 1e-9, "atol": 1e-10}
        np.testing.assert_allclose(state.mean[:, i], alone.mean, **close)
        np.testing.assert_allclose(one(state.covariance, i, 2), alone.covariance, **close)
        np.testing.assert_allclose(innovation.error[i], told.error, **close)
        np.testing.assert_allclose(one(P_next, i, 2), riccati_step(P, Phi, C, Q, R), **close)
        np.testing.assert_allclose(one(steady, i, 2), steady_state_covariance(Phi, C, Q, R), **close)
        np.testing.assert_allclose(one(gain, i, 1), filter_gain(P, C, R), **close)


@pytest.mark.long
def test_each_person_has_an_own_sensor_noise():
    Phi, C, Q, _ = a_model(4)
    noises = np.array([0.5, 1.45, 9.0])
    together = steady_state_covariance(Phi, C, Q, noises)
    for i, R in enumerate(noises):
        np.testing.assert_allclose(together[..., i], steady_state_covariance(Phi, C, Q, R), rtol=1e-10)
        step = riccati_step(together, Phi, C, Q, noises)
        np.testing.assert_allclose(step[..., i], together[..., i], rtol=1e-8, atol=1e-9)


def test_a_prediction_without_input_is_the_transition():
    Phi, _, Q, _, _, _, mean, P = a_record(1)
    after = predict(KalmanState(mean=jnp.asarray(mean), covariance=jnp.asarray(P)), Phi, Q)
    np.testing.assert_allclose(after.mean, Phi @ mean, rtol=1e-13)
    np.testing.assert_allclose(after.covariance, Phi @ P @ Phi.T + Q, rtol=1e-12)
