"""Pump faults against plain-Python accounts, and both kinds of faults in a loop."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree
from glucoloop.control import design_imc
from glucoloop.faults import (
    Battery,
    Episodes,
    Misreported,
    MissedPulses,
    Missing,
    Occlusion,
    Spikes,
    always,
    never,
    once,
    recurring,
)
from glucoloop.meals import Meal, Scenario
from glucoloop.pumps import Delivery, LimitedPump, with_resolution
from glucoloop.sensors import white_noise
from glucoloop.simulation import simulate
from glucoloop.simulation.engines import make_engine

SAMPLES = 20
START = 30.0
KEY = jax.random.key(4)
LIMITED = LimitedPump()
COMMANDS = st.lists(
    st.one_of(st.floats(-20.0, 120.0), st.sampled_from([math.nan, math.inf, -math.inf])),
    min_size=SAMPLES,
    max_size=SAMPLES,
)
TIMES = {"start": st.integers(0, SAMPLES + 1), "length": st.integers(1, SAMPLES + 1)}
SWING = 30.0 + 25.0 * np.sin(np.arange(SAMPLES) / 2.0)


@pytree
class ShakyPump:
    """A pump whose dose is random, to see whether a fault disturbs it."""

    def init(self, insulin_mU_min, key):
        return insulin_mU_min + jax.random.uniform(key, jnp.shape(insulin_mU_min))

    def deliver(self, state, command_mU_min, key):
        drawn = command_mU_min + jax.random.uniform(key, jnp.shape(command_mU_min))
        return drawn, Delivery(insulin_mU_min=drawn + 0.1 * state, reported_mU_min=drawn)


FAULTS = {
    "occlusion": lambda when, inner=LIMITED: Occlusion(schedule=when, inner=inner),
    "occlusion that is noticed": lambda when, inner=LIMITED: Occlusion(
        open_fraction=0.3, noticed=True, schedule=when, inner=inner
    ),
    "battery gap": lambda when, inner=LIMITED: Battery(schedule=when, inner=inner),
}


@jax.jit
def scan(pump, commands, key):
    """What a pump that starts at 30 mU/min delivers and reports, with keys as in the loop."""

    def step(state, entry):
        number, command = entry
        return pump.deliver(state, command, jax.random.fold_in(key, number))

    state = pump.init(jnp.full_like(commands[0], START), key)
    return jax.lax.scan(step, state, (jnp.arange(commands.shape[0]), commands))[1]


def delivered(pump, commands, key=KEY):
    delivery = scan(pump, jnp.asarray(commands), key)
    return np.asarray(delivery.insulin_mU_min), np.asarray(delivery.reported_mU_min)


def there_of(start, length):
    number = np.arange(SAMPLES)
    return (number >= start) & (number < start + length)


@settings(max_examples=30)
@given(commands=COMMANDS, open_fraction=st.floats(0.0, 0.99), **TIMES)
def test_an_occlusion_lets_a_fraction_through(commands, open_fraction, start, length):
    inside, _ = delivered(LimitedPump(), commands)
    expected = np.where(there_of(start, length), open_fraction * inside, inside)
    unnoticed = Occlusion(open_fraction=open_fraction, schedule=once(start, length))
    insulin, reported = delivered(unnoticed, commands)
    np.testing.assert_allclose(insulin, expected, rtol=1e-13, atol=1e-300)
    np.testing.assert_array_equal(reported, inside)
    insulin, reported = delivered(
        Occlusion(open_fraction=open_fraction, noticed=True, schedule=once(start, length)), commands
    )
    np.testing.assert_allclose(insulin, expected, rtol=1e-13, atol=1e-300)
    np.testing.assert_array_equal(reported, insulin)


@settings(max_examples=30)
@given(commands=COMMANDS, **TIMES)
def test_after_a_battery_gap_the_pump_starts_from_no_insulin(commands, start, length):
    rate, expected = START, []
    for command, off in zip(commands, there_of(start, length), strict=True):
        wanted = 0.0 if math.isnan(command) else command
        rate = 0.0 if off else min(max(min(max(wanted, rate - 16.7), rate + 16.7), 0.0), 66.9)
        expected.append(rate)
    insulin, reported = delivered(Battery(schedule=once(start, length)), commands)
    np.testing.assert_allclose(insulin, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(reported, np.where(there_of(start, length), math.nan, insulin))


@settings(max_examples=30)
@given(commands=COMMANDS, part=st.floats(0.0, 10.0), late=st.integers(0, 1), **TIMES)
def test_a_misreported_dose_is_delivered_and_a_part_of_it_or_of_the_one_before_is_reported(
    commands, part, late, start, length
):
    inside, _ = delivered(LimitedPump(), commands)
    pump = Misreported(rate_part=part, late_samples=late, schedule=once(start, length))
    insulin, reported = delivered(pump, commands)
    np.testing.assert_array_equal(insulin, inside)
    of = np.r_[START, inside[:-1]] if late else inside
    np.testing.assert_array_equal(reported, np.where(there_of(start, length), part * of, inside))


@pytest.mark.parametrize(("late", "expected"), [(0, [0.0, 500.0, 0.0]), (1, [0.0, 0.0, 500.0])])
def test_of_a_bolus_a_part_is_reported_too(late, expected):
    pump, state, found = Misreported(bolus_part=0.5, late_samples=late), None, []
    state = pump.init(jnp.asarray(START), KEY)
    for bolus in (0.0, 1000.0, 0.0):
        state, delivery = pump.deliver(state, jnp.asarray(START), KEY, jnp.asarray(bolus))
        assert float(delivery.bolus_mU) == bolus
        found.append(float(delivery.reported_bolus_mU))
    assert found == expected
    assert pump.deliver(state, jnp.asarray(START), KEY)[1].reported_bolus_mU is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rate_part": -0.1}, "rate_part is -0.1"),
        ({"bolus_part": math.nan}, "bolus_part is nan"),
        ({"late_samples": 2}, "late_samples is 2"),
    ],
)
def test_an_impossible_report_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Misreported(**given)


def test_what_a_pump_owes_is_forgotten_when_it_has_no_power():
    insulin, _ = delivered(Battery(schedule=once(2, 3), inner=with_resolution(4.0)), np.full(SAMPLES, 6.0))
    np.testing.assert_array_equal(insulin[2:8], [0.0, 0.0, 0.0, 4.0, 8.0, 4.0])


def test_pulses_are_missed_with_their_probability():
    commands = np.full(4000, START)
    insulin, reported = delivered(MissedPulses(0.2), commands)
    assert set(insulin) == {0.0, START}
    np.testing.assert_array_equal(reported, START)
    lost = insulin == 0.0
    assert abs(lost.mean() - 0.2) < 5.0 * np.sqrt(0.2 * 0.8 / lost.size)
    assert abs(np.corrcoef(lost[:-1], lost[1:])[0, 1]) < 5.0 / np.sqrt(lost.size)
    insulin, reported = delivered(MissedPulses(0.2, noticed=True), commands)
    np.testing.assert_array_equal(insulin == 0.0, lost)
    np.testing.assert_array_equal(reported, insulin)
    other, _ = delivered(MissedPulses(0.2, key=1), commands)
    assert abs(np.corrcoef(lost, other == 0.0)[0, 1]) < 5.0 / np.sqrt(lost.size)


@pytest.mark.parametrize("name", FAULTS)
def test_without_an_episode_not_one_bit_changes(name):
    expected = delivered(ShakyPump(), SWING)
    np.testing.assert_array_equal(delivered(FAULTS[name](never(), ShakyPump()), SWING), expected)
    found = np.array(delivered(FAULTS[name](once(6, 3), ShakyPump()), SWING))
    there = there_of(6, 4 if name == "battery gap" else 3)  # the pump then starts again
    np.testing.assert_array_equal(found[:, ~there], np.array(expected)[:, ~there])
    assert np.all(found[0, there] != expected[0][there])


@pytest.mark.parametrize("name", FAULTS)
def test_a_key_gives_one_course(name):
    pump = FAULTS[name](recurring(0.3, 2), ShakyPump())
    first = delivered(pump, SWING)
    np.testing.assert_array_equal(delivered(pump, SWING), first)
    assert np.any(delivered(pump, SWING, jax.random.key(5))[0] != first[0])


@pytest.mark.parametrize("name", FAULTS)
def test_many_people_are_each_alone(name):
    starts, lengths = np.array([0.0, 5.0, 9.0]), np.array([4.0, np.inf, 3.0])
    commands = SWING[:, None] + np.array([0.0, 20.0, -15.0])
    people = Episodes(earliest=starts, latest=starts, length=lengths)
    together = delivered(FAULTS[name](people), commands)
    for i in range(3):
        alone = delivered(FAULTS[name](once(int(starts[i]), lengths[i])), commands[:, i])
        np.testing.assert_array_equal([part[:, i] for part in together], alone)


@pytest.mark.parametrize("fraction", [-0.1, 1.0, math.nan, math.inf])
def test_an_impossible_open_fraction_is_refused(fraction):
    with pytest.raises(ValueError, match=r"open_fraction is .*; give a number of 0 or more and below 1"):
        Occlusion(open_fraction=fraction, schedule=always())


def test_an_impossible_probability_of_a_missed_pulse_is_refused():
    with pytest.raises(ValueError, match=r"share is 1.5; give a number from 0 to 1"):
        MissedPulses(1.5)


# with faults of the sensor

SENSOR = Missing(
    schedule=recurring(0.1, 2), inner=Spikes(25.0, schedule=once(2, 3, latest_sample=9, key=1), inner=white_noise())
)
PUMP = MissedPulses(
    0.1,
    key=1,
    inner=Occlusion(
        schedule=once(15, 6), inner=Battery(schedule=once(30, 4), inner=with_resolution(0.5, least_mU_min=1.0))
    ),
)
WALK = 120.0 + 60.0 * np.sin(np.arange(48) / 4.0)


def by_engine(name):
    """Readings, and what a pump makes of doses in proportion to them, of three people."""

    def step(own, state, reaching, shared, rng):
        del own, reaching
        key = jax.random.fold_in(*rng)
        in_sensor, reading = SENSOR.read(state[0], shared["glucose"], key)
        in_pump, delivery = PUMP.deliver(state[1], 0.2 * reading.glucose_mg_dl, jax.random.fold_in(key, 7))
        return (in_sensor, in_pump), (reading, delivery)

    def init(key):
        return SENSOR.init(jnp.asarray(120.0), key), PUMP.init(jnp.asarray(START), key)

    keys = jax.random.split(KEY, 3)
    state = jax.jit(jax.vmap(init, out_axes=-1))(keys)
    example = jax.tree.map(lambda leaf: leaf[..., 0], state)
    engine = make_engine(step, (), example, {}, {"glucose": WALK[0]}, KEY, name=name, precision="float64")
    assert engine.name == name
    return engine.run((), state, {}, {"glucose": WALK}, keys)[1]


def test_native_code_takes_every_pump_fault_and_computes_the_same():
    native, mapped = by_engine("native"), by_engine("xla")
    for found, expected in zip(jax.tree.leaves(native), jax.tree.leaves(mapped), strict=True):
        np.testing.assert_allclose(np.asarray(found, float), np.asarray(expected, float), rtol=0.0, atol=1e-9)
    reading, delivery = mapped
    insulin, reported = delivery.insulin_mU_min, delivery.reported_mU_min
    np.testing.assert_array_equal(insulin[15:21], 0.0)
    np.testing.assert_array_equal(insulin[30:34], 0.0)
    assert np.all(np.isnan(reported[30:34]))
    assert np.all(reported[15:21] > 0.0)
    assert np.any(~reading.valid)
    assert np.all(np.isfinite(insulin))


@pytest.mark.long
def test_an_absent_fault_changes_no_bit_of_a_run(patient_81):
    controller, scenario = design_imc(-3.0, 80.0, 5.0), Scenario([Meal(50.0, 30.0)], 120.0)
    plain = simulate(patient_81, controller, white_noise(), LimitedPump(), scenario, 3)
    quiet = simulate(
        patient_81,
        controller,
        Missing(schedule=never(), inner=Spikes(25.0, schedule=recurring(0.0), inner=white_noise())),
        Occlusion(schedule=never(), inner=Battery(schedule=never())),
        scenario,
        3,
    )
    for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(quiet), strict=True):
        np.testing.assert_array_equal(one, other)
