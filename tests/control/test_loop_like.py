"""The controller after LoopKit's: its curves, its forecast beside PyLoopKit's, its doses in plain Python, any input."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import LoopLike, Observation, Status
from glucoloop.control.loop_like import part_absorbed, rate_of_absorption, time_of_part
from glucoloop.pumps import dose_limits
from glucoloop.therapy import INSULINS, Profile, action_per_min, insulin_left
from other_programs import answer_of

TARGET, BASAL, EVERY, RATIO, SENSITIVITY = 110.0, 1000.0 / 60.0, 5.0, 10.0, 50.0
WIDE = dose_limits(max_change_mU_min=1e4, max_mU_min=1e4)
PROFILE = Profile(basal_mU_min=BASAL, setpoint_mg_dl=TARGET, carb_ratio_g_U=RATIO, correction_mg_dl_U=SENSITIVITY)
AUTOMATIC = LoopLike().of_person(PROFILE, WIDE)
TEMPORARY = LoopLike(dosing="temporary-basal").of_person(PROFILE, WIDE)
step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
observed = jax.jit(lambda controller, state, observation: controller.observed(state, observation))
forecast = jax.jit(lambda controller, state: controller.glucose_ahead(state))
ANY = st.one_of(st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300]))


def observe(glucose=TARGET, *, delivered=BASAL, carbs=0.0, bolus=0.0, valid=True, setpoint=TARGET):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose, float),
        valid=jnp.asarray(valid),
        setpoint_mg_dl=jnp.asarray(setpoint, float),
        delivered_mU_min=jnp.asarray(delivered, float),
        announced_carbs_g=jnp.asarray(carbs, float),
        delivered_bolus_mU=jnp.asarray(bolus, float),
    )


# ------------------------------------------------------------------------------------------- curves


@pytest.mark.long
@given(action=st.floats(200.0, 600.0), part=st.floats(0.05, 0.45))
def test_insulin_acts_from_all_to_nothing_fastest_at_its_peak(action, part):
    peak = part * action
    t = np.linspace(0.0, action, 20_001)
    acts = np.asarray(action_per_min(t, action, peak))
    left = np.asarray(insulin_left(t, action, peak))
    assert left[0] == pytest.approx(1.0, abs=1e-12)
    assert left[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.trapezoid(acts, t) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(np.gradient(left, t)[1:-1], -acts[1:-1], atol=1e-5)
    assert t[acts.argmax()] == pytest.approx(peak, abs=action / 5000.0)
    assert float(insulin_left(-5.0, action, peak)) == pytest.approx(1.0)


def test_a_bolus_lowers_glucose_as_loopkit_says():
    """1.5 U at 40 mg/dl/U, from `effect_from_bolus_output.json` of LoopAlgorithm, whose insulin peaks at 75 min and
    begins 10 min after the bolus at 12:02:37.
    """
    printed = {15: -0.03358203815813976, 60: -9.1483815205968799, 120: -29.142132433822358, 360: -59.970352748819771}
    kind = INSULINS["rapid-adult"]
    for minute, effect in printed.items():
        since = minute - (2.0 + 37.0 / 60.0) - kind.delay_min
        lowered = -60.0 * (1.0 - float(insulin_left(since, kind.action_min, kind.peak_min)))
        assert lowered == pytest.approx(effect, abs=1e-9)


def test_a_meal_is_absorbed_whole_and_the_inverse_is_one():
    x = np.linspace(-0.2, 1.2, 14_001)
    part, rate = np.asarray(part_absorbed(x)), np.asarray(rate_of_absorption(x))
    assert part[0] == 0.0
    assert part[-1] == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(np.gradient(part, x), rate, atol=1e-3)
    inside = (x > 0.0) & (x < 1.0)
    np.testing.assert_allclose(time_of_part(jnp.asarray(part[inside])), x[inside], atol=1e-7)
    assert rate.max() == pytest.approx(2.0 / 1.35)


# ------------------------------------------------------------------------------------------- forecast

PYLOOPKIT = """
import types
from datetime import datetime, time, timedelta
module = types.ModuleType("backports.datetime_fromisoformat")
module.MonkeyPatch = types.SimpleNamespace(patch_fromisoformat=lambda: None)
sys.modules["backports"] = types.ModuleType("backports")
sys.modules["backports.datetime_fromisoformat"] = module
from pyloopkit.dose import DoseType
from pyloopkit.loop_data_manager import update
begin, answers = datetime(2020, 1, 1, 12), []
for case in asked:
    number = len(case["readings"])
    at = [begin + timedelta(minutes=5 * k) for k in range(number)]
    types_, starts, ends, values = [], [], [], []
    for k, (rate, bolus) in enumerate(zip(case["rates"], case["boluses"])):
        types_ += [DoseType.tempbasal, DoseType.bolus]
        starts += [at[k], at[k]]
        ends += [at[k + 1], at[k]]
        values += [rate, bolus]
    found = update({
        "glucose_dates": at, "glucose_values": case["readings"],
        "dose_types": types_, "dose_start_times": starts, "dose_end_times": ends, "dose_values": values,
        # without a meal it takes nothing for unexplained
        "carb_dates": [at[0]], "carb_values": [1e-9], "carb_absorption_times": [180],
        "settings_dictionary": {
            "model": [360, 75], "momentum_data_interval": 15, "suspend_threshold": 75,
            "dynamic_carb_absorption_enabled": False, "retrospective_correction_integration_interval": 30,
            "recency_interval": 15, "retrospective_correction_grouping_interval": 30,
            "default_absorption_times": [120, 180, 240], "max_basal_rate": 4, "max_bolus": 10,
            "retrospective_correction_enabled": True,
        },
        "sensitivity_ratio_start_times": [time(0)], "sensitivity_ratio_end_times": [time(23, 59)],
        "sensitivity_ratio_values": [50],
        "carb_ratio_start_times": [time(0)], "carb_ratio_values": [10],
        "basal_rate_start_times": [time(0)], "basal_rate_minutes": [1440], "basal_rate_values": [1.0],
        "target_range_start_times": [time(0)], "target_range_end_times": [time(23, 59)],
        "target_range_minimum_values": [105], "target_range_maximum_values": [115],
        "last_temporary_basal": [], "time_to_calculate_at": at[-1],
    })
    answers.append(found["predicted_glucose_values"])
