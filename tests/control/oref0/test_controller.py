"""The controller oref0: a day of its doses is that of the npm package, and what a person and a pump do is told."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import Observation, Oref0, Status
from glucoloop.control.oref0.inputs import TICKS
from glucoloop.pumps import dose_limits
from glucoloop.refusal import Refusal
from glucoloop.therapy import Profile
from oref0_package import answers_of, as_written, needs_oref0

PERSON = Profile(basal_mU_min=18.0, setpoint_mg_dl=104.0, carb_ratio_g_U=9.0, correction_mg_dl_U=38.0)
WIDE = dose_limits(max_change_mU_min=200.0, max_mU_min=200.0, min_mU_min=0.0)
BASAL_U_H = 18.0 * 60.0 / 1000.0
AHEAD = [5 * i for i in range(TICKS)]


def observed(glucose, *, carbs=0.0, delivered=18.0, bolus=0.0, valid=True, setpoint=104.0):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose, float),
        valid=jnp.asarray(valid),
        setpoint_mg_dl=jnp.asarray(setpoint, float),
        delivered_mU_min=jnp.asarray(delivered, float),
        announced_carbs_g=jnp.asarray(carbs, float),
        delivered_bolus_mU=jnp.asarray(bolus, float),
    )


def followed(controller, readings, carbs):
    """Decisions and states before and after each sample, with a pump that gives what it is asked for."""

    def sample(carry, row):
        state, rate, bolus = carry
        after, decision = controller.step(state, observed(row[0], carbs=row[1], delivered=rate, bolus=bolus))
        given = controller.bolus.allowed(decision.bolus_mU)
        return (after, decision.insulin_mU_min, given), (decision, given, state.temp, after.temp)

    start = (controller.init(observed(readings[0])), jnp.asarray(18.0), jnp.asarray(0.0))
    return jax.lax.scan(sample, start, (readings, carbs))[1]


# ------------------------------------------------------------------------------------------- against the package


@needs_oref0
@pytest.mark.long
@pytest.mark.parametrize("announced", [True, False])
def test_a_day_of_doses_is_that_of_the_package(announced):
    settings = Oref0(enable_smb_always=True, max_iob_U=8.0, insulin_action_min=360.0)
    controller = settings.of_person(PERSON, WIDE)
    rng, count = np.random.default_rng(4), 288
    t = np.arange(count)
    meals = 90.0 * np.exp(-(((t - 85.0) / 18.0) ** 2)) + 110.0 * np.exp(-(((t - 200.0) / 20.0) ** 2))
    readings = np.round(np.clip(105.0 + meals + 12.0 * np.sin(t / 9.0) + rng.normal(0.0, 2.0, count), 45.0, 390.0))
    carbs = np.where(np.isin(t, [70, 182]) & announced, 60.0, 0.0)
    decision, given, before, after = as_written(lambda r, c: followed(controller, r, c))(readings, carbs)
    rates, boluses = np.asarray(decision.insulin_mU_min) * 60.0 / 1000.0, np.asarray(given) / 1000.0
    by_hand = np.floor(carbs / 9.0 / 0.05 + 1e-9) * 0.05
    temp_rate, temp_minutes = np.asarray(after.rate_U_h), np.asarray(after.duration_min)

    first = 75  # the histories of the package begin with the day, those of the controller before it
    asked = {"glucose": [], "iob": [], "without": [], "absorption": []}
    insulin = (rates - BASAL_U_H) / 12.0 + boluses
    profile = {"dia": 6.0, "curve": "rapid-acting", "current_basal": BASAL_U_H, "sens": 38.0, "carb_ratio": 9.0}
    profile["min_5m_carbimpact"] = 8.0
    for k in range(first, count):
        past = [[5 * (k - i), float(readings[i])] for i in range(k, -1, -1)]
        doses = [[5 * (k - i), float(insulin[i])] for i in range(k - 1, -1, -1)]
        doses = [[0, float(by_hand[k])], *doses]
        whose = {"treatments": doses, "profile": profile}
        asked["glucose"].append({"readings": past})
        asked["iob"].append({**whose, "ahead": AHEAD})
        zero = [[-minutes, -BASAL_U_H / 12.0] for minutes in AHEAD]
        asked["without"].append({**whose, "treatments": [*doses, *zero], "ahead": AHEAD})
        eaten = np.flatnonzero(carbs[max(0, k - 71) : k + 1])
        since = 5 * (k - max(0, k - 71) - int(eaten[-1])) if eaten.size else 0
        story = {**whose, "readings": past}
        asked["absorption"] += [{**story, "since": since}, {**story, "since": 360, "now": True}]
    told = {"glucose": answers_of("glucose", asked["glucose"]), "iob": answers_of("iob", asked["iob"])}
    told["without"] = answers_of("iob", asked["without"])
    told["absorption"] = answers_of("absorption", asked["absorption"])

    calls = []
    for j, k in enumerate(range(first, count)):
        iob = [
            {"iob": i, "activity": a, "iobWithZeroTemp": {"activity": z}}
            for (i, a), (_, z) in zip(told["iob"][j], told["without"][j], strict=True)
        ]
        earlier = np.flatnonzero(boluses[:k])
        iob[0]["last_bolus_age"] = 0 if by_hand[k] else 5 * (k - int(earlier[-1])) if earlier.size else 9999
        eaten = np.flatnonzero(carbs[max(0, k - 71) : k + 1])
        on_board = max(0.0, 60.0 - told["absorption"][2 * j]["carbsAbsorbed"]) if eaten.size else 0.0
        deviations = told["absorption"][2 * j + 1]
        names = ("slopeFromMaxDeviation", "slopeFromMinDeviation")
        slopes = {name: float(np.floor(deviations[name] * 1000.0 + 0.5) / 1000.0) for name in names}
        left = max(float(before.duration_min[k]) - 5.0, 0.0)
        calls.append(
            {
                "glucose": {**told["glucose"][j], "minutes_ago": 0},
                "temp": {"rate": float(before.rate_U_h[k]) if left else 0.0, "duration": left, "temp": "absolute"},
                "iob": iob,
                "profile": {
                    **profile,
                    "max_daily_basal": BASAL_U_H,
                    "max_basal": 12.0,
                    "min_bg": 104,
                    "max_bg": 104,
                    "max_iob": 8.0,
                    "enableUAM": True,
                    "enableSMB_always": True,
                    "maxSMBBasalMinutes": 30,
                    "maxUAMSMBBasalMinutes": 30,
                },
                "meal": {
                    "carbs": 60.0 if eaten.size else 0.0,
                    "mealCOB": float(np.floor(on_board + 0.5)),
                    **slopes,
                    "last_carb_age": asked["absorption"][2 * j]["since"],
                },
                "allowed": True,
            }
        )
    answers = answers_of("dose", calls)
    micro = np.asarray(decision.bolus_mU) / 1000.0 - by_hand
    for j, k in enumerate(range(first, count)):
        answer = answers[j]
        sets = "rate" in answer
        expected = (
            (answer["rate"], answer["duration"]) if sets else (calls[j]["temp"]["rate"], calls[j]["temp"]["duration"])
        )
        assert (temp_rate[k], temp_minutes[k]) == expected, (k, answer["reason"])
        assert micro[k] == pytest.approx(answer.get("units", 0.0), abs=1e-9), (k, answer["reason"])
    assert np.sum(micro > 0.05) > 10
    assert np.ptp(temp_rate) > 1.0


# ------------------------------------------------------------------------------------------- person and pump


@pytest.mark.long
def test_a_person_gives_the_bolus_of_a_meal_by_the_ratio_or_a_part_of_it_or_none():
    for share, expected in ((1.0, 5000.0), (0.5, 2500.0), (0.0, 0.0)):
        controller = Oref0(meal_bolus=share).of_person(PERSON, WIDE)
        seen = observed(104.0, carbs=45.0)
        _, decision = controller.step(controller.init(seen), seen)
        assert float(decision.bolus_mU) == pytest.approx(expected)


@pytest.mark.long
def test_a_bolus_that_was_given_is_on_board_and_one_that_was_not_is_not():
    controller = Oref0().of_person(PERSON, WIDE)
    seen = observed(104.0, carbs=45.0)
    state, decision = controller.step(controller.init(seen), seen)
    assert float(decision.bolus_mU) == pytest.approx(5000.0)
    given, _ = controller.step(state, observed(104.0, bolus=5000.0))
    kept, _ = controller.step(state, observed(104.0, bolus=0.0))
    silent, _ = controller.step(state, dataclasses.replace(observed(104.0), delivered_bolus_mU=None))
    assert float(given.insulin_U[0]) == float(silent.insulin_U[0]) == pytest.approx(5.0)
    assert float(kept.insulin_U[0]) == pytest.approx(0.0)


def test_settings_that_are_given_stand_above_the_profile_of_a_person():
    other = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0, carb_ratio_g_U=20.0, correction_mg_dl_U=80.0)
    by_profile = Oref0().of_person(PERSON, WIDE).with_profile(other)
    settled = {name: float(value) for name, value in by_profile.settled().items()}
    assert settled["carb_ratio_g_U"] == 20.0
    assert settled["correction_mg_dl_U"] == 80.0
    # twice the basal dose of 14.4 U a day is the daily dose, of which half is for three meals
    assert settled["max_iob_U"] == pytest.approx(3.0 * 0.6 + 28.8 / 6.0)
    given = Oref0(carb_ratio_g_U=7.0, correction_mg_dl_U=30.0, max_iob_U=3.0)
    settled = given.of_person(PERSON, WIDE).with_profile(other).settled()
    assert [float(settled[name]) for name in ("carb_ratio_g_U", "correction_mg_dl_U", "max_iob_U")] == [7.0, 30.0, 3.0]


@pytest.mark.long
def test_high_glucose_brings_microboluses_and_low_glucose_stops_insulin():
    controller = Oref0().of_person(PERSON, WIDE)
    rising = followed(controller, 140.0 + 3.0 * np.arange(8.0), np.zeros(8))[0]
    assert np.asarray(rising.bolus_mU)[-1] > 0.0
    without = Oref0(enable_smb_always=False)
    rates = followed(without.of_person(PERSON, WIDE), 140.0 + 3.0 * np.arange(8.0), np.zeros(8))[0]
    assert np.all(np.asarray(rates.bolus_mU) == 0.0)
    assert np.asarray(rates.insulin_mU_min)[-1] > 40.0
    falling = followed(controller, 120.0 - 7.0 * np.arange(10.0), np.zeros(10))[0]
    assert np.asarray(falling.insulin_mU_min)[-1] == 0.0
    assert np.all(np.asarray(falling.bolus_mU)[4:] == 0.0)


@pytest.mark.long
def test_without_a_reading_for_over_10_min_a_high_rate_ends():
    controller = Oref0(enable_smb_always=False).of_person(PERSON, WIDE)
    state, rate = controller.init(observed(150.0)), 18.0
    for reading in 150.0 + 4.0 * np.arange(6.0):
        state, decision = controller.step(state, observed(reading, delivered=rate))
        rate = float(decision.insulin_mU_min)
    assert rate > 40.0
    rates = []
    for _ in range(4):
        state, decision = controller.step(state, observed(np.nan, delivered=rate, valid=False))
        rate = float(decision.insulin_mU_min)
        rates.append(rate)
        assert int(decision.status) == Status.READING_MISSING
    assert rates[1] > 40.0
    assert rates[2] == pytest.approx(round(BASAL_U_H * 20.0) / 20.0 * 1000.0 / 60.0)


def test_without_a_first_reading_glucose_is_taken_to_be_at_the_target_of_the_moment():
    controller = Oref0().of_person(PERSON, WIDE)
    for setpoint, expected in ((120.0, 120.0), (np.nan, 104.0)):
        state = controller.init(observed(np.nan, valid=False, setpoint=setpoint))
        np.testing.assert_array_equal(state.glucose_mg_dl, expected)
    of_basal_rate = controller.with_basal(jnp.asarray(18.0)).init(observed(np.nan, valid=False))
    np.testing.assert_array_equal(of_basal_rate.glucose_mg_dl, 104.0)


def test_what_is_not_possible_is_refused():
    with pytest.raises(Refusal, match="every 5 min"):
        Oref0().of_person(PERSON, WIDE, sample_time_min=15.0)
    with pytest.raises(Refusal, match="basal rate"):
        Oref0().of_person(dataclasses.replace(PERSON, basal_mU_min=500.0), WIDE)
    with pytest.raises(Refusal, match="from 35 to 100 min"):
        Oref0(curve="ultra-rapid", insulin_peak_min=110.0)
    with pytest.raises(Refusal, match="insulin_action_min"):
        Oref0(insulin_action_min=240.0)
