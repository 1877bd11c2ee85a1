import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from glucoloop.sensors import SENSORS, CorrelatedNoise, IdealSensor, Lag, dead_time, white_noise

N = 20_000
KEYS = jax.random.split(jax.random.key(7), N)


def errors(sensor):
    """What the sensor adds to 100 mg/dl, for many keys."""
    state = sensor.init(jnp.asarray(100.0), jax.random.key(0))
    return np.asarray(jax.vmap(lambda key: sensor.read(state, jnp.asarray(100.0), key)[1].glucose_mg_dl)(KEYS)) - 100.0


def readings(sensor, glucose, keys):
    state, told = sensor.init(jnp.asarray(glucose[0]), jax.random.key(9)), []
    for value, key in zip(glucose, keys, strict=True):
        state, reading = sensor.read(state, jnp.asarray(value), key)
        assert bool(reading.valid)
        told.append(float(reading.glucose_mg_dl))
    return np.array(told)


def test_noise_has_its_variance_and_no_mean():
    noise = errors(white_noise(1.45))  # the bound lies beyond four standard deviations
    assert abs(noise.mean()) < 5.0 * np.sqrt(1.45 / N)
    assert abs(noise.var() - 1.45) < 5.0 * 1.45 * np.sqrt(2.0 / N)
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 5.0 / np.sqrt(N)
    assert scipy.stats.kstest(noise, scipy.stats.norm(scale=np.sqrt(1.45)).cdf).pvalue > 1e-6


def test_noise_keeps_its_bound():
    noise = errors(white_noise(25.0, 2.0))
    assert np.abs(noise).max() == pytest.approx(2.0, abs=1e-13)
    beyond = 2.0 * scipy.stats.norm.sf(2.0 / 5.0)
    assert abs(np.mean(np.abs(noise) > 2.0 - 1e-12) - beyond) < 5.0 * np.sqrt(beyond * (1.0 - beyond) / N)


def test_correlated_noise_is_stationary_with_its_variance_and_correlation():
    sensor = CorrelatedNoise(9.0, 0.7)

    def three(key):
        state, told = sensor.init(jnp.asarray(100.0), key), []
        for k in range(3):
            state, reading = sensor.read(state, jnp.asarray(100.0), jax.random.fold_in(key, k))
            told.append(reading.glucose_mg_dl - 100.0)
        return jnp.stack(told)

    noise = np.asarray(jax.vmap(three)(KEYS))
    covariance = noise.T @ noise / N
    np.testing.assert_allclose(covariance, 9.0 * 0.7 ** np.abs(np.subtract.outer(range(3), range(3))), atol=0.5)
    assert np.abs(noise.mean(axis=0)).max() < 5.0 * 3.0 / np.sqrt(N)


def test_a_correlation_of_1_is_refused():
    with pytest.raises(ValueError, match="correlation is 1; give a number of 0 or more and below 1"):
        CorrelatedNoise(9.0, 1.0)


def test_a_sensor_behind_a_lag_reads_late_and_its_noise_does_not_lag():
    glucose = np.append(80.0, np.full(19, 110.0))
    sensor = SENSORS.choose("lag, lag_min=8").made(inner=white_noise(0.25), sample_time_min=5.0)
    quiet = readings(Lag(8.0, sample_time_min=5.0), glucose, KEYS[:20])
    after = np.arange(19)
    # a rise that takes one sample, and then the rest of a lag
    first = 1.0 - 8.0 / 5.0 * (1.0 - np.exp(-5.0 / 8.0))
    np.testing.assert_allclose(quiet[1:], 110.0 - 30.0 * (1.0 - first) * np.exp(-5.0 / 8.0 * after), rtol=1e-12)
    alone = readings(white_noise(0.25), np.full(20, 80.0), KEYS[:20]) - 80.0
    np.testing.assert_allclose(readings(sensor, glucose, KEYS[:20]) - quiet, alone, atol=1e-9)


