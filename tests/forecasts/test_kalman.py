"""The Kalman filter of forecasts beside the plain conditional of a normal distribution, and on records of its own."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.stats

from forecast_records import COEFFICIENTS, PARAMETERS, drawn_record, explained_mg_dl, gridded, own_model
from glucoloop.forecasts.grid import SAMPLES_PER_DAY, UsualDay
from glucoloop.forecasts.kalman import Kalman, unexplained_system
from glucoloop.forecasts.linear_filter import discretised, exact_gains, filtered, steady_gains
from glucoloop.forecasts.scores import forecast_errors
from naming import naming


def test_the_noise_of_a_step_is_the_integral_of_that_of_the_equations():
    rate = np.array([[-0.01, 0.3], [0.0, -0.1]])
    density = np.diag([0.2, 1.0])
    transition, noise = discretised(rate, density, 5.0)
    np.testing.assert_allclose(transition, scipy.linalg.expm(5.0 * rate), rtol=1e-12)
    integral = scipy.integrate.quad_vec(
        lambda t: scipy.linalg.expm(rate * t) @ density @ scipy.linalg.expm(rate * t).T, 0.0, 5.0
    )[0]
    np.testing.assert_allclose(noise, integral, rtol=1e-9)


def dense_covariance(samples):
    """Covariance of the unexplained readings without their noise, of a system that has run for long."""
    system = unexplained_system(PARAMETERS[None])
    transition, noise = system.transition[0], system.process_noise[0]
    stationary = scipy.linalg.solve_discrete_lyapunov(transition, noise)
    by_lag = [
        system.readout @ np.linalg.matrix_power(transition, lag) @ stationary @ system.readout for lag in range(samples)
    ]
    return scipy.linalg.toeplitz(by_lag), float(system.reading_variance[0])


def test_a_forecast_is_the_conditional_of_the_joint_distribution():
    random = np.random.default_rng(5)
    bolus_U, carbs_g = np.zeros((2, SAMPLES_PER_DAY))
    bolus_U[[20, 70, 130]], carbs_g[[25, 72, 150]] = (3.0, 6.0, 1.5), (40.0, 75.0, 20.0)
    readings = 150.0 + 30.0 * random.standard_normal(SAMPLES_PER_DAY)
    readings[random.random(SAMPLES_PER_DAY) < 0.3] = np.nan
    readings[60:80] = np.nan
    record = gridded(readings, bolus_U=bolus_U, carbs_g=carbs_g)
    origins, horizons = np.array([3, 59, 79, 140]), np.array([1, 6, 24, 48])
    forecast = own_model().forecast(record, origins, horizons, future_known=True)

    covariance, noise = dense_covariance(SAMPLES_PER_DAY)
    explained = explained_mg_dl(record)
    for row, origin in enumerate(origins):
        past = np.flatnonzero(np.isfinite(readings[: origin + 1]))
        joint = covariance[np.ix_(past, past)] + noise * np.eye(past.size)
        for column, horizon in enumerate(horizons):
            target = origin + horizon
            gain = np.linalg.solve(joint, covariance[past, target])
            with naming(origin, horizon):
                mean = explained[target] + gain @ (readings[past] - explained[past])
                variance = covariance[target, target] + noise - gain @ covariance[past, target]
                assert forecast.mean_mg_dl[row, column] == pytest.approx(mean, abs=0.05)  # of the quadrature
                assert forecast.variance[row, column] == pytest.approx(variance, rel=1e-9)


def test_what_is_not_known_of_the_future_is_as_usual():
    bolus_U, carbs_g = np.zeros((2, SAMPLES_PER_DAY))
    bolus_U[[50, 110]], carbs_g[[48, 105]] = (4.0, 5.0), (60.0, 50.0)
    record = gridded(np.full(SAMPLES_PER_DAY, 140.0), bolus_U=bolus_U, carbs_g=carbs_g)
    without_later = gridded(
        record.reading_mg_dl, bolus_U=bolus_U * (np.arange(288) < 100), carbs_g=carbs_g * (np.arange(288) < 100)
    )
    origin, horizons = np.array([100]), np.array([12, 36])
    unknown = own_model().forecast(record, origin, horizons, future_known=False)
    as_usual = own_model().forecast(without_later, origin, horizons, future_known=True)
    np.testing.assert_allclose(unknown.mean_mg_dl, as_usual.mean_mg_dl, rtol=1e-12)
    known = own_model().forecast(record, origin, horizons, future_known=True)
    assert np.all(np.abs(known.mean_mg_dl - unknown.mean_mg_dl) > 5.0)


def test_exact_gains_come_to_those_of_the_steady_state():
    system = unexplained_system(PARAMETERS[None])
    start = scipy.linalg.solve_discrete_lyapunov(system.transition[0], system.process_noise[0])
    gains, _ = exact_gains(system, start, np.ones(4000, bool))
    np.testing.assert_allclose(gains[-1], steady_gains(system)[0], rtol=1e-8)


def test_the_filter_is_linear_in_its_signals():
    random = np.random.default_rng(2)
    system = unexplained_system(PARAMETERS[None])
    gains = np.where(random.random(100)[:, None, None] < 0.8, steady_gains(system), 0.0)
    signals = random.standard_normal((100, 1, 3))
    states = filtered(system, gains, signals)
    summed = filtered(system, gains, signals @ np.array([[2.0], [-1.0], [0.5]]))
    np.testing.assert_allclose(states @ np.array([[2.0], [-1.0], [0.5]]), summed, atol=1e-12)


def test_the_gradient_is_that_of_central_differences():
    from glucoloop.forecasts.kalman import _Likelihood, _linear_prior, _log_prior

    likelihood = _Likelihood(drawn_record(6, 1), _linear_prior(50.0, 1000.0, 0.3))
    at = _log_prior()[0] + 0.1
    direction = np.linspace(-1.0, 1.5, at.size)
    _, gradient = likelihood.value(at)
    ahead, behind = (likelihood.value(at + step * direction)[0] for step in (1e-3, -1e-3))
    assert gradient @ direction == pytest.approx((ahead - behind) / 2e-3, rel=0.02)


def test_a_forecast_keeps_what_other_days_bear_out():
    assert Kalman(individual=False).fitted(drawn_record(84, 7)).share > 0.8
    record = drawn_record(16, 7)
    inverted = np.repeat(np.arange(16) // 4 % 2 == 1, SAMPLES_PER_DAY)  # days on which meals lower glucose
    mirrored = 2.0 * np.nanmean(record.reading_mg_dl) - record.reading_mg_dl
    changing = dataclasses.replace(record, reading_mg_dl=np.where(inverted, mirrored, record.reading_mg_dl))
    assert Kalman(individual=False).fitted(changing).share < 0.4


@pytest.mark.long
def test_bands_of_records_of_its_own_model_hold_what_they_say():
    counts = {}
    for seed in range(3):
        record = drawn_record(42, seed)
        fitted = Kalman().fit(record.of_days(0, 10))
        for horizon, errors in forecast_errors(fitted, record, 10, (60.0, 240.0), future_known=True).items():
            apart = slice(None, None, 32)  # 8 h, so that the errors are nearly independent
            inside = errors.covered[apart]
            total = counts.setdefault(horizon, [0, 0])
            total[0] += int(inside.sum())
            total[1] += inside.size
    for horizon in ("60 min", "240 min"):
        covered, forecasts = counts[horizon]
        low, high = scipy.stats.binom.interval(0.999, forecasts, 0.9)
        with naming(horizon, covered, forecasts):
            assert forecasts > 250
            assert low <= covered <= high


def test_the_effects_of_insulin_and_carbohydrate_are_found_again():
    falls, rises = [], []
    for seed in range(4):
        fitted = Kalman(individual=False, insulin_spread=2.0).fitted(drawn_record(20, seed))
        falls.append(fitted.fall_mg_dl_U)
        rises.append(fitted.rise_mg_dl_g)
    assert np.mean(falls) == pytest.approx(-COEFFICIENTS[0], rel=0.25)
    assert np.mean(rises) == pytest.approx(COEFFICIENTS[1], rel=0.25)


@pytest.mark.parametrize("seed", range(2))
def test_where_half_of_the_meals_are_not_entered_the_usual_meal_is_forecast(seed):
    record = drawn_record(20, seed)
    meals = np.flatnonzero(record.carbs_g)
    some = record.carbs_g.copy()
    some[np.random.default_rng(seed).permutation(meals)[::2]] = 0.0
    shares = []
    for carbs_g in (record.carbs_g, some):
        fitted = Kalman(individual=False).fitted(dataclasses.replace(record, carbs_g=carbs_g))
        shares.append(fitted.coefficients[-1] / (fitted.rise_mg_dl_g + fitted.coefficients[-1]))
    assert shares[0] < 0.25
    assert shares[0] + 0.25 < shares[1] < 1.1


def test_the_usual_meal_is_that_of_each_day():
    usual = UsualDay(*np.zeros((3, SAMPLES_PER_DAY)), np.eye(1, SAMPLES_PER_DAY, 280)[0])
    leaning = dataclasses.replace(own_model(coefficients=np.append(COEFFICIENTS[:-1], 2.0)), usual=usual)
    record = gridded(np.full(2 * SAMPLES_PER_DAY, np.nan), carbs_g=np.zeros(2 * SAMPLES_PER_DAY))
    eaten = dataclasses.replace(record, carbs_g=np.tile(usual.carbs_g, 2))
    origin, horizons = np.array([SAMPLES_PER_DAY - 1]), np.arange(1, 200, 10)
    leant = leaning.forecast(record, origin, horizons, future_known=True).mean_mg_dl
    told = own_model(coefficients=np.append([-25.0, 2.0], COEFFICIENTS[2:])).forecast(
        eaten, origin, horizons, future_known=True
    )
    np.testing.assert_allclose(leant, told.mean_mg_dl, rtol=1e-9)


@pytest.mark.long
def test_a_fit_is_the_same_each_time():
    record = drawn_record(6, 7)
    first, second = Kalman().fitted(record), Kalman().fitted(record)
    np.testing.assert_array_equal(first.parameters, second.parameters)
    np.testing.assert_array_equal(first.coefficients, second.coefficients)
