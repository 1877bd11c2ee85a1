"""The guard by forecast: doses that it lets pass, withheld insulin of a meal, and the caps of the usual guard."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static
from glucoloop.control import BasalBolus, Decision, Status, guarded
from glucoloop.control.guard_forecast import Foresight
from glucoloop.control.guard_settings import GUARDS, ForecastSettings, guard_of
from glucoloop.patients.catalogue import DEFAULT_PATIENT, patient_entry
from glucoloop.therapy import Profile
from guarding import damaged, largest_hour, largest_on_board
from observing import observing_meals

BASAL, EVERY = 14.0, 5.0
PROFILE = Profile(basal_mU_min=BASAL, setpoint_mg_dl=110.0, carb_ratio_g_U=11.0, correction_mg_dl_U=45.0)
SETTINGS = ForecastSettings.for_route("subcutaneous")
NONSENSE = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 0.5, 30.0, 1e5, 1e18, 1e300, -1e300])

pytestmark = pytest.mark.long


seen = observing_meals(110.0, BASAL)


stepped = jax.jit(lambda guard, state, observation: guard.step(state, observation))


@functools.cache
def around_basal_bolus():
    return guarded(BasalBolus().of_person(PROFILE), SETTINGS).with_profile(PROFILE)


def followed(guard, readings, carbs):
    """Rates, boluses, statuses and insulin that is owed, the pump doing as it is asked."""
    state, rate, bolus, rows = guard.init(seen(readings[0])), BASAL, 0.0, []
    for reading, eaten in zip(readings, carbs, strict=True):
        state, decision = stepped(guard, state, seen(reading, carbs_g=eaten, delivered=rate, bolus_mU=bolus))
        rate, bolus = float(decision.insulin_mU_min), float(decision.bolus_mU)
        rows.append((rate, bolus, int(decision.status), float(state.foresight.owed_mU)))
    return np.array(rows).T


def test_the_largest_dose_is_that_from_which_the_cautious_forecast_comes_down_to_the_floor():
    """The tangents come near to it and never pass it, however much is wanted."""
    foresight, basal = Foresight.of(SETTINGS, EVERY).with_profile(PROFILE), jnp.asarray(BASAL)
    updated = jax.jit(lambda state, observation: foresight.updated(state, observation, basal, basal * EVERY))
    largest = jax.jit(lambda state, wanted: foresight.largest_dose(state, basal, wanted))

    @jax.jit
    def lowest(state, dose):
        forecaster = foresight._of_basal(basal)
        plan = jnp.zeros(forecaster.ahead.block_min.shape[0]).at[0].set(dose / EVERY)
        return forecaster.expected(forecaster.filter.drifting_down(state.estimate, 1.0), None, plan).min()

    for glucose in (110.0, 150.0, 250.0):
        state = foresight.init(seen(glucose), basal)
        for _ in range(12):
            state = updated(state, seen(glucose))
        low, high = 0.0, 50_000.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if lowest(state, middle) >= SETTINGS.floor_mg_dl else (low, middle)
        assert low > 0.0
        for times in (1.1, 3.0, 20.0, 1000.0):
            assert 0.9 * low < float(largest(state, jnp.asarray(times * low))) <= low * (1.0 + 1e-9), (glucose, times)
        small = jnp.asarray(0.5 * low)
        assert float(largest(state, small)) == float(small)


def test_a_dose_of_which_glucose_stays_high_passes_bit_for_bit():
    rates, boluses, statuses, owed = followed(around_basal_bolus(), [110.0, 111.0, 112.0, 150.0], [0.0, 0.0, 20.0, 0.0])
    np.testing.assert_array_equal(rates, BASAL)
    bare = BasalBolus().of_person(PROFILE)
    _, decision = stepped(bare, bare.init(seen(112.0)), seen(112.0, carbs_g=20.0))
    np.testing.assert_array_equal(boluses, [0.0, 0.0, float(decision.bolus_mU), 0.0])
    np.testing.assert_array_equal(statuses, int(Status.OK))
    np.testing.assert_array_equal(owed, 0.0)


def test_a_meal_bolus_that_a_low_reading_withholds_is_given_when_glucose_is_back():
    readings = [75.0, 70.0, 62.0, 63.0, 66.0, *np.linspace(80.0, 220.0, 15)]
    carbs = [0.0, 0.0, 60.0, *np.zeros(17)]
    rates, boluses, statuses, owed = followed(around_basal_bolus(), readings, carbs)
    due = owed[2]
    assert boluses[2] == 0.0
    assert 60.0 / 11.0 * 0.7 < due / 1000.0 <= 60.0 / 11.0
    assert statuses[2] == Status.SUSPENDED
    assert rates[2] == 0.0
    extra, owes = boluses + EVERY * np.maximum(rates - BASAL, 0.0), owed[2:] > 0.0
    np.testing.assert_allclose((owed[2:] + np.cumsum(extra[2:]))[owes], due)
    assert owed[-1] == 0.0
    # and the basal insulin that was withheld meanwhile, as far as it is not forgotten
    withheld = EVERY * np.sum(np.maximum(BASAL - rates, 0.0))
    assert due + 0.5 * withheld < extra.sum() <= due + withheld


def test_what_is_owed_lapses():
    samples = int(SETTINGS.owed_min / EVERY)
    readings = [70.0, 62.0, *(63.0 + 0.1 * (np.arange(samples) % 2)), *np.linspace(70.0, 130.0, 6)]
    carbs = [0.0, 60.0, *np.zeros(len(readings) - 2)]
    rates, boluses, _, owed = followed(around_basal_bolus(), readings, carbs)
    assert owed[samples] > 3000.0
    np.testing.assert_array_equal(owed[samples + 1 :], 0.0)
    # what is left of the basal insulin that was withheld in these hours, and nothing of the meal's
    left_mU = BASAL * SETTINGS.owed_min * (1.0 - np.exp(-1.0))
    np.testing.assert_array_equal(rates[1 : samples + 1], 0.0)
    assert boluses.sum() <= left_mU * 1.05 < 3000.0


def test_withheld_basal_insulin_is_given_above_the_target_alone():
    falls = 150.0 - 4.0 * np.arange(14)
    for back, given in ((300.0, True), (112.0, False)):
        readings = [*falls, *np.linspace(falls[-1], back, 24)]
        rates, boluses, _, owed = followed(around_basal_bolus(), readings, np.zeros(len(readings)))
        np.testing.assert_array_equal(owed, 0.0)
        extra, withheld = boluses.sum(), EVERY * np.sum(BASAL - rates)
        assert withheld > 0.0
        # basal-bolus itself corrects above 180 mg/dl, by what the reading exceeds the target, less what is on board
        before = extra if back < 180.0 else boluses[: int(np.argmax(np.array(readings) > 180.0))].sum()
        assert (0.3 * withheld < before <= withheld) if given else before == 0.0


def test_half_of_the_basal_rate_is_given_long_after_the_last_reading_whatever_the_forecast():
    readings = [*(250.0 - 8.0 * np.arange(20)), *np.full(30, np.nan)]
    guard = dataclasses.replace(around_basal_bolus(), settings=dataclasses.replace(SETTINGS, low_mg_dl=0.0))
    rates, boluses, statuses, _ = followed(guard, readings, [60.0, *np.zeros(49)])
    gap = statuses == Status.FALLBACK_REDUCED
    assert gap.sum() > 5
    assert rates[20] == 0.0
    np.testing.assert_array_equal(rates[gap], 0.5 * BASAL)
    np.testing.assert_array_equal(boluses[20:], 0.0)


def test_a_reading_at_the_end_of_the_sensor_s_range_may_stay_the_same_if_it_did_not_jump_there():
    rises, carbs = [*np.arange(110.0, 400.0, 10.0), *np.full(24, 400.0)], np.zeros(53)
    _, boluses, statuses, _ = followed(around_basal_bolus(), rises, carbs)
    assert Status.READING_REJECTED not in statuses
    assert np.any(boluses[-18:] > 0.0)
    for readings in ([*np.full(29, 110.0), *np.full(24, 400.0)], [min(reading, 390.0) for reading in rises]):
        _, boluses, statuses, _ = followed(around_basal_bolus(), readings, carbs)
        assert Status.READING_REJECTED in statuses
        np.testing.assert_array_equal(boluses[-18:], 0.0)


def test_its_filter_accepts_slower_guts_than_the_controller_s():
    foresight = Foresight.of(SETTINGS, EVERY).with_profile(PROFILE)
    basal = jnp.asarray(BASAL)
    of_guard = foresight._of_basal(basal)
    own = of_guard.replaced(filter=dataclasses.replace(of_guard.filter, slowest_log_time=0.0))
    for forecaster, slower in ((of_guard, True), (own, False)):
        estimate = forecaster.filter.init(forecaster.model)
        for sample, reading in enumerate([120.0, *np.linspace(120.0, 170.0, 30)]):
            observation = seen(reading, carbs_g=80.0 if sample == 0 else 0.0)
            estimate, _, _ = forecaster.estimated(estimate, None, observation, basal)
        assert (float(estimate.log_gut_time) > 0.1) == slower


def test_without_any_insulin_to_spare_nothing_is_given():
    readings = 150.0 - 4.0 * np.arange(14)
    rates, boluses, statuses, _ = followed(around_basal_bolus(), readings, np.zeros(14))
    assert rates[-1] == 0.0
    assert statuses[-1] in (Status.SUSPENDED, Status.DOSE_LIMITED)
    # by the trend alone the basal rate goes on
    usual = dataclasses.replace(around_basal_bolus(), foresight=None)
    state, by_usual = usual.init(seen(150.0)), []
    for reading in readings:
        state, decision = stepped(usual, state, seen(reading))
        by_usual.append(float(decision.insulin_mU_min))
    np.testing.assert_array_equal(by_usual, BASAL)
    np.testing.assert_array_equal(boluses, 0.0)


def test_it_is_for_subcutaneous_insulin():
    chosen = guard_of(patient_entry("hovorka-2004"), GUARDS.parse("forecast, owed_min=60"))
    assert chosen == dataclasses.replace(SETTINGS, owed_min=60.0)
    sentence = (
        "the guard forecast forecasts subcutaneous insulin, and this insulin is intravenous; give the guard usual"
    )
    with pytest.raises(ValueError, match=sentence):
        guard_of(DEFAULT_PATIENT, GUARDS.parse("forecast"))
    with pytest.raises(ValueError, match=sentence):
        ForecastSettings.for_route("intravenous")


@pytree
class Wilful:
    """Asks for a rate, and for a bolus of as many basal rates, that the setpoint tells it."""

    sample_time_min: float = static()
    gives_boluses: bool = static(default=True)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        told = observation.exercise_in_min
        return state, Decision(insulin_mU_min=told, status=jnp.zeros((), int), bolus_mU=100.0 * told)


@pytest.mark.parametrize("every", [1.0, 5.0, 15.0])
def test_for_any_input_and_memory_doses_are_numbers_and_keep_the_caps(every):
    """Readings, meals and reports are anything, words of the memory are replaced in half of the loops."""
    people, samples = 60, 72
    guard = guarded(Wilful(sample_time_min=every), SETTINGS, basal_mU_min=BASAL)
    rng = np.random.default_rng(round(every))
    words = sum(np.size(leaf) for leaf in jax.tree.leaves(guard.init(shown(np.zeros(5)))))
    high = np.minimum(110.0 + 3.0 * every * np.arange(samples), 450.0)
    shape = (people, samples)
    inputs = np.stack(
        [
            np.where(rng.random(shape) < 0.15, rng.choice(NONSENSE, shape), high + rng.normal(0.0, 5.0, shape)),
            np.where(rng.random(shape) < 0.1, rng.choice([60.0, *NONSENSE], shape), 0.0),
            rng.choice([0.0, 10.0, 40.0, 66.9, 500.0], shape),
            np.where(rng.random(shape) < 0.2, rng.choice(NONSENSE, shape), -2.0),
            np.where(rng.random(shape) < 0.2, rng.choice(NONSENSE, shape), -2.0),
        ],
        axis=-1,
    )
    word = np.where(
        (rng.random(shape) < 0.05) & (np.arange(people)[:, None] % 2 == 1), rng.integers(0, words, shape), -1
    )
    value = rng.choice(NONSENSE, shape)

    @jax.jit
    @jax.vmap
    def loop(inputs, word, value):
        def sample(carry, entry):
            state, rate, bolus = carry
            (reading, carbs, asked, told_rate, told_bolus), which, by = entry
            told = jnp.stack(
                [
                    reading,
                    carbs,
                    asked,
                    jnp.where(told_rate == -2.0, rate, told_rate),
                    jnp.where(told_bolus == -2.0, bolus, told_bolus),
                ]
            )
            state, decision = guard.step(damaged(state, which, by), shown(told))
            finite = jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(state)])
            doses = decision.insulin_mU_min, decision.bolus_mU
            return (state, *doses), (*doses, decision.status, jnp.all(finite))

        start = guard.init(shown(jnp.array([110.0, 0.0, 0.0, BASAL, 0.0])))
        return jax.lax.scan(sample, (start, jnp.asarray(BASAL), jnp.zeros(())), (inputs, word, value))[1]

    rates, boluses, statuses, finite = (np.asarray(one) for one in loop(inputs, word, value))
    assert np.all(finite)
    assert np.all((rates >= 0.0) & (rates <= float(guard.limits.max_mU_min)))
    assert np.all(boluses >= 0.0)
    assert np.all(np.isin(statuses, list(Status)))
    assert np.count_nonzero(boluses) > people
    truthful = ~np.any(word >= 0, axis=1)
    for person in np.flatnonzero(truthful):
        hour = largest_hour(rates[person], boluses[person], every, BASAL)
        assert hour <= SETTINGS.max_hour * (1.0 + 1e-9), person
        on_board = largest_on_board(rates[person], boluses[person], every, SETTINGS.on_board_tau_min, BASAL)
        assert on_board <= SETTINGS.max_on_board + 1e-9, person


def shown(numbers):
    reading, carbs, asked, rate, bolus = numbers
    return dataclasses.replace(
        seen(reading, carbs_g=carbs, delivered=rate, bolus_mU=bolus), exercise_in_min=jnp.asarray(asked, float)
    )
