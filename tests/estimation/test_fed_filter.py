"""The filter of a fed person against a Kalman step by hand, in NumPy."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.control.profile_mpc import ProfileMPC
from glucoloop.models.profiled import GutCompartments
from glucoloop.pumps import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS
from glucoloop.simulation import linear_model, nonlinear_model
from glucoloop.therapy import Profile

PATIENT = gl.patient("hovorka-2004")
PROFILE = Profile(basal_mU_min=10.0, setpoint_mg_dl=120.0, carb_ratio_g_U=12.0, correction_mg_dl_U=50.0)


@functools.cache
def designed():
    """The controller whose filter is tried."""
    return ProfileMPC(sensor_error_mg_dl=6.0, measurement_variance=2.0).of_model(
        nonlinear_model(PATIENT),
        linear_model(PATIENT),
        PROFILE,
        PARKER_1999_LIMITS,
        DEFAULT_BOLUS_LIMITS,
    )


predict = jax.jit(lambda estimate, insulin: designed().filter.predict(designed().model, estimate, insulin))
update = jax.jit(lambda estimate, reading, known: designed().filter.update(designed().model, estimate, reading, known))


def some():
    """An estimate amid a meal."""
    estimate = designed().filter.announce(designed().filter.init(designed().model), jnp.asarray(50.0))
    for insulin, reading in ((300.0, 121.0), (0.0, 126.0), (0.0, 137.0)):
        estimate = update(predict(estimate, jnp.asarray(insulin)), jnp.asarray(reading), jnp.asarray(True))
    return estimate


def vector(estimate):
    """Gut, disturbance, error of the sensor, log time of the gut, and fed states."""
    others = estimate.disturbance_mg_min, estimate.sensor_mg_dl, estimate.log_gut_time
    return np.array([*estimate.gut_mg, *others, *estimate.x[:3]], np.float64)


def with_vector(estimate, v):
    return dataclasses.replace(
        estimate,
        x=jnp.concatenate([jnp.asarray(v[5:]), estimate.x[3:]]),
        gut_mg=jnp.asarray(v[:2]),
        disturbance_mg_min=jnp.asarray(v[2]),
        sensor_mg_dl=jnp.asarray(v[3]),
        log_gut_time=jnp.asarray(v[4]),
    )


def test_the_covariance_goes_on_as_that_of_the_transition_itself():
    estimate, insulin = some(), jnp.asarray(4.0)
    v = vector(estimate)
    F = np.empty((8, 8))
    for i in range(8):
        h = 1e-4 * max(1.0, abs(v[i]))
        ends = [vector(predict(with_vector(estimate, v + sign * h * np.eye(8)[i]), insulin)) for sign in (1.0, -1.0)]
        F[:, i] = (ends[0] - ends[1]) / (2.0 * h)
    settings = ProfileMPC()
    Q = np.diag(
        [
            (1000.0 * settings.meal_noise_g) ** 2,
            0.0,
            settings.disturbance_noise_mg_min**2,
            0.51 * 36.0,
            0.0,
            0.0,
            0.0,
            0.0,
        ]
    )
    # further appearance comes in as a disturbance does, for one sample
    flux = F[5:, 2]
    Q[5:, 5:] = settings.glucose_noise_mg_min**2 * np.outer(flux, flux)
    later = predict(estimate, insulin)
    wanted = F @ np.asarray(estimate.covariance) @ F.T + Q
    size = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(later.covariance / np.outer(size, size), wanted / np.outer(size, size), atol=1e-5)


def test_a_reading_corrects_as_the_formula_of_kalman_says():
    estimate = predict(some(), jnp.asarray(4.0))
    P, v = np.asarray(estimate.covariance), vector(estimate)
    C = np.zeros(8)
    C[5] = 18.016 / (float(PATIENT.parameters.V_G) * float(PATIENT.parameters.weight_kg))
    C[3] = 1.0
    K = P @ C / (C @ P @ C + 2.0)
    corrected, wanted = update(estimate, jnp.asarray(150.0), jnp.asarray(True)), v + K * (150.0 - C @ v)
    np.testing.assert_allclose(np.delete(vector(corrected), 4), np.delete(wanted, 4), rtol=1e-9)
    assert float(corrected.log_gut_time) == pytest.approx(np.clip(wanted[4], -1.0, 0.0))
    np.testing.assert_allclose(corrected.covariance, P - np.outer(K, C @ P), rtol=1e-6, atol=1e-9)


def test_the_first_reading_tells_glucose_at_the_start():
    """All states of glucose move by one share, as a scalar Kalman gain has it."""
    filter_, model = designed().filter, designed().model
    estimate = filter_.init(model)
    rest = np.asarray(estimate.x[:3])
    corrected = update(estimate, jnp.asarray(160.0), jnp.asarray(True))
    uncertain = 40.0**2
    moved = 40.0 * uncertain / (uncertain + 36.0 + 2.0)
    np.testing.assert_allclose(np.asarray(corrected.x[:3]) / rest, 1.0 + moved / 120.0, rtol=1e-6)
    np.testing.assert_array_equal(corrected.x[3:], estimate.x[3:])
    assert float(np.abs(corrected.gut_mg).max()) == 0.0


def test_without_a_reading_nothing_is_corrected():
    estimate = some()
    left = update(estimate, jnp.asarray(np.nan), jnp.asarray(False))
    jax.tree.map(np.testing.assert_array_equal, left, estimate)


def test_an_announced_meal_enters_the_gut_with_the_error_of_counting():
    before = designed().filter.init(designed().model)
    after = designed().filter.announce(before, jnp.asarray(60.0))
    np.testing.assert_allclose(after.gut_mg, [60_000.0, 0.0])
    assert float(after.gut_error_mg) == pytest.approx(0.3 * 60_000.0)
    assert float(before.gut_error_mg) == 0.0


def test_readings_of_a_smaller_meal_take_back_what_was_announced():
    """Glucose that rises half as fast as announced, read exactly, halves the meal within two hours."""
    real = designed().filter.announce(designed().filter.init(designed().model), jnp.asarray(30.0))
    believed = designed().filter.announce(designed().filter.init(designed().model), jnp.asarray(60.0))
    basal = jnp.asarray(10.0)
    for _ in range(12):
        real, believed = predict(real, basal), predict(believed, basal)
        believed = update(believed, designed().model.glucose_mg_dl(real.x), jnp.asarray(True))
    assert float(jnp.sum(believed.gut_mg)) == pytest.approx(float(jnp.sum(real.gut_mg)), rel=0.35)
    assert float(designed().model.glucose_mg_dl(believed.x)) == pytest.approx(
        float(designed().model.glucose_mg_dl(real.x)), abs=6.0
    )


@pytest.mark.parametrize(("minutes", "learned"), [(20.0, 20.0), (36.0, 36.0), (60.0, 36.0)])
def test_the_time_of_a_gut_is_learned_but_never_taken_to_be_longer_than_usual(minutes, learned):
    """Four meals of a person whose gut has another time, announced and read exactly, while insulin stays as it is."""
    gut, basal = GutCompartments(time_to_peak_min=minutes), jnp.asarray(10.0)
    real = dataclasses.replace(designed().filter, gut=gut)
    truth, estimate = real.init(designed().model), designed().filter.init(designed().model)
    real_predict = jax.jit(lambda estimate: real.predict(designed().model, estimate, basal))
    for sample in range(4 * 72):
        if sample % 72 == 0:
            truth, estimate = (
                real.announce(truth, jnp.asarray(40.0)),
                designed().filter.announce(estimate, jnp.asarray(40.0)),
            )
        truth, estimate = real_predict(truth), predict(estimate, basal)
        estimate = update(estimate, designed().model.glucose_mg_dl(truth.x), jnp.asarray(True))
    assert float(designed().filter.gut_of(estimate).time_to_peak_min) == pytest.approx(learned, rel=0.1)
