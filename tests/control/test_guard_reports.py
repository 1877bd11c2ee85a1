"""Reports of a pump that are possible and false: they lower no count of insulin, and lift no dose."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree, static
from glucoloop.component.routes import INTRAVENOUS, ROUTES, SUBCUTANEOUS
from glucoloop.control import Decision, GuardSettings, Status, guarded
from glucoloop.pumps import DoseLimits, LimitedPump
from guarding import BASAL, SETPOINT, Wants, follow, largest_hour, largest_on_board, observe, step


@pytree
class Asks:
    """Asks for the rate that stands in the observation as a meal, and for a bolus of as many minutes of it."""

    sample_time_min: float = static()
    bolus_min: float = static(default=100.0)
    gives_boluses: bool = static(default=True)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        rate = observation.announced_carbs_g
        return state, Decision(
            insulin_mU_min=rate, status=jnp.zeros(rate.shape, int), bolus_mU=self.bolus_min * rate * (rate % 2.0 < 1.0)
        )


@jax.jit
def of_pump(guard, pump, readings, requests, reports):
    """Rates and boluses that a pump delivers, and rates that it is asked for.

    It reports its rate times the first factor and its bolus times the second, or those of the sample before where
    the third number is 1.
    """

    def sample(carry, entry):
        state, in_pump, now, before = carry
        reading, request, (rate_factor, bolus_factor, late) = entry
        rate, bolus = (jnp.where(late > 0.5, old, new) for old, new in zip(before, now, strict=True))
        seen = observe(reading, rate_factor * rate, carbs=request)
        seen = dataclasses.replace(seen, delivered_bolus_mU=bolus_factor * bolus)
        state, decision = guard.step(state, seen)
        in_pump, delivery = pump.deliver(in_pump, decision.insulin_mU_min, jax.random.key(0), decision.bolus_mU)
        doses = delivery.insulin_mU_min, delivery.bolus_mU
        return (state, in_pump, doses, now), (*doses, decision.insulin_mU_min, decision.status)

    basal, none = jnp.asarray(BASAL), jnp.zeros(())
    state = guard.init(dataclasses.replace(observe(readings[0]), delivered_bolus_mU=none))
    start = state, pump.init(basal, jax.random.key(0)), (basal, none), (basal, none)
    return jax.lax.scan(sample, start, (readings, requests, reports))[1]


@functools.lru_cache
def parts(route, every):
    limits = dataclasses.replace(DoseLimits(), **vars(ROUTES[route].pump))
    return guarded(Asks(sample_time_min=every), GuardSettings.for_route(route), limits), LimitedPump(limits=limits)


def rising(n, every):
    """Readings that are accepted and call for much insulin."""
    return SETPOINT + np.minimum(2.0 * every * np.arange(n), 400.0) + 0.1 * (np.arange(n) % 2)


def assert_capped(route, every, rates, boluses):
    caps = GuardSettings.for_route(route)
    assert largest_hour(rates, boluses, every) <= caps.max_hour * (1.0 + 1e-9)
    assert largest_on_board(rates, boluses, every, caps.on_board_tau_min) <= caps.max_on_board + 1e-9


@pytest.mark.parametrize("route", [INTRAVENOUS, SUBCUTANEOUS])
@pytest.mark.parametrize(
    "factors", [(1.0, 0.0, 0.0), (1.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (2.0, 2.0, 0.0), (1.0, 1.0, 1.0)]
)
def test_what_a_pump_gives_keeps_the_caps_whatever_it_reports(route, factors):
    """Eight hours of a controller that asks for more than may be given, and of a pump that gives what it is asked."""
    n, every = 96, 5.0
    reports = np.broadcast_to(np.array(factors)[:, None], (3, n))
    guard, pump = parts(route, every)
    requests = np.where(np.arange(n) % 3 == 0, 950.0, 121.0)
    rates, boluses, _, _ = map(np.asarray, of_pump(guard, pump, rising(n, every), requests, tuple(reports)))
    assert_capped(route, every, rates, boluses)
    assert boluses.max() > 50.0


@pytest.mark.long
@pytest.mark.parametrize("route", [INTRAVENOUS, SUBCUTANEOUS])
@pytest.mark.parametrize("every", [1.0, 3.0, 5.0, 10.0, 15.0])
def test_no_report_that_is_possible_breaks_a_cap(route, every):
    """Reports too small, too large, doubled and late, of rates and of boluses, from sample to sample."""
    guard, pump = parts(route, every)
    n = max(48, round(480.0 / every))

    @settings(max_examples=25, deadline=None)
    @given(
        seed=st.integers(0, 2**32 - 1), truthful=st.sampled_from([0.0, 0.5, 0.9]), change=st.sampled_from([3.0, None])
    )
    def holds(seed, truthful, change):
        rng = np.random.default_rng(seed)
        true = rng.random((2, n)) < truthful
        factors = np.where(true, 1.0, rng.choice([0.0, 0.3, 0.5, 1.0, 1.5, 2.0], (2, n)))
        late = np.where(rng.random(n) < 0.3 * (1.0 - truthful), 1.0, 0.0)
        burst = np.repeat(rng.random(n) < rng.uniform(0.2, 1.0), rng.integers(1, 8))[:n]
        requests = np.where(burst, rng.choice([40.0, 81.0, 200.0, 950.0], n), 0.0)
        slower = guard.limits.max_change_mU_min if change is None else change
        limits = dataclasses.replace(guard.limits, max_change_mU_min=jnp.asarray(slower))
        rates, boluses, _, _ = of_pump(
            dataclasses.replace(guard, limits=limits),
            dataclasses.replace(pump, limits=limits),
            rising(n, every),
            requests,
            (*factors, late),
        )
        assert_capped(route, every, np.asarray(rates), np.asarray(boluses))

    holds()


def test_a_report_of_more_than_was_asked_for_lifts_no_dose():
    """A pump that reports twice its rate is asked for nothing while insulin is suspended."""
    guard = guarded(Wants(rate=60.0))
    state, delivered, doses = guard.init(observe(100.0)), BASAL, []
    for k in range(12):
        state, decision = step(guard, state, observe(100.0 - 8.0 * k if k < 6 else 55.0, 2.0 * delivered))
        delivered = float(decision.insulin_mU_min)
        doses.append(delivered)
    assert int(decision.status) == Status.SUSPENDED
    np.testing.assert_array_equal(doses[-4:], 0.0)


def test_a_bolus_that_the_pump_reports_as_not_given_still_counts():
    guard, _ = parts(SUBCUTANEOUS, 5.0)
    first = dataclasses.replace(observe(SETPOINT), delivered_bolus_mU=jnp.zeros(()))
    state, decision = step(guard, guard.init(first), dataclasses.replace(first, announced_carbs_g=jnp.asarray(950.0)))
    bolus = float(decision.bolus_mU)
    counts = {}
    for part in (0.0, 0.5, 1.0):
        later = dataclasses.replace(observe(SETPOINT + 1.0, decision.insulin_mU_min), delivered_bolus_mU=part * bolus)
        counts[part] = float(step(guard, state, later)[0].doses.counted)
    assert counts[0.0] == counts[0.5] == counts[1.0] > 4.0
    more = dataclasses.replace(observe(SETPOINT + 1.0), delivered_bolus_mU=jnp.asarray(2.0 * bolus))
    assert float(step(guard, state, more)[0].doses.counted) > 1.9 * counts[1.0]


GAP = GuardSettings(gap_min=20.0, long_gap_min=90.0, reduced_fraction=0.5)


@pytest.mark.parametrize("rate", [0.0, 0.3 * BASAL, 0.9 * BASAL, 60.0])
def test_doubt_never_adds_insulin_until_the_long_gap_has_passed(rate):
    """Without an accepted reading the dose is at most that of the controller, which may be nothing, for 90 min."""
    before = [150.0 + 0.1 * (k % 2) for k in range(12)]
    blind = [np.nan, 900.0, 5.0] * 12
    doses, statuses, _ = follow(guarded(Wants(rate=rate), GAP), [*before, *blind])
    since_accepted_min = 5.0 * np.arange(1, len(blind) + 1)
    in_gap, blind_doses = since_accepted_min <= 90.0, doses[12:]
    assert np.all(blind_doses[in_gap] <= np.maximum(min(rate, BASAL), doses[11] - 16.7 * np.arange(1, 19)) + 1e-12)
    assert np.all(statuses[12:][(since_accepted_min > 20.0) & in_gap] == Status.FALLBACK_BASAL)
    # after that no request is followed, of nothing either: no insulin at all for hours ends in ketoacidosis
    np.testing.assert_array_equal(blind_doses[~in_gap], 0.5 * BASAL)
    assert np.all(statuses[12:][~in_gap] == Status.FALLBACK_REDUCED)
