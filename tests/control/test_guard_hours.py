"""Caps of a guard at any sample time: every window of 60 min, and insulin on board at any time, boluses included."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree, static
from glucoloop.control import Decision, GuardSettings, guarded
from glucoloop.pumps import DoseLimits
from guarding import BASAL, SETPOINT, damaged, largest_hour, largest_on_board, observe

SAMPLE_TIMES_MIN = (0.1, 0.7, 1.0, 3.0, 5.0, 7.0, 11.0, 15.0, 25.0, 29.9, 40.0, 45.0, 59.0, 60.0, 61.0, 90.0, 120.0)
USUAL, SKIN = GuardSettings(), GuardSettings.for_route("subcutaneous")
SCARCE = GuardSettings(max_hour=1.3, max_on_board=50.0, fall_mg_dl=1.0, error_mg_dl=0.0, low_mg_dl=0.0)
SETTINGS = {"usual": USUAL, "skin": SKIN, "scarce": SCARCE}


@pytree
class Asks:
    """Asks for what it is told as a meal: the rate, and where it gives boluses a bolus of as many basal rates."""

    sample_time_min: float = static()
    gives_boluses: bool = static(default=False)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        told = observation.announced_carbs_g
        bolus = jnp.where(told % 2.0 < 1.0, 100.0 * told, 0.0) if self.gives_boluses else None
        return state, Decision(insulin_mU_min=told, status=jnp.zeros(told.shape, int), bolus_mU=bolus)


@functools.partial(jax.jit, static_argnames=("silent",))
def doses_of(guard, readings, wanted, damage, *, silent=False):
    """Rates and boluses, the pump doing as it is asked; words of the memory are replaced where `damage` says so."""

    def sample(carry, entry):
        state, delivered, bolus = carry
        reading, want, (word, value) = entry
        told = observe(reading, jnp.nan if silent else delivered, carbs=want)
        if bolus is not None:
            told = dataclasses.replace(told, delivered_bolus_mU=jnp.full_like(bolus, jnp.nan) if silent else bolus)
        state, decision = guard.step(damaged(state, word, value), told)
        doses = decision.insulin_mU_min, decision.bolus_mU
        return (state, *doses), doses

    first = observe(readings[0])
    no_bolus = jnp.zeros(()) if guard.inner.gives_boluses else None
    state = guard.init(dataclasses.replace(first, delivered_bolus_mU=no_bolus))
    return jax.lax.scan(sample, (state, jnp.asarray(BASAL), no_bolus), (readings, wanted, damage))[1]


def samples_for(every):
    return max(40, min(round(240.0 / every), 1200))


@functools.lru_cache
def guard_of(name, every, *, boluses, change):
    limits = DoseLimits(max_change_mU_min=change, max_mU_min=200.0)
    return guarded(Asks(sample_time_min=every, gives_boluses=boluses), SETTINGS[name], limits)


def no_damage(n):
    return np.full(n, -1), np.zeros(n)


def wanted_and_read(rng, n, every):
    """Requests and readings that are high for long, so that the caps are what limits the dose."""
    burst = np.repeat(rng.random(n) < rng.uniform(0.2, 1.0), rng.integers(1, 8))[:n]
    wanted = np.where(burst, rng.choice([40.0, 81.0, 200.0, 950.0], n), 0.0)
    rise = SETPOINT + np.minimum(2.0 * every * np.arange(n), 400.0)
    return wanted, rise + rng.uniform(0.0, 1.0, n)


@pytest.mark.long
@pytest.mark.parametrize("every", SAMPLE_TIMES_MIN)
@pytest.mark.parametrize("boluses", [False, True])
def test_no_window_of_an_hour_and_no_moment_passes_its_cap(every, boluses):
    @settings(max_examples=15 if every >= 1.0 else 4, deadline=None)
    @given(
        seed=st.integers(0, 2**32 - 1),
        name=st.sampled_from(sorted(SETTINGS)),
        change=st.sampled_from([2.0, 16.7, 200.0]),
        share=st.sampled_from([0.4, 1.0, 2.7]),
    )
    def holds(seed, name, change, share):
        caps, n = SETTINGS[name], samples_for(every)
        wanted, read = wanted_and_read(np.random.default_rng(seed), n, every)
        guard = dataclasses.replace(guard_of(name, every, boluses=boluses, change=change), carb_share=share)
        doses = doses_of(guard, read, wanted, no_damage(n))
        rates, given_ = np.asarray(doses[0]), np.zeros(n) if doses[1] is None else np.asarray(doses[1])
        hour = largest_hour(rates, given_, every)
        assert hour <= (1.0 + share * (caps.max_hour - 1.0)) * (1.0 + 1e-9)
        assert largest_on_board(rates, given_, every, caps.on_board_tau_min) <= share * caps.max_on_board + 1e-9

    holds()


@pytest.mark.long
@pytest.mark.parametrize("every", [5.0, 15.0, 40.0])
def test_a_bolus_counts_whole_at_once(every):
    guard = guard_of("skin", every, boluses=True, change=16.7)
    wanted = np.array([0.0, 950.0, 0.0])
    rates, boluses = doses_of(guard, np.full(3, SETPOINT + 1.0), wanted, no_damage(3))
    np.testing.assert_array_less(0.0, boluses[1])
    on_board = largest_on_board(np.asarray(rates), np.asarray(boluses), every, SKIN.on_board_tau_min)
    assert on_board <= SKIN.max_on_board + 1e-12
    assert on_board > 0.9 * SKIN.max_on_board


@pytest.mark.long
@pytest.mark.parametrize("every", SAMPLE_TIMES_MIN)
def test_an_hour_of_any_sample_time_gets_what_it_may(every):
    n = samples_for(every)
    readings = SETPOINT + np.minimum(2.0 * every * np.arange(n), 400.0) + 0.1 * (np.arange(n) % 2)
    rates, _ = doses_of(
        guard_of("usual", every, boluses=False, change=200.0), readings, np.full(n, 200.0), no_damage(n)
    )
    hour = largest_hour(np.asarray(rates), np.zeros(n), every)
    assert hour <= 2.4 * (1.0 + 1e-12)
    assert hour > (1.9 if every > 1.0 else 1.5)


VALUES = [math.nan, math.inf, -math.inf, 1e300, -1e300, -7.0, 0.0, 0.5, 1.0, BASAL, 0.9 * BASAL, 150.0, 1e4, 5e4]


@pytest.mark.long
@pytest.mark.parametrize(("every", "boluses"), [(5.0, False), (5.0, True), (25.0, True), (40.0, False)])
@pytest.mark.parametrize("silent", [False, True])
def test_whatever_word_of_the_memory_is_damaged_the_caps_hold(every, boluses, silent):
    """Every word, replaced in every way, in each case while both caps are nearly reached."""
    n, caps = max(48, round(240.0 / every)), SKIN if boluses else USUAL
    guard = guard_of("skin" if boluses else "usual", every, boluses=boluses, change=200.0)
    wanted = np.where(np.arange(n) % 3 == 0, 950.0, 121.0)
    readings = SETPOINT + np.minimum(2.0 * every * np.arange(n), 400.0) + 0.1 * (np.arange(n) % 2)
    first = dataclasses.replace(observe(100.0), delivered_bolus_mU=jnp.zeros(()) if boluses else None)
    words = sum(np.size(leaf) for leaf in jax.tree.leaves(guard.init(first)))
    when = [2, 5, n // 3]
    cases = [(word, value, k) for word in range(words) for value in VALUES for k in when]
    word = np.full((len(cases), n), -1)
    value = np.zeros((len(cases), n))
    for i, (which, by, k) in enumerate(cases):
        word[i, k], value[i, k] = which, by
    several = jax.vmap(lambda damage: doses_of(guard, readings, wanted, damage, silent=silent))
    rates, given_ = several((jnp.asarray(word), jnp.asarray(value)))
    given_ = np.zeros_like(rates) if given_ is None else np.asarray(given_)
    for of, (one, other) in zip(cases, zip(np.asarray(rates), given_, strict=True), strict=True):
        assert largest_hour(one, other, every) <= caps.max_hour * (1.0 + 1e-9), of
        assert largest_on_board(one, other, every, caps.on_board_tau_min) <= caps.max_on_board + 1e-9, of