print(json.dumps(answers))
"""


def history(seed, samples=20):
    """Readings, basal rates [U/h] and boluses [U] of a person, each sample's rate and bolus after its reading."""
    rng = np.random.default_rng(seed)
    readings = 140.0 + np.cumsum(rng.normal(0.0, 6.0, samples))
    rates = 1.0 + 0.6 * rng.integers(-1, 4, samples - 1)  # PyLoopKit rounds each dose to 0.05 U
    boluses = np.where(rng.uniform(size=samples - 1) < 0.2, rng.uniform(0.5, 3.0, samples - 1), 0.0)
    return readings, rates, boluses


def state_after(controller, readings, rates, boluses, carbs=()):
    state = controller.init(observe(readings[0]))
    told = dict(carbs)
    for k, y in enumerate(readings):
        before = {"delivered": rates[k - 1] * 1000.0 / 60.0, "bolus": boluses[k - 1] * 1000.0} if k else {}
        state = observed(controller, state, observe(y, carbs=told.get(k, 0.0), **before))
    return state


@pytest.mark.long
def test_its_forecast_is_that_of_pyloopkit():
    histories = [history(seed) for seed in range(8)]
    asked = [
        {"readings": list(readings), "rates": list(rates), "boluses": list(boluses)}
        for readings, rates, boluses in histories
    ]
    for (readings, rates, boluses), found in zip(histories, answer_of("pyloopkit", PYLOOPKIT, asked), strict=True):
        own = np.asarray(forecast(AUTOMATIC, state_after(AUTOMATIC, readings, rates, boluses)))
        number = min(len(found), len(own))
        assert number >= 70
        np.testing.assert_allclose(own[:number], found[:number], atol=1e-6)


