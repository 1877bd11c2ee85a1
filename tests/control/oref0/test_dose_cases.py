"""The cases of the original's own tests of ``determine_basal``, as numbers: questions, and what is expected.

Not among them are cases of ratios of autosens other than 1, of arguments that are missing (records are always whole),
and one whose profile has no target, by a slip. All are asked without predicted activity of insulin, as there.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control.oref0.dose import determine_basal, round_basal
from glucoloop.control.oref0.records import DosingProfile, GlucoseStatus, InsulinOnBoard, MealData, TempBasal

PERSON = {
    "max_iob_U": 2.5,
    "current_basal_U_h": 0.9,
    "max_daily_basal_U_h": 1.3,
    "max_basal_U_h": 3.5,
    "max_bg_mg_dl": 120.0,
    "min_bg_mg_dl": 110.0,
    "sens_mg_dl_U": 40.0,
    "carb_ratio_g_U": 10.0,
    "enable_uam": False,
}
USUAL, NO_TEMP, NO_INSULIN = (115.0, 0.0, 0.0, 1.1), (0.0, 0.0), (0.0, 0.0)
"""Reading with its changes (last, short, long), temporary basal rate and minutes, insulin on board and activity."""
RISES = (185.0, 5.0, 5.0, 5.0)
NOTHING = None
SMALL = {"current_basal_U_h": 0.025, "max_basal_U_h": 0.05, "sens_mg_dl_U": 200.0, "steps_per_U_h": 40}
CASES = {
    "in range, high rate": (USUAL, (1.5, 30.0), NO_INSULIN, {}, (0.9, 0.9), (30, 30)),
    "low and falling": ((75.0, -5.0, -5.0, -5.0), NO_TEMP, NO_INSULIN, {}, (0.0, 0.0), (30, 120)),
    "low, no rate for less than 10 min": ((75.0, -5.0, -5.0, -5.0), (0.0, 57.0), NO_INSULIN, {}, NOTHING, NOTHING),
    "low and rising": ((75.0, 6.0, 6.0, 6.0), NO_TEMP, NO_INSULIN, {}, (0.9, 0.9), (30, 30)),
    "low, rising slower than by insulin": ((75.0, 1.0, 1.0, 1.0), NO_TEMP, (-0.5, -0.01), {}, (0.0, 0.0), (30, 30)),
    "low, falling, insulin": ((75.0, -1.0, -1.0, -1.0), NO_TEMP, (1.0, 0.01), {}, (0.0, 0.0), (30, 120)),
    "85, rising, little insulin": ((85.0, 5.0, 5.0, 5.0), NO_TEMP, (-1.0, -0.01), {}, (1.05, 9.0), (30, 30)),
    "185, rising, up to the safe rate": (RISES, NO_TEMP, (0.0, -0.01), {}, (3.5, 3.5), (30, 30)),
    "rate for too long": ((145.0, 5.0, 5.0, 5.0), (1.9, 160.0), (0.0, -0.01), {}, (0.0, 9.0), (30, 30)),
    "rate that suffices": ((145.0, 5.0, 5.0, 5.0), (3.5, 30.0), (0.0, -0.01), {}, NOTHING, NOTHING),
    "rate that does not": ((145.0, 5.0, 5.0, 5.0), (1.1, 30.0), (0.0, -0.01), {}, (1.15, 9.0), (30, 30)),
    "insulin above max_iob": ((485.0, 5.0, 5.0, 5.0), NO_TEMP, (3.5, 0.05), {}, (0.9, 0.9), (30, 30)),
    "very low, insulin": ((39.0, 0.0, 0.0, -1.1), NO_TEMP, (1.0, 0.01), {}, (0.0, 0.0), (30, 120)),
    "very low, little insulin": ((39.0, 0.0, 0.0, -1.1), NO_TEMP, (-2.5, -0.03), {}, (0.0, 0.75), (30, 120)),
    "very low": ((39.0, 0.0, 0.0, -1.1), NO_TEMP, NO_INSULIN, {}, (0.0, 0.0), (30, 120)),
    "will be below the target": ((110.0, -3.0, -1.0, -1.0), NO_TEMP, NO_INSULIN, {}, (0.0, 0.75), (30, 120)),
    "falling faster": ((115.0, -5.0, -6.0, -6.0), NO_TEMP, (2.0, 0.05), {}, (0.0, 0.15), (30, 120)),
    "156, much insulin": ((156.0, -2.0, -1.33, -1.33), NO_TEMP, (3.51, 0.06), {}, (0.0, 0.75), (30, 30)),
    "barely falling": ((115.0, -1.0, -1.0, -1.0), NO_TEMP, (2.0, 0.05), {}, (0.35, 0.75), (30, 30)),
    "lowish, rising, low rate": ((85.0, 3.0, 3.0, 3.0), (0.5, 20.0), (-0.7, -0.01), {}, (0.85, 9.0), (30, 30)),
    "lowish, rising": ((85.0, 3.0, 3.0, 3.0), (0.5, 0.0), (-0.7, -0.01), {}, (0.9, 0.9), (30, 30)),
    "lowish, rising too slowly": ((85.0, 1.0, 1.0, 1.0), NO_TEMP, (-0.5, -0.01), {}, (0.0, 0.75), (30, 30)),
    "will be above the target": ((120.0, 3.0, 1.0, 0.0), NO_TEMP, NO_INSULIN, {}, (1.05, 9.0), (30, 30)),
    "high, falling, high rate": ((175.0, -5.0, -5.0, -5.0), (2.0, 20.0), (1.0, 0.01), {}, (0.9, 0.9), (30, 30)),
    "high, last fall fastest": ((175.0, -5.0, -4.0, -4.0), (2.0, 20.0), (1.0, 0.01), {}, (0.9, 0.9), (30, 30)),
    "high, falling": ((175.0, -5.0, -4.0, -4.0), NO_TEMP, (1.0, 0.01), {}, (0.9, 0.9), (30, 30)),
    "high, falling slowly": ((175.0, -1.0, -1.0, -1.0), NO_TEMP, (1.0, 0.01), {}, (1.05, 9.0), (30, 30)),
    "300, falling slowly": ((300.0, -1.0, -1.0, -1.0), NO_TEMP, (0.5, 0.005), {}, (2.55, 9.0), (30, 30)),
    "code of an error, no rate": ((10.0, 0.0, 0.0, 0.0), (0.0, 30.0), NO_INSULIN, {}, NOTHING, NOTHING),
    "code of an error, high rate": ((10.0, 0.0, 0.0, 0.0), (2.0, 30.0), NO_INSULIN, {}, (0.9, 0.9), (30, 30)),
    "at most one present basal rate": (
        RISES,
        NO_TEMP,
        (0.0, -0.01),
        {"current_basal_safety_multiplier": 1.0},
        (0.9, 0.9),
        (30, 30),
    ),
    "at most one daily basal rate": (
        RISES,
        NO_TEMP,
        (0.0, -0.01),
        {"max_daily_safety_multiplier": 1.0},
        (1.3, 1.3),
        (30, 30),
    ),
    "ten basal rates": (
        (285.0, 5.0, 5.0, 5.0),
        NO_TEMP,
        (0.0, -0.01),
        {"max_basal_U_h": 5.0, "current_basal_safety_multiplier": 10.0, "max_daily_safety_multiplier": 10.0},
        (5.0, 5.0),
        (30, 30),
    ),
    "small basal rate": (RISES, NO_TEMP, NO_INSULIN, SMALL, (0.05, 0.05), (30, 30)),
    "fine steps of a pump": (
        USUAL,
        NO_TEMP,
        NO_INSULIN,
        {"current_basal_U_h": 0.825, "steps_per_U_h": 40},
        (0.825, 0.825),
        (30, 30),
    ),
    "coarse steps of a pump": (USUAL, NO_TEMP, NO_INSULIN, {"current_basal_U_h": 0.875}, (0.9, 0.9), (30, 30)),
}
ROUNDED = [
    (0.025, 20, 0.05),
    (0.025, 40, 0.025),
    (0.83, 20, 0.85),
    (0.86, 20, 0.85),
    (1.83, 20, 1.85),
    (1.86, 20, 1.85),
    (10.83, 20, 10.8),
    (10.86, 20, 10.9),
]


dose = jax.jit(determine_basal, static_argnames="micro_bolus_allowed")


def profile_of(**changed):
    return DosingProfile(**{**PERSON, **changed})


@pytest.mark.parametrize("name", CASES)
def test_the_dose_is_as_the_original_expects_it(name):
    (bg, delta, short, long), (rate, minutes), (on_board, activity), changed, rates, durations = CASES[name]
    number, none = jnp.asarray, jnp.zeros(0)
    told = dose(
        GlucoseStatus(
            glucose_mg_dl=number(bg),
            delta=number(delta),
            short_avgdelta=number(short),
            long_avgdelta=number(long),
            minutes_ago=number(0.0),
        ),
        TempBasal(rate_U_h=number(rate), duration_min=number(minutes)),
        InsulinOnBoard(
            iob_U=number(on_board),
            activity_U_min=number(activity),
            ahead_U_min=none,
            zero_temp_ahead_U_min=none,
            last_bolus_age_min=number(0.0),
        ),
        MealData(
            carbs_g=number(50.0),
            meal_cob_g=number(0.0),
            slope_from_max_deviation=number(0.0),
            slope_from_min_deviation=number(0.0),
            last_carb_age_min=number(0.0),
        ),
        profile_of(**changed),
        micro_bolus_allowed=False,
    )
    assert bool(told.sets_temp) == (rates is not NOTHING)
    assert float(told.units_U) == 0.0
    if rates is not NOTHING:
        assert rates[0] <= float(told.temp.rate_U_h) <= rates[1]
        assert durations[0] <= float(told.temp.duration_min) <= durations[1]


@pytest.mark.parametrize(("rate", "steps", "expected"), ROUNDED)
def test_rates_are_rounded_to_the_steps_of_the_pump(rate, steps, expected):
    assert float(round_basal(jnp.asarray(rate), profile_of(steps_per_U_h=steps))) == np.float64(expected)
