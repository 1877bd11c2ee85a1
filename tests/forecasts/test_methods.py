"""Methods of forecasting beside sums by hand, and what every one of them keeps to."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forecast_records import drawn_record, gridded
from glucoloop.forecasts.grid import SAMPLES_PER_DAY
from glucoloop.forecasts.method import METHODS, effect_of_future, effect_of_history
from glucoloop.forecasts.ridge import ridge_coefficients
from glucoloop.forecasts.scores import DAY, forecast_errors
from glucoloop.refusal import Refusal
from naming import naming

DAYS = 7
EVERY = (*(name for name in METHODS.names() if name != "twin"), "loop-like, fitted=true", "kalman, individual=false")
QUICK = tuple(text for text in EVERY if text != "kalman")


@pytest.fixture(scope="module")
def record():
    return drawn_record(DAYS, 11)


@pytest.fixture(scope="module")
def fitted(record):
    return {text: METHODS.choose(text).fit(record.of_days(0, 5)) for text in EVERY}


def test_references_are_those_of_a_pencil():
    readings = np.tile(np.repeat([100.0, 200.0], SAMPLES_PER_DAY // 2), 6)
    readings[5 * SAMPLES_PER_DAY + 10] = np.nan
    record = gridded(readings)
    training = record.of_days(0, 5)
    origins, horizons = np.array([5 * SAMPLES_PER_DAY + 10]), np.array([6, 200])
    of = {
        name: METHODS.choose(name).fit(training).forecast(record, origins, horizons, future_known=True).mean_mg_dl[0]
        for name in ("persistence", "mean", "time-of-day")
    }
    assert of["persistence"].tolist() == [100.0, 100.0]
    assert of["mean"].tolist() == pytest.approx([150.0, 150.0])
    assert of["time-of-day"].tolist() == pytest.approx([102.0 - 2.0, 200.0])


def test_two_numbers_by_the_rules_take_a_bolus_and_a_meal_as_a_pencil_does():
    bolus_U, carbs_g = np.zeros((2, 6 * SAMPLES_PER_DAY))
    at = 5 * SAMPLES_PER_DAY + 96
    basal_U = np.full(bolus_U.size, 24.0 / SAMPLES_PER_DAY)
    for day in range(5):
        bolus_U[day * SAMPLES_PER_DAY + 100] = 10.0  # 34 U a day
    bolus_U[at], carbs_g[at + 2] = 2.0, 20.0
    record = gridded(np.full(bolus_U.size, 180.0), basal_U=basal_U, bolus_U=bolus_U, carbs_g=carbs_g)
    method = METHODS.choose("loop-like").fit(record.of_days(0, 5))
    far = np.array([120])
    known, unknown = (
        method.forecast(record, np.array([at]), far, future_known=future_known).mean_mg_dl[0, 0]
        for future_known in (True, False)
    )
    assert unknown == pytest.approx(180.0 - 2.0 * 1700.0 / 34.0)
    assert known == pytest.approx(unknown + 20.0 * (1700.0 / 34.0) / (450.0 / 34.0))


@pytest.mark.parametrize(("bolus_U", "carbs_g", "end"), [(40.0, 0.0, 39.0), (0.0, 400.0, 401.0)])
def test_two_numbers_forecast_nothing_that_no_sensor_reads(bolus_U, carbs_g, end):
    boluses, carbs = np.zeros((2, 6 * SAMPLES_PER_DAY))
    at = 5 * SAMPLES_PER_DAY + 96
    boluses[at], carbs[at] = bolus_U, carbs_g
    basal_U = np.full(boluses.size, 24.0 / SAMPLES_PER_DAY)
    record = gridded(np.full(boluses.size, 180.0), basal_U=basal_U, bolus_U=boluses, carbs_g=carbs)
    forecast = (
        METHODS.choose("loop-like")
        .fit(record.of_days(0, 5))
        .forecast(record, np.array([at]), np.array([48]), future_known=False)
    )
    assert forecast.mean_mg_dl.tolist() == [[end]]


def test_effects_are_sums_over_doses():
    random = np.random.default_rng(4)
    amounts, curve = random.random(40), np.cumsum(random.random(15))
    response = lambda age: curve[min(age, curve.size - 1)]  # noqa: E731
    for horizon in (1, 7, 30):
        history, future = effect_of_history(amounts, curve, horizon), effect_of_future(amounts, curve, horizon)
        for t in (0, 5, 20):
            past = sum(amounts[j] * (response(t + horizon - j) - response(t - j)) for j in range(t + 1))
            assert history[t] == pytest.approx(past)
            if t + horizon < amounts.size:
                later = sum(amounts[j] * response(t + horizon - j) for j in range(t + 1, t + horizon + 1))
                assert future[t] == pytest.approx(later)


def test_ridge_is_least_squares_with_rows_for_the_penalty():
    random = np.random.default_rng(8)
    features, targets = random.standard_normal((60, 5)), random.standard_normal(60)
    rows = np.vstack([features, np.sqrt(3.0) * np.eye(5)])
    expected = np.linalg.lstsq(rows, np.append(targets, np.zeros(5)), rcond=None)[0]
    np.testing.assert_allclose(ridge_coefficients(features, targets, 3.0), expected, rtol=1e-10)


def test_no_forecast_sees_what_comes_later(record, fitted):
    origins = np.array([5 * SAMPLES_PER_DAY + 40, 5 * SAMPLES_PER_DAY + 101])
    horizons = np.array([1, 12, 48, 288])
    later = np.arange(record.reading_mg_dl.size) > origins[-1]
    other = dataclasses.replace(
        record,
        reading_mg_dl=np.where(later, 333.0, record.reading_mg_dl),
        basal_U=np.where(later, 0.7, record.basal_U),
        automatic_bolus_U=np.where(later, 0.4, record.automatic_bolus_U),
    )
    meals_too = dataclasses.replace(
        other,
        user_bolus_U=np.where(later, 1.0, record.user_bolus_U),
        carbs_g=np.where(later, 5.0, record.carbs_g),
    )
    for text, method in fitted.items():
        with naming(text):
            for future_known, changed in ((True, other), (False, meals_too)):
                before = method.forecast(record, origins, horizons, future_known=future_known)
                after = method.forecast(changed, origins, horizons, future_known=future_known)
                np.testing.assert_allclose(after.mean_mg_dl[-1], before.mean_mg_dl[-1], rtol=1e-9)
                np.testing.assert_allclose(after.variance[-1], before.variance[-1], rtol=1e-9)
                assert np.all(before.variance > 0.0)


def test_forecasts_go_beyond_the_end_of_the_record(record, fitted):
    last = np.array([record.reading_mg_dl.size - 1])
    for text, method in fitted.items():
        with naming(text):
            forecast = method.forecast(record, last, np.array([1, 48, 288]), future_known=True)
            assert np.isfinite(forecast.mean_mg_dl).all()
            assert np.isfinite(forecast.variance).all()


def test_errors_are_of_the_readings_that_came(record, fitted):
    errors = forecast_errors(fitted["mean"], record, 5, (30.0, 240.0), future_known=False)
    mean = np.nanmean(record.of_days(0, 5).reading_mg_dl)
    held_out = record.of_days(5, DAYS).reading_mg_dl
    held_out = held_out[np.isfinite(held_out)]
    np.testing.assert_allclose(np.sort(errors[DAY].error_mg_dl), np.sort(mean - held_out))
    assert list(errors) == ["30 min", "240 min", DAY]
    assert errors["30 min"].error_mg_dl.size > 150  # every 15 min of two days, but for missing readings
    assert set(errors[DAY].day.tolist()) == {0, 1}


def test_few_days_are_refused_with_the_number_that_is_needed():
    short = drawn_record(4, 3)
    for text in QUICK:
        with naming(text), pytest.raises(Refusal, match=r"4 of its days .* 5 or more"):
            METHODS.choose(text).fit(short)


def test_insulin_is_needed_where_a_method_forecasts_from_it():
    readings = drawn_record(6, 3).reading_mg_dl
    with pytest.raises(Refusal, match=r"0\.0 U of insulin a day"):
        METHODS.choose("loop-like").fit(gridded(readings))
    forecast = METHODS.choose("kalman, individual=false").fit(gridded(readings))
    assert forecast is not None


@settings(max_examples=25, deadline=None)
@given(
    missing=st.floats(0.0, 1.0),
    gap=st.tuples(st.integers(0, 6 * SAMPLES_PER_DAY), st.integers(0, 3 * SAMPLES_PER_DAY)),
    seed=st.integers(0, 1000),
    level=st.sampled_from([20.0, 120.0, 800.0]),
    text=st.sampled_from(QUICK),
)
def test_a_damaged_record_is_forecast_or_refused(missing, gap, seed, level, text):
    random = np.random.default_rng(seed)
    samples = 7 * SAMPLES_PER_DAY
    readings = np.clip(level + 40.0 * random.standard_normal(samples) * (seed % 3), 20.0, 800.0)
    readings[random.random(samples) < missing] = np.nan
    readings[gap[0] : gap[0] + gap[1]] = np.nan
    carbs_g = np.where(random.random(samples) < 0.01, 50.0, 0.0)
    record = gridded(readings, basal_U=np.full(samples, 0.1), bolus_U=0.1 * carbs_g, carbs_g=carbs_g)
    try:
        method = METHODS.choose(text).fit(record.of_days(0, 6))
    except Refusal as refusal:
        message = str(refusal)
        assert re.search(r"5 or more|readings follow one another", message)
        return
    for errors in forecast_errors(method, record, 6, (30.0, 240.0), future_known=True).values():
        assert np.isfinite(errors.forecast_mg_dl).all()
        assert np.isfinite(errors.half_width_mg_dl).all()