@pytest.mark.long
def test_at_rest_the_forecast_is_the_reading():
    np.testing.assert_allclose(forecast(AUTOMATIC, state_after(AUTOMATIC, *rest(12))), TARGET, rtol=1e-12)


def rest(samples):
    return np.full(samples, TARGET), np.ones(samples - 1), np.zeros(samples - 1)


def test_insulin_is_conserved():
    """What was given beside the basal rate and has not acted is what acts later; all of it lowers eventual glucose."""
    readings, rates, boluses = history(3)
    state = state_after(AUTOMATIC, readings, rates, boluses)
    ages = EVERY * np.arange(len(rates), 0, -1)
    doses = (rates - 1.0) * EVERY / 60.0 + boluses
    left = np.asarray(insulin_left(ages - 10.0, 360.0, 75.0))
    assert float(jnp.sum(state.acting_U)) == pytest.approx(float(doses @ left), rel=1e-12)


def test_a_meal_and_its_bolus_cancel_in_the_end():
    readings, rates, boluses = rest(12)
    boluses[-1] = 4.0
    state = state_after(AUTOMATIC, readings, rates, boluses, carbs={11: 40.0}.items())
    course = np.asarray(forecast(AUTOMATIC, state))
    # the slope of readings that stay takes the place of half of what happens in the second sample
    replaced = 0.5 * 4.0 * SENSITIVITY * (1.0 - float(insulin_left(5.0, 360.0, 75.0)))
    assert course[-1] == pytest.approx(TARGET + replaced, abs=1e-9)
    assert np.ptp(course) > 10.0


def test_an_unexplained_rise_goes_on_by_as_much_as_it_was():
    """The effect of 30 min falls to 0 within an hour, and its sum is what was unexplained; the slope has faded."""
    readings, rates, boluses = rest(30)
    readings[20:] = TARGET + 3.0 * np.arange(1, 11)
    state = state_after(AUTOMATIC, readings, rates, boluses)
    unexplained = float(jnp.sum(state.unexplained_mg_dl))
    assert unexplained == pytest.approx(21.0)
    assert float(state.readings_mg_dl[0]) == 140.0
    course = np.asarray(forecast(AUTOMATIC, state))
    fades = unexplained / 30.0 * EVERY * np.clip(1.0 - np.arange(12) / 11.0, 0.0, 1.0)
    expected = np.r_[3.0, 0.5 * 3.0 + 0.5 * fades[1], fades[2:]]
    np.testing.assert_allclose(np.diff(course)[:12], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.diff(course)[12:], 0.0, atol=1e-9)


def test_absorption_that_is_seen_is_no_surprise_and_shortens_the_meal():
    readings, rates, boluses = rest(30)
    readings[21:] = TARGET + 8.0 * np.arange(1, 10)
    state = state_after(AUTOMATIC, readings, rates, boluses, carbs={20: 50.0}.items())
    seen = float(state.meals.observed_g[0])
    assert seen == pytest.approx(8.0 * 8.0 / 5.0)  # of the first sample nothing, since the model absorbs nothing yet
    np.testing.assert_allclose(state.unexplained_mg_dl[:7], 0.0, atol=1e-9)
    left = 5.0 * (50.0 - seen)
    course = np.asarray(forecast(AUTOMATIC, state))
    assert course[-1] - course[3] == pytest.approx(left, rel=0.15)


