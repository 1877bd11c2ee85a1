"""Glucose and carbohydrate of oref0: the numbers of the npm package for the same readings, boluses and meals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control.oref0.inputs import (
    DEVIATIONS,
    MEALS,
    READINGS,
    SAMPLE_MIN,
    bucketed,
    detect_carb_absorption,
    glucose_get_last,
    iob_total,
    recent_carbs,
    treatments,
)
from glucoloop.control.oref0.records import DosingProfile
from oref0_package import answers_of, as_written, needs_oref0

SAMPLES = 160
"""Thirteen hours, so that what is looked at has its own past."""
PEOPLE = 150
DIA_H = 5.0


def drawn(seed):
    """Readings, boluses and meals of people, the newest first."""
    rng = np.random.default_rng(seed)
    shape = (SAMPLES, PEOPLE)
    wander = 140.0 + 40.0 * np.cumsum(rng.normal(0.0, 0.15, shape), axis=0)
    glucose = np.clip(np.round(wander + rng.normal(0.0, 3.0, shape)), 45.0, 350.0)
    boluses = np.where(rng.random(shape) < 0.04, np.round(rng.uniform(0.2, 7.0, shape), 1), 0.0)
    meals = np.where(rng.random(shape) < 0.03, np.round(rng.uniform(0.5, 90.0, shape)), 0.0)
    return glucose, boluses, meals


def profile_of(rng):
    return {
        "sens": np.round(rng.uniform(15.0, 100.0, PEOPLE)),
        "carb_ratio": np.round(rng.uniform(5.0, 25.0, PEOPLE), 1),
        "min_5m_carbimpact": np.round(rng.uniform(3.0, 10.0, PEOPLE), 1),
        "maxCOB": np.round(rng.uniform(40.0, 120.0, PEOPLE)),
    }


def dosing(of):
    return DosingProfile(
        current_basal_U_h=1.0,
        max_daily_basal_U_h=1.0,
        max_basal_U_h=4.0,
        sens_mg_dl_U=of["sens"],
        carb_ratio_g_U=of["carb_ratio"],
        min_bg_mg_dl=100.0,
        max_bg_mg_dl=100.0,
        min_5m_carbimpact=of["min_5m_carbimpact"],
        max_cob_g=of["maxCOB"],
    )


def histories(readings, boluses):
    """Glucose and activity as the controller keeps them, taken in reading by reading."""

    def sample(carry, row):
        glucose, activity, insulin = carry
        reading, bolus = row
        glucose = bucketed(glucose, reading, jnp.ones(PEOPLE))
        insulin = jnp.concatenate([bolus[None], insulin[:-1]])
        now = iob_total(insulin, 1.0, jnp.zeros(PEOPLE), dia_h=DIA_H, peak_min=75.0).activity_U_min
        activity = jnp.concatenate([now[None], activity[:-1]])
        return (glucose, activity, insulin), None

    start = (
        jnp.zeros((DEVIATIONS + 1, PEOPLE)) + readings[-1],
        jnp.zeros((DEVIATIONS, PEOPLE)),
        jnp.zeros((treatments(DIA_H), PEOPLE)),
    )
    (glucose, activity, _), _ = jax.lax.scan(sample, start, (readings[::-1], boluses[::-1]))
    return glucose, activity


def told(rows, of, i):
    """Rows of a person as the package is told of them, and the profile."""
    pairs = ([[SAMPLE_MIN * k, v] for k, v in enumerate(row[:, i].tolist()) if v] for row in rows)
    profile = {name: float(values[i]) for name, values in of.items()}
    return *pairs, {**profile, "dia": DIA_H, "curve": "rapid-acting", "current_basal": 1.0}


@needs_oref0
@pytest.mark.long
def test_absorption_and_slopes_of_deviations_are_those_of_the_package():
    readings, boluses, _ = drawn(3)
    of, since = profile_of(np.random.default_rng(8)), np.random.default_rng(9).integers(0, MEALS, PEOPLE)
    calls = []
    for i in range(PEOPLE):
        glucose, insulin, profile = told((readings, boluses), of, i)
        call = {"readings": glucose, "treatments": insulin, "profile": profile}
        calls += [{**call, "since": SAMPLE_MIN * int(since[i])}, {**call, "since": 360, "now": True}]
    answers = answers_of("absorption", calls)
    found = as_written(lambda r, b, p: detect_carb_absorption(*histories(r, b), p))(readings, boluses, dosing(of))
    absorbed = np.cumsum(found.absorbed_g, axis=0)[since, np.arange(PEOPLE)]
    np.testing.assert_allclose(absorbed, [answer["carbsAbsorbed"] for answer in answers[::2]], rtol=1e-13)
    assert np.sum(absorbed > 0.0) > PEOPLE * 0.9
    for name, ours in (
        ("slopeFromMaxDeviation", found.slope_from_max_deviation),
        ("slopeFromMinDeviation", found.slope_from_min_deviation),
    ):
        np.testing.assert_array_equal(ours, [answer[name] for answer in answers[1::2]], err_msg=name)


@needs_oref0
@pytest.mark.long
def test_carbohydrate_on_board_of_several_meals_is_that_of_the_package():
    """Without boluses: for every meal but one the package forgets insulin that is newer than its oldest reading."""
    readings, _, meals = drawn(21)
    of = profile_of(np.random.default_rng(22))
    calls = []
    for i in range(PEOPLE):
        glucose, carbs, profile = told((readings, meals), of, i)
        calls.append({"readings": glucose, "carbs": carbs, "profile": profile})
    answers = answers_of("meal", calls)
    ours = as_written(lambda r, b, m, p: recent_carbs(m[:MEALS], *histories(r, b), p))
    found = ours(readings, np.zeros_like(readings), meals, dosing(of))
    for name, ours in (
        ("carbs", found.carbs_g),
        ("mealCOB", found.meal_cob_g),
        ("slopeFromMaxDeviation", found.slope_from_max_deviation),
        ("slopeFromMinDeviation", found.slope_from_min_deviation),
    ):
        np.testing.assert_array_equal(ours, [answer[name] for answer in answers], err_msg=name)
    assert np.sum(np.asarray(found.meal_cob_g) > 0.0) > PEOPLE / 5
    eats = np.asarray(found.carbs_g) > 0.0
    assert np.sum(eats) > PEOPLE / 2
    last = SAMPLE_MIN * np.argmax(meals >= 1.0, axis=0)
    np.testing.assert_array_equal(np.asarray(found.last_carb_age_min)[eats], last[eats])


@needs_oref0
def test_the_change_of_glucose_is_that_of_the_package():
    rng = np.random.default_rng(1)
    count = 2000
    readings = np.round(rng.uniform(40.0, 300.0) + np.cumsum(rng.normal(0.0, 8.0, (READINGS, count)), axis=0), 1)
    readings = np.where(rng.random(readings.shape) < 0.2, 0.0, np.clip(readings, 30.0, 400.0))
    readings[2] = np.where(np.any(readings[:3] > 0.0, axis=0), readings[2], 120.0)
    rows = [[[5 * k, v] for k, v in enumerate(column.tolist()) if v] for column in readings.T]
    answers = answers_of("glucose", [{"readings": row} for row in rows])
    found = as_written(glucose_get_last)(readings)
    # Readings that are over 40 min older than the last one are not looked at by either.
    for name, ours_are in (
        ("glucose", found.glucose_mg_dl),
        ("delta", found.delta),
        ("short_avgdelta", found.short_avgdelta),
        ("long_avgdelta", found.long_avgdelta),
    ):
        np.testing.assert_array_equal(ours_are, [answer[name] for answer in answers], err_msg=name)
    np.testing.assert_array_equal(found.minutes_ago, [row[0][0] for row in rows])


@pytest.mark.long
def test_without_a_reading_for_over_10_min_the_last_one_is_too_old():
    readings = np.zeros((READINGS, 2))
    readings[3:, 1] = 120.0
    assert np.all(np.asarray(glucose_get_last(jnp.asarray(readings)).minutes_ago) > 12.0)


@pytest.mark.parametrize("gap", [1, 2, 3, 7, 12, 40])
def test_across_a_gap_glucose_is_a_line(gap):
    row = jnp.concatenate([jnp.full(gap, 100.0), jnp.linspace(90.0, 60.0, DEVIATIONS + 1 - gap)])
    after = bucketed(row, jnp.asarray(163.0), jnp.asarray(float(gap)))
    line = np.interp(np.arange(gap + 1), [0, gap], [163.0, 100.0])
    np.testing.assert_array_equal(after[: gap + 1], np.floor(line + 0.5))
    np.testing.assert_array_equal(after[gap + 1 :], row[gap:-1])