@pytest.mark.parametrize("lag_min", [0.0, -1.0, 121.0, np.nan, np.inf])
def test_what_is_no_lag_of_a_sensor_is_refused(lag_min):
    with pytest.raises(ValueError, match=r"lag_min is .* min; give a number above 0 min and up to 120 min"):
        Lag(lag_min)


def test_a_lag_needs_a_sample_time():
    with pytest.raises(ValueError, match="a sample time of 0 min is not possible; give a finite value above 0"):
        Lag(10.0, sample_time_min=0.0)


def test_without_variance_there_is_no_noise():
    np.testing.assert_array_equal(errors(white_noise(0.0)), 0.0)


def test_a_key_gives_one_reading_and_another_gives_another():
    noise = errors(white_noise())
    np.testing.assert_array_equal(noise, errors(white_noise()))
    assert len(np.unique(noise)) > N - 10


def test_the_ideal_sensor_tells_the_truth():
    glucose = np.array([81.1, 120.0, 60.0])
    np.testing.assert_array_equal(readings(IdealSensor(), glucose, KEYS[:3]), glucose)


@pytest.mark.parametrize("glucose", [np.nan, np.inf])
def test_the_ideal_sensor_does_not_stand_by_what_is_not_a_number(glucose):
    _, reading = IdealSensor().read((), jnp.asarray(glucose), KEYS[0])
    assert not bool(reading.valid)


@pytest.mark.parametrize("samples", [0, 1, 3])
def test_dead_time_shifts_the_readings(samples):
    glucose = np.arange(80.0, 90.0)
    told = readings(dead_time(samples), glucose, KEYS[:10])
    np.testing.assert_array_equal(told, np.r_[np.full(samples, 80.0), glucose][:10])


def test_dead_times_add_up():
    glucose = np.arange(80.0, 90.0)
    np.testing.assert_array_equal(
        readings(dead_time(1, dead_time(2)), glucose, KEYS[:10]), readings(dead_time(3), glucose, KEYS[:10])
    )


def test_noise_before_a_dead_time_is_as_old_as_its_reading():
    glucose = np.arange(80.0, 90.0)
    noisy = readings(white_noise(), glucose, KEYS[:10])
    told = readings(dead_time(3, white_noise()), glucose, KEYS[:10])
    np.testing.assert_array_equal(told, np.r_[[80.0] * 3, noisy[:7]])


def test_noise_after_a_dead_time_is_that_of_the_moment():
    glucose = np.arange(80.0, 90.0)
    noise = readings(white_noise(), glucose, KEYS[:10]) - glucose
    told = readings(white_noise(inner=dead_time(3)), glucose, KEYS[:10])
    np.testing.assert_allclose(told, np.r_[[80.0] * 3, glucose[:7]] + noise, rtol=1e-14)


def test_readings_of_a_cohort_are_those_asked_for():
    glucose = jnp.array([80.0, 120.0, 200.0])
    sensor = dead_time(1, white_noise(1.45))
    state = sensor.init(glucose, KEYS[0])
    state, first = sensor.read(state, glucose + 5.0, KEYS[1])
    state, second = sensor.read(state, glucose, KEYS[2])
    np.testing.assert_array_equal(first.glucose_mg_dl, glucose)
    noise = np.asarray(second.glucose_mg_dl - glucose - 5.0)
    assert len(np.unique(noise)) == 3
    assert np.all(np.abs(noise) <= 5.0)


@pytest.mark.parametrize("variance", [-1.0, np.nan, np.inf])
def test_an_impossible_variance_is_refused(variance):
    with pytest.raises(ValueError, match=r"variance is .*; give a number from 0 to 10000"):
        white_noise(variance)


@pytest.mark.parametrize("bound", [0.0, -1.0, np.nan])
def test_an_impossible_bound_is_refused(bound):
    with pytest.raises(ValueError, match=r"bound_mg_dl is .*; give a number above 0"):
        white_noise(1.45, bound)


@pytest.mark.parametrize("samples", [-1, 1.5, True, 289, "2"])
def test_an_impossible_dead_time_is_refused(samples):
    with pytest.raises(ValueError, match="give a whole number"):
        dead_time(samples)