def test_a_meal_of_which_nothing_is_seen_is_absorbed_as_slowly_as_it_may_be():
    state = state_after(AUTOMATIC, *rest(40), carbs={0: 50.0}.items())
    ahead = EVERY * np.arange(75)
    absorbed = np.asarray(part_absorbed((ahead + 195.0 - 10.0) / 280.0))
    effects = 250.0 * np.diff(absorbed)
    effects[0] = 0.0  # the slope of readings that stay takes its place
    corrected = np.diff(np.asarray(forecast(AUTOMATIC, state)))
    velocity = float(jnp.sum(state.unexplained_mg_dl)) / 30.0
    assert velocity < 0.0
    fades = velocity * EVERY * np.clip(1.0 - np.arange(74) / 11.0, 0.0, 1.0)
    np.testing.assert_allclose(corrected[3:], (effects + fades)[3:], atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(1.0, 100.0), min_size=6, max_size=6),
    st.lists(st.floats(40.0, 300.0), min_size=30, max_size=30),
)
def test_no_meal_is_seen_to_be_more_than_it_is(carbs, readings):
    told = {4 * k: amount for k, amount in enumerate(carbs)}
    state = state_after(AUTOMATIC, np.array(readings), np.ones(29), np.zeros(29), carbs=told.items())
    meals = state.meals
    assert np.all(np.asarray(meals.observed_g) >= 0.0)
    assert np.all(np.asarray(meals.observed_g) <= np.asarray(meals.carbs_g) + 1e-9)
    np.testing.assert_allclose(meals.carbs_g, carbs[:1:-1])  # the oldest two are forgotten


# ------------------------------------------------------------------------------------------- doses


def correction(course, kind="rapid-adult"):
    """Units, whether more than the basal rate is allowed, and whether insulin is: LoopKit's rules one by one."""
    action, peak, delay = INSULINS[kind]
    least = None
    for j, glucose in enumerate(course):
        if glucose < 75.0:
            return 0.0, False, False
        t = EVERY * j
        target = 75.0 + (TARGET - 75.0) * max(0.0, 2.0 * t / (action + delay) - 1.0)
        acted = max(1.0 - float(insulin_left(t - delay, action, peak)), 1e-12)
        units = (glucose - target) / (SENSITIVITY * acted)
        if units > 0.0 and (least is None or units < least):
            least = units
    lowest = int(np.argmin(course))
    may = course[lowest] >= TARGET - 5.0
    if course[lowest] < TARGET - 5.0 and course[-1] < TARGET - 5.0:
        acted = max(1.0 - float(insulin_left(EVERY * lowest - delay, action, peak)), 1e-12)
        return (course[lowest] - TARGET) / (SENSITIVITY * acted), may, True
    return (least if course[-1] > TARGET + 5.0 else 0.0), may, True


@functools.cache
def courses():
    found = []
    for seed in range(40):
        readings, rates, boluses = history(seed, samples=12)
        readings = readings - 140.0 + np.random.default_rng(seed).uniform(80.0, 260.0)
        found.append((readings, rates, 0.5 * boluses))
    return found


@pytest.mark.long
def test_doses_are_those_of_the_rules():
    kinds = set()
    for readings, rates, boluses in courses():
        for controller in (AUTOMATIC, TEMPORARY):
            state = state_after(controller, readings[:-1], rates[:-1], boluses[:-1])
            last = observe(readings[-1], delivered=rates[-1] * 1000.0 / 60.0, bolus=boluses[-1] * 1000.0)
            course = np.asarray(forecast(controller, observed(controller, state, last)))
            units, may, any_insulin = correction(course)
            after, decision = step(controller, state, last)
            headroom = 20.0 - float(jnp.sum(after.acting_U))
            rate, bolus = BASAL + units * 1000.0 / 30.0, 0.0
            if controller is AUTOMATIC:
                bolus = float(np.clip(0.4 * units, 0.0, min(4.0, max(headroom, 0.0)))) * 1000.0 if may else 0.0
                rate = np.clip(rate, 0.0, BASAL)
            else:
                most = min(4.0 * BASAL, BASAL + headroom * 1000.0 / 30.0) if may else BASAL
                rate = np.clip(rate, 0.0, max(most, 0.0))
            kinds.add((any_insulin, may, np.sign(units)))
            assert float(decision.insulin_mU_min) == pytest.approx(rate if any_insulin else 0.0, abs=1e-6)
            assert float(decision.bolus_mU) == pytest.approx(bolus, abs=1e-6)
    assert {(False, False, 0.0), (True, True, 1.0)} < kinds
    assert len(kinds) >= 4


