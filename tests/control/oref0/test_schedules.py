"""oref0 by the clock: its profile and its doses under schedules and temporary targets are those of the npm package."""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import Observation, Oref0
from glucoloop.control.oref0.dose import determine_basal
from glucoloop.control.oref0.inputs import insulin_curve
from glucoloop.control.scheduled import scheduled
from glucoloop.pumps import dose_limits
from glucoloop.situations.therapy_settings import OVERRIDES
from glucoloop.situations.therapy_text import parse_change
from glucoloop.therapy import TARGET, Profile, Schedule
from oref0_package import answers_of, as_written, needs_oref0
from oref0_questions import answered, arguments, call, drawn

COUNT = 10_000
TEXTS = {"basal": "basal", "ratio": "carb_ratio", "sensitivity": "correction", "target": "target"}
"""Numbers of a day, and their names in texts of a therapy."""
BY_SCHEDULE = ("current_basal", "max_daily_basal", "sens", "carb_ratio", "min_bg", "max_bg", "temptargetSet")
PLAIN = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0, carb_ratio_g_U=10.0, correction_mg_dl_U=40.0)
WIDE = dose_limits(max_change_mU_min=500.0, max_mU_min=500.0)


@functools.cache
def days():
    """Days of people: the minute now, segments of each number, and temporary targets."""
    rng = np.random.default_rng(5)

    def segments(value):
        starts = [0, *sorted(5 * rng.choice(np.arange(1, 288), rng.integers(0, 5), replace=False))]
        return [[int(start), float(value())] for start in starts]

    def day():
        minute = int(rng.integers(0, 1440))
        temporary, starts = [], rng.choice(np.arange(0, 1439), rng.integers(0, 7), replace=False)
        for start in sorted(map(int, starts)):
            ends = bool(rng.random() < 0.2 and start <= minute)
            temporary.append([start, 0 if ends else int(rng.integers(5, 300)), int(rng.integers(60, 250))])
        return {
            "minute": minute,
            "basal": segments(lambda: np.round(rng.integers(2, 120) * 0.025, 3)),
            "ratio": segments(lambda: np.round(rng.uniform(4.0, 30.0), 1)),
            "sensitivity": segments(lambda: np.round(rng.uniform(10.0, 150.0), 1)),
            "target": segments(lambda: rng.integers(70, 211)),
            "temporary": temporary,
        }

    return [day() for _ in range(COUNT)]


def schedule_of(day):
    """The same as texts of a therapy and overrides, as the options have them."""
    texts = []
    for name, text in TEXTS.items():
        rows = day[name]
        ends = [*(start for start, _ in rows[1:]), 1440]
        texts += [f"{text}, {value!r}, {start}min-{end}min" for (start, value), end in zip(rows, ends, strict=True)]
    changes = [parse_change(text) for text in texts]
    for number, (start, duration, value) in enumerate(day["temporary"]):
        later = [at for at, minutes, _ in day["temporary"][number + 1 :] if minutes == 0]
        end = min(start + duration, 1440, *later)
        if duration and end > start:
            override = OVERRIDES.choose(f"override, from={start}min, to={end}min, target={value}")
            changes += override.changes()
    return Schedule(tuple(changes))


def profile_now(day, schedule):
    """Numbers of the profile by the names of the package, and the target."""
    now = day["minute"]
    value = functools.partial(schedule.value, time_of_day_min=now)
    rates = [rate for _, rate in day["basal"]]
    return {
        "current_basal": float(value("basal_mU_min", 0.0)) * 60.0 / 1000.0,
        "max_daily_basal": max(rates),
        "sens": float(value("correction_mg_dl_U", 0.0)),
        "carb_ratio": float(value("carb_ratio_g_U", 0.0)),
        "target": float(value(TARGET, 0.0)),
        "temptargetSet": schedule.temporary(now),
    }


@functools.cache
def asked_and_answered():
    of = drawn(COUNT, 31)
    calls = []
    for i, day in enumerate(days()):
        dose = call(of, i)
        dose["profile"] = {name: value for name, value in dose["profile"].items() if name not in BY_SCHEDULE}
        calls.append({**day, "dose": dose})
    return of, answers_of("scheduled", calls)


