"""Twins of people whose parameters are known: the days held out are predicted, and the record is explained."""

import dataclasses

import numpy as np
import pytest

from forecast_records import gridded
from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record
from glucoloop.patients.population import population
from glucoloop.twins import explained, find_twin, under_doses
from glucoloop.twins.forecast import TwinPredictor
from glucoloop.twins.twin import rises_without_carbs_pct
from lived_records import lived

pytestmark = pytest.mark.long
FAMILY, PEOPLE = "hovorka-2004", "boiroux2017"


@pytest.fixture(scope="module")
def twin():
    """Twin of a person, found from five days."""
    record, _ = lived(FAMILY, PEOPLE, 2000, days=7)
    return find_twin(gridded_record(record), population(PEOPLE, patient=FAMILY), held_out_days=2)


def test_days_held_out_are_predicted_better_than_by_the_mean_and_the_time_of_day(twin):
    day = twin.checks[-1]
    assert twin.predicts
    assert day.rmse_mg_dl < min(day.by_mean_rmse_mg_dl, day.by_time_of_day_rmse_mg_dl)
    assert 75.0 < day.covered_pct <= 100.0


def test_two_days_from_doses_and_meals_alone_are_predicted_within_twice_the_noise_of_the_sensor(twin):
    first = (twin.record.days - 2) * SAMPLES_PER_DAY
    predictor = TwinPredictor.of(twin.mode, twin.training)
    horizons = np.arange(1, 2 * SAMPLES_PER_DAY + 1)
    forecast = predictor.forecast(twin.record, np.array([first - 1]), horizons, future_known=True)
    error = forecast.mean_mg_dl[0] - twin.record.reading_mg_dl[first:]
    assert np.sqrt(np.nanmean(error**2)) < 18.0


def test_where_meals_are_not_entered_a_forecast_takes_the_usual_carbohydrate(twin):
    predictor = TwinPredictor.of(twin.mode, twin.training)
    meals = np.flatnonzero(twin.training.carbs_g)
    some = twin.training.carbs_g.copy()
    some[meals[::2]] = 0.0
    shares = [
        predictor.likely_usual_share(dataclasses.replace(twin.training, carbs_g=carbs_g))
        for carbs_g in (twin.training.carbs_g, some)
    ]
    assert shares[0] < 0.15
    assert 0.3 < shares[1] <= 1.0


def test_with_nothing_but_the_usual_carbohydrate_entered_meals_are_unknown(twin):
    predictor = dataclasses.replace(TwinPredictor.of(twin.mode, twin.training), usual_share=1.0)
    origins, horizons = np.array([5 * SAMPLES_PER_DAY + 101]), np.array([12, 48])
    usual_bolus_U = np.where(
        np.arange(twin.record.carbs_g.size) > origins[0],
        predictor.usual.user_bolus_U[twin.record.clock],
        twin.record.user_bolus_U,
    )
    record = dataclasses.replace(twin.record, user_bolus_U=usual_bolus_U)
    known, unknown = (predictor.forecast(record, origins, horizons, future_known=known) for known in (True, False))
    np.testing.assert_allclose(known.mean_mg_dl, unknown.mean_mg_dl, rtol=1e-9)


def test_what_the_record_does_not_tell_is_said(twin):
    assert "V_I" in twin.unidentified
    assert any("next to nothing of" in sentence for sentence in twin.warnings())


def test_with_what_is_unexplained_the_equations_give_the_record_again_at_any_sensitivity(twin):
    mean = float(np.nanmean(twin.training.reading_mg_dl))
    after = slice(SAMPLES_PER_DAY, None)
    spread = []
    for factor in (0.5, 1.0, 1.5):
        patient = twin.mode.patient.with_sensitivity(factor)
        fit = explained(patient, twin.mode.p, twin.record, mean)
        error = (fit.glucose_mg_dl - twin.record.reading_mg_dl)[after]
        assert np.sqrt(np.nanmean(error**2)) < 15.0  # the sensor's noise and its delay
        spread.append(fit.unexplained_mg_min[after].std())
    assert spread[1] < min(spread[0], spread[2])  # the right sensitivity explains most


def test_what_returns_glucose_to_its_mean_acts_on_glucose_under_other_doses(twin):
    patient, p = twin.mode.patient, twin.mode.p
    fit = explained(patient, p, twin.record, float(np.nanmean(twin.training.reading_mg_dl)))
    np.testing.assert_allclose(under_doses(patient, p, fit, twin.record), fit.glucose_mg_dl, rtol=1e-9)
    more = dataclasses.replace(twin.record, basal_U=1.2 * twin.record.basal_U)
    after = under_doses(patient, p, fit, more)
    # the same with the appearance that glucose so changed has, and no return
    change = np.append(0.0, (after - fit.glucose_mg_dl)[:-1])
    appearance = fit.unexplained_mg_min - fit.return_mg_min * change
    fixed = fit._replace(unexplained_mg_min=appearance, return_mg_min=0.0)
    np.testing.assert_allclose(under_doses(patient, p, fixed, more), after, rtol=1e-9)
    kept = under_doses(patient, p, fit._replace(return_mg_min=0.0), more)
    assert (kept - fit.glucose_mg_dl).mean() < 1.1 * (after - fit.glucose_mg_dl).mean() < 0.0


def test_a_return_lessens_the_fall_by_a_unit(twin):
    patient, p = twin.mode.patient, twin.mode.p
    slow, fast = (patient.with_return(p, value) for value in (1e5, 60.0))
    for of, value in ((slow, 1e5), (fast, 60.0)):
        assert float(patient.noises(of)["return_min"]) == pytest.approx(value)
    kept, falls = (
        patient.fall_mg_dl_U(p, 140.0),
        [patient.fall_mg_dl_U(of, 140.0, returned=True) for of in (slow, fast)],
    )
    assert falls[0] == pytest.approx(kept, rel=0.01)
    assert falls[1] < 0.8 * kept


def test_no_forecast_sees_what_comes_later(twin):
    record = twin.record
    predictor = TwinPredictor.of(twin.mode, twin.training)
    origins, horizons = np.array([5 * SAMPLES_PER_DAY + 101]), np.array([1, 48])
    later = np.arange(record.reading_mg_dl.size) > origins[-1]
    readings_and_automation = dataclasses.replace(
        record,
        reading_mg_dl=np.where(later, 333.0, record.reading_mg_dl),
        automatic_bolus_U=np.where(later, 0.4, record.automatic_bolus_U),
    )
    meals_too = dataclasses.replace(
        readings_and_automation,
        user_bolus_U=np.where(later, 1.0, record.user_bolus_U),
        carbs_g=np.where(later, 5.0, record.carbs_g),
    )
    for future_known, changed in ((True, readings_and_automation), (False, meals_too)):
        before = predictor.forecast(record, origins, horizons, future_known=future_known)
        after = predictor.forecast(changed, origins, horizons, future_known=future_known)
        np.testing.assert_allclose(after.mean_mg_dl, before.mean_mg_dl, rtol=1e-9)


def test_rises_are_counted_once():
    readings = np.full(SAMPLES_PER_DAY, 100.0)
    readings[60:78] += 5.0 * np.arange(18)  # with a meal
    readings[78:100] = 185.0
    readings[150:168] += 5.0 * np.arange(18)  # without any
    readings[168:180] = 185.0
    carbs_g = np.zeros(SAMPLES_PER_DAY)
    carbs_g[58] = 40.0
    assert rises_without_carbs_pct(gridded(readings, carbs_g=carbs_g)) == 50.0
    assert rises_without_carbs_pct(gridded(np.full(SAMPLES_PER_DAY, 100.0))) is None