LOOPKIT = LoopLike(dosing="temporary-basal", suspend_mg_dl=65.0, max_basal=8.0, max_bolus_U=6.0).of_person(
    Profile(basal_mU_min=BASAL, setpoint_mg_dl=105.0, carb_ratio_g_U=10.0, correction_mg_dl_U=55.0), WIDE
)
"""The settings of LoopAlgorithm's own tests, `AlgorithmInputFixture.mock`."""


def test_the_rate_after_a_suspension_is_that_of_loopkit():
    """4.94 U/h, from `testEnactingRecommendation` of LoopAlgorithm: no insulin from 2 h to 5 min ago, and readings of
    105 to 120 mg/dl in the last 15 min alone.
    """
    state = LOOPKIT.init(observe(105.0, setpoint=105.0))
    for delivered in [BASAL, *[0.0] * 21]:
        state = observed(LOOPKIT, state, observe(math.nan, delivered=delivered, valid=False, setpoint=105.0))
    state = dataclasses.replace(
        state,
        readings_mg_dl=jnp.full(4, 105.0),
        in_a_row=jnp.asarray(1.0),
        stale_min=jnp.asarray(0.0),
        unexplained_mg_dl=jnp.zeros(7),
    )
    for reading, delivered in ((110.0, 0.0), (115.0, 0.0), (120.0, BASAL)):
        state, decision = step(LOOPKIT, state, observe(reading, delivered=delivered, setpoint=105.0))
    assert float(decision.insulin_mU_min) * 60.0 / 1000.0 == pytest.approx(4.94, abs=0.01)


def test_the_absorption_that_is_seen_is_that_of_loopkit():
    """36 % of 20 g, from `testObservedProgressForCarbStatus` of LoopAlgorithm, whose readings rise by 40 mg/dl."""
    readings = [105.0, 105.0, 105.0, 115.0, 120.0, 145.0]
    state = state_after(LOOPKIT, readings, np.ones(5), np.zeros(5), carbs={0: 20.0}.items())
    assert float(state.meals.observed_g[0]) / 20.0 == pytest.approx(0.36, abs=0.01)


def test_a_meal_gets_the_bolus_that_corrects_its_forecast():
    state = state_after(AUTOMATIC, *rest(12))
    for controller in (AUTOMATIC, TEMPORARY):
        _, decision = step(controller, state, observe(carbs=40.0))
        assert float(decision.bolus_mU) == pytest.approx(4000.0, rel=0.01)
        assert float(decision.insulin_mU_min) <= BASAL + 1e-9
    _, decision = step(LoopLike(meal_bolus=0.0).of_person(PROFILE, WIDE), state, observe(carbs=40.0))
    assert float(decision.bolus_mU) == 0.0


def test_old_readings_give_no_dose_but_the_basal_rate():
    state = state_after(AUTOMATIC, np.full(12, 250.0), np.ones(11), np.zeros(11))
    for k in range(6):
        state, decision = step(AUTOMATIC, state, observe(math.nan, valid=False))
        assert int(decision.status) == Status.READING_MISSING
        if k >= 2:
            assert float(decision.bolus_mU) == 0.0
            assert float(decision.insulin_mU_min) == pytest.approx(BASAL)
    _, decision = step(AUTOMATIC, state, observe(math.nan, valid=False, carbs=30.0))
    assert float(decision.bolus_mU) == pytest.approx(3000.0)