@needs_oref0
@pytest.mark.long
def test_profile_and_dose_by_the_clock_are_those_of_the_package():
    of, answers = asked_and_answered()
    ours = [profile_now(day, schedule_of(day)) for day in days()]
    columns = {name: np.array([row[name] for row in ours]) for name in ours[0]}
    theirs = {name: np.array([answer["profile"].get(name, False) for answer in answers]) for name in BY_SCHEDULE}
    target = np.round(np.clip(columns["target"], 80.0, 200.0))
    np.testing.assert_allclose(columns["current_basal"], theirs["current_basal"], rtol=1e-12)
    for name, values in {**columns, "min_bg": target, "max_bg": target}.items():
        if name in ("max_daily_basal", "sens", "carb_ratio", "min_bg", "max_bg", "temptargetSet"):
            np.testing.assert_array_equal(values, theirs[name], err_msg=name)
    assert 0.15 < np.mean(columns["temptargetSet"]) < 0.5
    assert np.mean(target != columns["target"]) > 0.02
    whose = {
        "current_basal": np.round(columns["current_basal"], 9),
        "max_daily_basal": columns["max_daily_basal"],
        "sens": columns["sens"],
        "carb_ratio": columns["carb_ratio"],
        "min_bg": target,
        "max_bg": target,
        "temptarget": columns["temptargetSet"],
    }
    given, allowed = arguments({**of, **whose})
    dosed = as_written(determine_basal)
    assert list(answered(dosed(*given, micro_bolus_allowed=allowed), answers)) == []
    usual, _ = arguments({**of, **whose, "temptarget": np.zeros(COUNT, bool)})
    without = list(answered(dosed(*usual, micro_bolus_allowed=allowed), answers))
    assert len(without) > COUNT // 50  # of which a temporary target changes the dose


def observed(glucose_mg_dl, **more):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose_mg_dl),
        valid=jnp.asarray(True),
        setpoint_mg_dl=jnp.asarray(110.0),
        delivered_mU_min=jnp.asarray(10.0),
        announced_carbs_g=jnp.asarray(0.0),
        delivered_bolus_mU=jnp.asarray(0.0),
        **more,
    )


@pytest.mark.long
def test_the_controller_doses_by_the_profile_of_its_time_of_day():
    """Its own arguments, at each segment of some days, beside the numbers of the schedule."""
    controller = Oref0().of_person(PLAIN, WIDE)
    for day in days()[:40]:
        schedule = schedule_of(day)
        by_clock, now = scheduled(controller, schedule, PLAIN), 5.0 * (day["minute"] // 5)
        seen = observed(130.0, time_of_day_min=jnp.asarray(now))
        aimed = by_clock._aimed(seen)
        own = by_clock._now(seen)
        heard = own._heard(own.init(aimed), aimed).profile
        expected = profile_now({**day, "minute": now}, schedule)
        assert float(heard.current_basal_U_h) == round(expected["current_basal"], 9)
        assert float(heard.max_daily_basal_U_h) == expected["max_daily_basal"]
        assert float(heard.sens_mg_dl_U) == expected["sens"]
        assert float(heard.carb_ratio_g_U) == expected["carb_ratio"]
        assert float(heard.min_bg_mg_dl) == float(heard.max_bg_mg_dl) == np.clip(expected["target"], 80.0, 200.0)
        assert bool(heard.temptarget_set) == expected["temptargetSet"]


def test_announced_exercise_is_a_temporary_target():
    own = Oref0().of_person(PLAIN, WIDE)
    seen = observed(130.0)
    for ahead_min, expected in ((30.0, (150.0, True)), (jnp.inf, (110.0, False))):
        told = dataclasses.replace(seen, exercise_in_min=jnp.asarray(ahead_min))
        heard = own._heard(own.init(told), told).profile
        assert (float(heard.min_bg_mg_dl), bool(heard.temptarget_set)) == expected
    assert own._heard(own.init(seen), seen).profile.temptarget_set is False


def test_in_exercise_mode_temporary_rates_so_far_count_against_the_lower_basal_rate():
    """At 160 mg/dl half of the basal rate is needed, so that the basal rate of each of six samples is half too much."""
    mode = Oref0(exercise_mode=True, enable_smb_always=False).of_person(PLAIN, WIDE)
    raised = Oref0(high_temptarget_raises_sensitivity=True, enable_smb_always=False).of_person(PLAIN, WIDE)
    rest = observed(110.0, temporary_target=jnp.asarray(False))
    runs = dataclasses.replace(rest, setpoint_mg_dl=jnp.asarray(160.0), temporary_target=jnp.asarray(True))
    on_board = []
    for controller in (mode, raised):
        state = controller.init(rest)
        temp = dataclasses.replace(state.temp, rate_U_h=jnp.asarray(0.6), duration_min=jnp.asarray(120.0))
        state = dataclasses.replace(state, temp=temp)
        for _ in range(6):
            state = controller._heard(state, rest).state
        on_board.append((controller._heard(state, rest).iob.iob_U, controller._heard(state, runs).iob.iob_U))
    left, _ = insulin_curve(5.0 * np.arange(1.0, 8.0), 5.0, 75.0)
    expected = round(0.025 * float(np.sum(left)), 3)
    assert [float(iob) for pair in on_board for iob in pair] == pytest.approx([0.0, expected, 0.0, 0.0], abs=1e-9)
    assert expected > 0.1
