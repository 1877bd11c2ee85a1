"""Continuous glucose monitors against closed forms, other programs, and a plain account of wear and display."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from glucoloop.sensors import SENSORS, CorrelatedNoise, Lag, Reading
from glucoloop.sensors.cgm import (
    Breton2008,
    DexcomG5,
    DexcomG6,
    Display,
    Facchinetti2014,
    Monitor,
    Vettoretti2019,
)
from glucoloop.sensors.cgm.model import Constants, ErrorModel, Process, candidate, constants_of, drawn
from glucoloop.sensors.protocol import IdealSensor
from glucoloop.simulation.engines import make_engine
from other_programs import answer_of

ALIKE = {
    "breton-2008": Breton2008.model,
    "facchinetti-2014": Facchinetti2014.model,
    "dexcom-g5": DexcomG5.model,
    "dexcom-g6": DexcomG6.model,
}
MONITORS = (*ALIKE, "vettoretti-2019")
SPREAD = Vettoretti2019.model.spread
KEY = jax.random.key(5)
DAY_MIN = 1440.0
ALONE = ", lag_min=0, display=false"
"""Settings of a monitor without a lag and a display."""


@functools.partial(jax.jit, static_argnums=3)
def scan(sensor, glucose, key, first=None):
    """Readings of a sensor, with keys as in the loop."""
    own, rest = jax.random.split(key)

    def step(state, entry):
        number, value = entry
        return sensor.read(state, value, jax.random.fold_in(rest, number))

    start = glucose[0] if first is None else jnp.full_like(glucose[0], first)
    return jax.lax.scan(step, sensor.init(start, own), (jnp.arange(glucose.shape[0]), glucose))[1]


def of(text, sample_time_min=5.0, **known):
    return SENSORS.choose(text).made(sample_time_min=sample_time_min, **known)


def told(sensor, glucose, key=KEY):
    """Values and validity of readings."""
    reading = scan(sensor, jnp.asarray(glucose, float), key)
    return np.asarray(reading.glucose_mg_dl), np.asarray(reading.valid)


def of_many(sensor, glucose, people, key=KEY):
    """Readings ``(people, samples)`` of people with keys of their own."""
    keys = jax.random.split(key, people)
    return np.asarray(jax.vmap(lambda key: scan(sensor, jnp.asarray(glucose, float), key).glucose_mg_dl)(keys))


# Closed forms.


def covariances(process, number):
    """Covariances of a stationary process for 0, 1, ... steps, of the variance that a Lyapunov equation gives."""
    transition = np.array([[process.alpha1, process.alpha2], [1.0, 0.0]])
    state = scipy.linalg.solve_discrete_lyapunov(transition, np.diag([process.variance, 0.0]))
    found = list(state[0])
    while len(found) < number:
        found.append(process.alpha1 * found[-1] + process.alpha2 * found[-2])
    return np.array(found[:number])


def moments(model, number):
    """Mean of the points of the noise, and their covariances for 0, 1, ... steps."""
    total = sum(covariances(process, number) for process in model.processes)
    if model.shape is None:
        return 0.0, total
    shape = model.shape
    m, s2, rho = -shape.gamma / shape.delta, total[0] / shape.delta**2, total / total[0]
    mean = math.exp(s2 / 2.0) * math.sinh(m)
    product = 0.5 * (np.exp(s2 * (1.0 + rho)) * np.cosh(2.0 * m) - np.exp(s2 * (1.0 - rho)))
    return shape.xi + shape.scale * mean, shape.scale**2 * (product - mean**2)


def at_samples(model, sample_time_min, samples):
    """Mean ``(samples,)`` and covariance ``(samples, samples)`` of the noise on the lines between its points."""
    t = sample_time_min * np.arange(samples) / model.step_min
    points = math.ceil(t[-1]) + 2
    mean, covariance = moments(model, points)
    weights = np.maximum(1.0 - np.abs(t[:, None] - np.arange(points)), 0.0)
    by_points = covariance[np.abs(np.subtract.outer(np.arange(points), np.arange(points)))]
    return np.full(samples, mean), weights @ by_points @ weights.T


def assert_moments(sensor, expected_mean, expected_covariance, people, most_errors=5.0):
    """Means and covariances of readings of 0 mg/dl are as expected, within standard errors of the sample."""
    samples = expected_mean.size
    noise = of_many(sensor, np.zeros(samples), people)
    off = (noise.mean(axis=0) - expected_mean) / np.sqrt(np.diag(expected_covariance) / people)
    assert np.abs(off).max() < most_errors
    centred = noise - expected_mean
    for i in range(samples):
        products = centred[:, :1] * centred[:, i:] if i == 0 else centred[:, i : i + 1] * centred[:, i:]
        error = products.std(axis=0) / np.sqrt(people)
        assert (np.abs(products.mean(axis=0) - expected_covariance[i, i:]) / error).max() < most_errors


NOISE_ALONE = ALONE + ", drift=false, warm_up_min=0"


@pytest.mark.long
@pytest.mark.parametrize("name", ALIKE)
def test_noise_has_the_moments_of_its_closed_form(name):
    sensor, expected = of(name + NOISE_ALONE), at_samples(ALIKE[name], 5.0, 8)
    assert_moments(sensor, *expected, people=4000)


@pytest.mark.long
@pytest.mark.parametrize("name", ALIKE)
@pytest.mark.parametrize("sample_time_min", [1.0, 3.0, 5.0, 7.0, 15.0, 35.0])
def test_a_million_readings_have_the_moments_of_their_closed_form_at_any_sample_time(name, sample_time_min):
    samples = 10
    expected = at_samples(ALIKE[name], sample_time_min, samples)
    assert_moments(of(name + NOISE_ALONE, sample_time_min), *expected, people=1_000_000 // samples)


def test_breton_and_kovatchev_print_the_mean_of_their_distribution():
    unit = dataclasses.replace(Breton2008.model, processes=(Process(0.0, 0.0, 1.0),))
    assert moments(unit, 2)[0] == pytest.approx(0.76, abs=0.005)  # printed: 0.76 mg/dl
    mean, covariance = moments(Breton2008.model, 2)
    assert mean == pytest.approx(0.72, abs=0.005)
    assert math.sqrt(covariance[0]) == pytest.approx(11.0, abs=0.8)  # printed: 11 mg/dl


def test_stationary_variances_are_those_of_a_lyapunov_equation():
    for model in ALIKE.values():
        expected = [covariances(process, 2)[0] for process in model.processes]
        np.testing.assert_allclose(constants_of(model).variance, expected, rtol=1e-12)


def points_of_breton(normal):
    """Errors at the points of the noise, of normal numbers, the first of which is a point itself as in simglucose."""
    constants, points = constants_of(Breton2008.model), jnp.full((2, 1), normal[0])
    found = [Breton2008.model.shape(points[1, 0])]
    for number in normal[1:]:
        points = constants.advance(points, jnp.full(1, number))
        found.append(Breton2008.model.shape(points[1, 0]))
    return np.array(found)


def test_the_points_of_breton_are_those_of_simglucose():
    # noise15_iter of simglucose 0.2.11 with its parameters, seed 1, whose xi is -5.47 where the paper has -5.471
    simglucose = [
        *(21.114425351511823, 7.47964393996742, 1.032792415686349, -6.58677728769311),
        *(1.1915577090656635, -15.111498177303236, 1.4090227537341047, -4.281041735740359),
    ]
    found = points_of_breton(np.random.RandomState(1).randn(8))
    np.testing.assert_allclose(found + 0.001, simglucose, rtol=1e-12)


NOISE_OF_SIMGLUCOSE = """
from simglucose.sensor.noise_gen import CGMNoise
noise = CGMNoise(asked["parameters"], seed=asked["seed"])
print(json.dumps([next(noise) for _ in range(asked["samples"])]))
"""


@pytest.mark.long
@pytest.mark.parametrize("sample_time_min", [1.0, 3.0, 5.0])
def test_noise_of_simglucose_goes_through_the_points_of_breton(sample_time_min):
    shape, points = Breton2008.model.shape, 90
    johnson = {"xi": shape.xi, "lambda": shape.scale, "gamma": shape.gamma, "delta": shape.delta}
    parameters, every = {"PACF": 0.7, "sample_time": sample_time_min, **johnson}, round(15.0 / sample_time_min)
    asked = {"parameters": parameters, "seed": 3, "samples": points * every}
    theirs = answer_of("simglucose", NOISE_OF_SIMGLUCOSE, asked)  # from the sample after the first point on
    found = points_of_breton(np.random.RandomState(3).randn(points + 1))
    np.testing.assert_allclose(theirs[every - 1 :: every], found[1:], rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("name", ["breton-2008", "dexcom-g6"])
def test_between_two_points_the_noise_is_on_a_straight_line(name):
    step = int(ALIKE[name].step_min)
    values, _ = told(of(name + NOISE_ALONE, 1.0), np.zeros(8 * step + 1))
    times = np.arange(values.size)
    np.testing.assert_allclose(values, np.interp(times, times[::step], values[::step]), atol=1e-12)
    assert np.ptp(values[::step]) > 1.0


def test_a_sample_time_at_odds_with_the_points_meets_each_of_them():
    values, _ = told(of("dexcom-g6" + NOISE_ALONE, 3.0), np.zeros(61))
    for start in range(0, 55, 5):  # the point after 5 min, from both sides, and again for each 15 min
        before, after, late, later = values[start], values[start + 1], values[start + 2], values[start + 3]
        assert before + (after - before) * 5.0 / 3.0 == pytest.approx(late - (later - late) / 3.0, abs=1e-10)


# Sensors that differ.


def by_rejection(people, seed):
    """Sensors drawn one after the other in NumPy, by the rule of the paper and of ReplayBG."""
    rng = np.random.default_rng(seed)
    theta = rng.multivariate_normal(SPREAD.mean, SPREAD.covariance, people)
    alpha1, alpha2, sigma = theta[:, 4:].T
    stable = (alpha2 >= -1.0) & (alpha2 <= 1.0 - np.abs(alpha1) - 0.02)
    with np.errstate(all="ignore"):
        rest = alpha1**2 / (1.0 - alpha2)
        variance = sigma**2 / (1.0 - alpha1 * alpha1 / (1.0 - alpha2) - alpha2 * (rest + alpha2))
    taken = stable & (variance <= 100.0)
    return theta[taken], taken.mean()


def as_theta(constants: Constants):
    """``(..., 7)`` numbers of sensors whose axes trail."""
    rows = (*constants.gain, constants.offset_mg_dl[0], constants.alpha1[0], constants.alpha2[0], constants.sigma[0])
    return np.moveaxis(np.asarray(jnp.stack(rows)), 0, -1)


def assert_same_sensors(found, expected):
    for one, other in ((found, expected), (found**2, expected**2)):
        error = np.sqrt(one.var(axis=0) / len(one) + other.var(axis=0) / len(other))
        assert (np.abs(one.mean(axis=0) - other.mean(axis=0)) / error).max() < 5.0
    for place in range(found.shape[1]):
        assert scipy.stats.ks_2samp(found[:, place], expected[:, place]).pvalue > 1e-6


@pytest.mark.long
def test_sensors_are_drawn_as_by_rejection_one_after_the_other():
    people = 20_000
    normal = jax.random.normal(KEY, (7, 8, people))
    constants = drawn(SPREAD, normal)
    expected, share = by_rejection(200_000, 1)
    taken = np.asarray(candidate(SPREAD, normal)[1])
    assert abs(taken.mean() - share) < 5.0 * math.sqrt(share * (1.0 - share) * (1.0 / taken.size + 1.0 / 200_000))
    none = ~taken.any(axis=0)
    found = as_theta(constants)[~none]
    assert_same_sensors(found, expected)
    assert (as_theta(constants)[none] == np.array(SPREAD.mean)).all()
    for alpha1, alpha2, sigma in found[:200, 4:]:
        assert np.abs(np.roots([1.0, -alpha1, -alpha2])).max() < 1.0
        assert covariances(Process(alpha1, alpha2, sigma**2), 2)[0] <= 100.0


def test_none_of_the_candidates_may_be_taken_without_harm():
    far = jnp.zeros((7, 2)).at[4].set(50.0)
    assert not candidate(SPREAD, far)[1].any()
    np.testing.assert_allclose(as_theta(drawn(SPREAD, far)), SPREAD.mean)


@pytest.mark.long
def test_a_replacement_is_a_sensor_drawn_in_the_same_way():
    sensor = of("vettoretti-2019, wear_min=15, worn_min=0, noise=false" + ", lag_min=0, display=false, warm_up_min=0")
    people = 20_000

    def third(key):
        state = sensor.init(jnp.asarray(100.0), key)
        for number in range(6):
            state, _ = sensor.read(state, jnp.asarray(100.0), jax.random.fold_in(key, number))
        return state.own

    assert_same_sensors(
        as_theta(jax.vmap(third, out_axes=-1)(jax.random.split(KEY, people))), by_rejection(200_000, 2)[0]
    )


# Days of wear.


@pytest.mark.parametrize("name", MONITORS)
def test_there_is_no_reading_while_a_sensor_warms_up(name):
    values, valid = told(of(name + ", warm_up_min=60, wear_min=4h, worn_min=0"), np.full(120, 150.0))
    warm = np.arange(120) % 48 < 12
    np.testing.assert_array_equal(valid, ~warm)
    np.testing.assert_array_equal(np.isnan(values), warm)


def test_gain_and_offset_follow_the_days_and_begin_anew_with_a_new_sensor():
    glucose = 100.0 + 40.0 * np.sin(np.arange(4000) / 30.0)
    values, _ = told(of("dexcom-g6, noise=false, warm_up_min=0, worn_min=2d" + ALONE), glucose)
    days = (2.0 + np.arange(4000) * 5.0 / DAY_MIN) % 10.0
    gain, offset = (
        np.polynomial.polynomial.polyval(days, of) for of in (DexcomG6.model.gain, DexcomG6.model.offset_mg_dl)
    )
    np.testing.assert_allclose(values, gain * glucose + offset, rtol=1e-12)


def test_a_calibration_every_12_hours_begins_the_days_anew():
    values, _ = told(of("dexcom-g5, noise=false, warm_up_min=0, worn_min=0" + ALONE), np.full(400, 120.0))
    days = (np.arange(400) * 5.0 % 720.0) / DAY_MIN
    np.testing.assert_allclose(values, (1.04 + 0.02 * days) * 120.0 - 8.75, rtol=1e-12)


def test_a_new_sensor_has_errors_of_its_own():
    values, _ = told(of("vettoretti-2019, noise=false, warm_up_min=0, wear_min=1d, worn_min=0" + ALONE), [120.0] * 900)
    days = np.arange(288) * 5.0 / DAY_MIN
    for one in values[:288], values[288:576], values[576:864]:  # each a parabola over its day
        np.testing.assert_allclose(np.polynomial.Polynomial.fit(days, one, 2)(days), one, atol=1e-9)
    starts = values[[0, 288, 576]]
    assert np.abs(np.diff(starts)).min() > 0.1


def test_noise_of_a_new_sensor_has_nothing_to_do_with_that_of_the_one_before():
    sensor = of("dexcom-g6, wear_min=30, worn_min=0" + NOISE_ALONE)
    noise = of_many(sensor, np.zeros(8), 4000)
    correlations = [np.corrcoef(noise[:, k], noise[:, k + 1])[0, 1] for k in range(7)]
    assert abs(correlations.pop(5)) < 5.0 / math.sqrt(4000)
    assert min(correlations) > 0.85
    _, covariance = at_samples(DexcomG6.model, 5.0, 2)
    np.testing.assert_allclose(noise[:, 6:].var(axis=0), covariance[0, 0], rtol=5.0 * math.sqrt(2.0 / 4000))


def test_the_time_since_the_insertion_is_drawn_evenly():
    sensor = of("dexcom-g6, wear_min=22h, noise=false" + ALONE)
    keys = jax.random.split(KEY, 5000)
    ages = np.asarray(jax.vmap(lambda key: sensor.init(jnp.asarray(100.0), key).age)(keys))
    assert ages.min() == 24
    assert ages.max() == 263
    assert scipy.stats.chisquare(np.bincount(ages.astype(int))[24:]).pvalue > 1e-4


@pytest.mark.parametrize("name", MONITORS)
def test_a_monitor_with_everything_off_tells_the_truth(name):
    off = ", noise=false, drift=false, display=false, lag_min=0, warm_up_min=0"
    glucose = 130.0 + 50.0 * np.sin(np.arange(60) / 9.0)
    values, valid = told(of(name + off), glucose)
    np.testing.assert_array_equal(values, glucose)
    assert valid.all()


def test_glucose_lags_as_behind_a_lag_and_not_at_an_interstitial_site():
    off = ", noise=false, drift=false, display=false, warm_up_min=0"
    glucose = 130.0 + 50.0 * np.sin(np.arange(60) / 9.0)
    for name, minutes in (("dexcom-g6", 10.0), ("breton-2008", 5.0)):
        np.testing.assert_array_equal(told(of(name + off), glucose)[0], told(Lag(minutes), glucose)[0])
    there = IdealSensor(site="interstitial")
    assert told(of("dexcom-g6" + off, site="interstitial", inner=there), glucose)[0] == pytest.approx(glucose)
    asked = of("dexcom-g6, lag_min=3" + off, site="interstitial", inner=there)
    np.testing.assert_array_equal(told(asked, glucose)[0], told(Lag(3.0), glucose)[0])


def test_errors_are_those_of_glucose_behind_the_lag_and_the_display_shows_them():
    glucose = 130.0 + 90.0 * np.sin(np.arange(80) / 5.0)
    behind, _ = told(Lag(10.0), glucose)
    values, _ = told(of("dexcom-g6, noise=false, worn_min=1d"), glucose)
    days = 1.0 + np.arange(80) * 5.0 / DAY_MIN
    gain, offset = (
        np.polynomial.polynomial.polyval(days, of) for of in (DexcomG6.model.gain, DexcomG6.model.offset_mg_dl)
    )
    np.testing.assert_array_equal(values, np.clip(np.round(gain * behind + offset), 40.0, 400.0))


def test_noise_of_a_sensor_inside_is_added():
    inner = CorrelatedNoise(9.0, 0.7)
    off = ", noise=false, drift=false, display=false, lag_min=0, warm_up_min=0"
    noise = of_many(of("dexcom-g6" + off, inner=inner), [100.0, 100.0], 4000)[:, 0] - 100.0
    assert noise.var() == pytest.approx(9.0, rel=5.0 * math.sqrt(2.0 / 4000))


# The display.


@pytest.mark.parametrize(
    ("sample_time_min", "due"),
    [(1.0, [0, 5, 10, 15]), (3.0, [0, 2, 4, 5, 7, 9, 10]), (5.0, range(16)), (7.0, range(16)), (2.5, range(0, 16, 2))],
)
def test_a_display_has_a_reading_every_five_minutes(sample_time_min, due):
    values, valid = told(Display(sample_time_min=sample_time_min), np.full(16, 123.4))
    assert set(np.flatnonzero(valid)) >= set(due)
    clock = np.floor(np.arange(16) * sample_time_min / 5.0 + 1e-9)
    np.testing.assert_array_equal(valid, np.diff(clock, prepend=-1.0) > 0.0)
    np.testing.assert_array_equal(values[valid], 123.0)
    assert np.isnan(values[~valid]).all()


def test_a_display_keeps_its_range_and_its_step():
    glucose = np.array([12.0, 39.6, 40.4, 99.51, 399.6, 400.5, 712.0, np.nan])
    values, valid = told(Display(), glucose)
    np.testing.assert_array_equal(values, [40.0, 40.0, 40.0, 100.0, 400.0, 400.0, 400.0, np.nan])
    np.testing.assert_array_equal(valid, np.isfinite(glucose))
    wide = Display(low_mg_dl=20.0, high_mg_dl=600.0, step_mg_dl=0.5)
    np.testing.assert_array_equal(told(wide, glucose)[0], [20.0, 39.5, 40.5, 99.5, 399.5, 400.5, 600.0, np.nan])


@pytest.mark.long
@pytest.mark.parametrize(("name", "mard_pct"), list(zip(MONITORS, [6.6, 8.8, 7.1, 7.9, 9.2], strict=True)))
def test_readings_are_as_accurate_as_the_guide_says(name, mard_pct):
    glucose = 160.0 + 80.0 * np.sin(2.0 * np.pi * np.arange(288) / 72.0)
    off = np.abs(of_many(of(name), glucose, 3000) - glucose) / glucose
    assert 100.0 * np.nanmean(off) == pytest.approx(mard_pct, abs=0.2)


# Engines, people, and what is refused.


def by_engine(sensor, name, precision="float64", people=24, samples=80):
    def step(own, state, reaching, shared, rng):
        key, number = rng
        return sensor.read(state, shared["glucose"], jax.random.fold_in(key, number))

    glucose = 130.0 + 70.0 * np.sin(np.arange(samples) / 9.0)
    keys = jax.random.split(KEY, people)
    state = jax.jit(jax.vmap(lambda key: sensor.init(jnp.asarray(130.0), key), out_axes=-1))(keys)
    example = jax.tree.map(lambda leaf: leaf[..., 0], state)
    engine = make_engine(step, (), example, {}, {"glucose": glucose[0]}, keys[0], name=name, precision=precision)
    assert engine.name == name
    reading = engine.run((), state, {}, {"glucose": glucose}, keys)[1]
    return np.asarray(reading.glucose_mg_dl), np.asarray(reading.valid)


@pytest.mark.long
@pytest.mark.parametrize("name", MONITORS)
@pytest.mark.parametrize("sample_time_min", [3.0, 5.0])
def test_native_code_takes_every_monitor_and_computes_the_same(name, sample_time_min):
    sensor = of(name + ", display=false, wear_min=4h, worn_min=100, warm_up_min=30", sample_time_min)
    mapped, valid = by_engine(sensor, "xla")
    assert 0.5 < valid.mean() < 1.0
    for precision, most_mg_dl in (("float64", 1e-10), ("float32", 1e-3)):
        native, also_valid = by_engine(sensor, "native", precision)
        np.testing.assert_array_equal(also_valid, valid)
        np.testing.assert_allclose(native, mapped, rtol=0.0, atol=most_mg_dl)


@pytest.mark.long
def test_native_code_takes_the_display():
    sensor = of("dexcom-g6, worn_min=1d", 1.0)
    for found, expected in zip(by_engine(sensor, "native"), by_engine(sensor, "xla"), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.long
@pytest.mark.parametrize("name", MONITORS)
def test_people_may_trail(name):
    sensor = of(name + ", worn_min=1d")
    state = sensor.init(jnp.full(3, 120.0), KEY)
    state, reading = sensor.read(state, jnp.array([90.0, 120.0, 180.0]), jax.random.fold_in(KEY, 1))
    assert isinstance(reading, Reading)
    assert reading.glucose_mg_dl.shape == reading.valid.shape == (3,)
    again = sensor.read(state, jnp.full(3, 120.0), jax.random.fold_in(KEY, 2))[1]
    assert len(set((np.asarray(again.glucose_mg_dl) - 120.0).tolist())) > 1  # each has errors of their own


@pytest.mark.parametrize("name", MONITORS)
def test_the_numbers_of_a_monitor_equal_themselves(name):  # by which loops of many people find what varies
    for one, other in zip(*(jax.tree.leaves(of(name)) for _ in range(2)), strict=True):
        np.testing.assert_array_equal(np.asarray(one) == np.asarray(other), True)


@pytest.mark.long
def test_a_key_gives_one_course_and_another_gives_another():
    sensor = of("vettoretti-2019")
    glucose = np.full(30, 120.0)
    np.testing.assert_array_equal(told(sensor, glucose)[0], told(sensor, glucose)[0])
    assert np.any(told(sensor, glucose)[0] != told(sensor, glucose, jax.random.key(6))[0])


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: of("dexcom-g6, wear_min=11d"), "wear_min is 15840 min, .* known for 10 days; give up to 14400 min"),
        (lambda: of("dexcom-g6, wear_min=1h"), "warm_up_min is 120 min, but the sensor is replaced after 60 min"),
        (lambda: of("dexcom-g5, worn_min=7d"), "worn_min is 10080 min, but the sensor is replaced after 10080 min"),
        (lambda: of("dexcom-g5, lag_min=121"), "lag_min is 121 min; give a number from 0 to 120 min"),
        (lambda: of("cgm-display, low_mg_dl=400"), "a range of 400 to 400 mg/dl is not possible; give an upper end"),
        (
            lambda: of("cgm-display, high_mg_dl=22"),
            "a range of 40 to 22 mg/dl is not possible; .* 22 mmol/l is 396 mg/dl",
        ),
        (lambda: of("cgm-display, every_min=0"), "every_min is 0 min; give a number above 0 min"),
        (lambda: of("cgm-display", 0.0), "a sample time of 0 min is not possible"),
        (lambda: DexcomG6(warm_up_min=-1.0), "warm_up_min is -1 min; give a number from 0 to 1440 min"),
        (lambda: DexcomG6(sample_time_min=math.nan), "a sample time of nan min is not possible"),
    ],
)
def test_what_is_no_monitor_is_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


def test_a_sensor_without_drift_may_be_worn_for_longer():
    assert of("dexcom-g6, wear_min=11d, drift=false") is not None


@pytest.mark.long
def test_a_model_may_be_ones_own():
    class Own(Monitor):
        model = ErrorModel(gain=(1.1, 0.0, 0.0), lag_min=0.0)

    values, _ = told(Own(warm_up_min=0.0, display=False), [100.0, 110.0])
    np.testing.assert_allclose(values, [110.0, 121.0])