@pytest.mark.long
def test_people_trail_and_each_is_as_alone():
    people = AUTOMATIC.with_profile(
        Profile(
            basal_mU_min=jnp.asarray([10.0, 20.0]),
            setpoint_mg_dl=jnp.full(2, TARGET),
            carb_ratio_g_U=jnp.asarray([8.0, 12.0]),
            correction_mg_dl_U=jnp.asarray([40.0, 60.0]),
        )
    )
    state = people.init(
        observe(
            np.full(2, TARGET),
            delivered=np.array([10.0, 20.0]),
            carbs=np.zeros(2),
            setpoint=np.full(2, TARGET),
            bolus=np.zeros(2),
            valid=np.ones(2, bool),
        )
    )
    for glucose, carbs in ((120.0, 0.0), (150.0, 30.0), (190.0, 0.0), (230.0, 0.0)):
        told = observe(
            np.array([glucose, glucose + 5.0]), delivered=np.array([10.0, 20.0]), carbs=np.full(2, carbs),
            setpoint=np.full(2, TARGET), bolus=np.zeros(2), valid=np.ones(2, bool),
        )  # fmt: skip
        state, decision = step(people, state, told)
    for which in range(2):
        one = jax.tree.map(lambda leaf, which=which: leaf[..., which] if jnp.ndim(leaf) else leaf, people)
        alone = one.init(observe(delivered=10.0 * (which + 1)))
        for glucose, carbs in ((120.0, 0.0), (150.0, 30.0), (190.0, 0.0), (230.0, 0.0)):
            alone, own = step(one, alone, observe(glucose + 5.0 * which, carbs=carbs, delivered=10.0 * (which + 1)))
        assert float(own.bolus_mU) == pytest.approx(float(decision.bolus_mU[which]), rel=1e-12)


@pytest.mark.long
@settings(max_examples=100, deadline=None)
@given(numbers=st.tuples(ANY, ANY, ANY, ANY, ANY), valid=st.booleans())
def test_whatever_is_told_doses_are_possible_and_the_memory_is_sound(numbers, valid):
    glucose, carbs, bolus, delivered, setpoint = numbers
    for controller in (AUTOMATIC, TEMPORARY):
        told = observe(glucose, carbs=carbs, bolus=bolus, delivered=delivered, setpoint=setpoint, valid=valid)
        state = controller.init(observe())
        for _ in range(2):
            state, decision = step(controller, state, told)
            assert 0.0 <= float(decision.bolus_mU) <= 25_000.0
            assert 0.0 <= float(decision.insulin_mU_min) <= 1e4
        for leaf in jax.tree.leaves(state):
            assert np.all(np.isfinite(leaf))


def test_settings_that_are_given_stay_with_a_profile():
    own = dataclasses.replace(PROFILE, carb_ratio_g_U=5.0, correction_mg_dl_U=20.0)
    both = LoopLike(carb_ratio_g_U=8.0, correction_mg_dl_U=30.0).of_person(PROFILE, WIDE).with_profile(own)
    assert (float(both.carbs_per_U), float(both.fall_per_U)) == (8.0, 30.0)
    assert float(AUTOMATIC.with_profile(own).settled()["carb_ratio_g_U"]) == 5.0


@pytest.mark.parametrize(
    ("given", "told"),
    [({"carb_ratio_g_U": -1.0}, "carb_ratio_g_U is -1"), ({"suspend_mg_dl": -1.0}, "suspend_mg_dl is -1"),
     ({"max_basal": 0.5}, "max_basal is 0.5"), ({"insulin": "regular"}, "insulin is 'regular'"),
     ({"dosing": "all"}, "dosing is 'all'"), ({"absorption_min": math.inf}, "absorption_min is inf"),
     ({"range_mg_dl": math.nan}, "range_mg_dl is nan")],
)  # fmt: skip
def test_impossible_settings_are_refused_with_a_sentence(given, told):
    with pytest.raises(ValueError, match=told):
        LoopLike(**given).of_person(PROFILE, WIDE)


def test_a_sample_time_in_which_no_reading_counts_is_refused():
    with pytest.raises(ValueError, match="sample time of 20 min"):
        LoopLike().of_person(PROFILE, WIDE, sample_time_min=20.0)


def test_without_a_person_there_is_no_controller():
    with pytest.raises(ValueError, match="loop-like doses by the profile of a person; give it one"):
        LoopLike().init(observe())
