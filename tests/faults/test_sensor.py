"""Every fault against a plain-Python account of what it does to the readings of the sensor inside."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree
from glucoloop.faults import FAULTS as CATALOGUE
from glucoloop.faults import (
    Calibration,
    Compression,
    Drift,
    Episodes,
    Late,
    Missing,
    Nonsense,
    OutOfOrder,
    Repeated,
    Saturation,
    Spikes,
    Stuck,
    always,
    never,
    once,
    recurring,
)
from glucoloop.sensors import IdealSensor, dead_time, white_noise
from glucoloop.simulation.engines import make_engine

SAMPLES = 20
START = 100.0
NOISY = white_noise(1.45, 5.0, inner=dead_time(1))
KEY = jax.random.key(11)
IDEAL = IdealSensor()

FAULTS = {
    "missing": lambda episodes, inner=IDEAL: Missing(schedule=episodes, inner=inner),
    "nonsense": lambda episodes, inner=IDEAL: Nonsense(2000.0, schedule=episodes, inner=inner),
    "no number": lambda episodes, inner=IDEAL: Nonsense(math.nan, schedule=episodes, inner=inner),
    "spikes": lambda episodes, inner=IDEAL: Spikes(-30.0, schedule=episodes, inner=inner),
    "stuck": lambda episodes, inner=IDEAL: Stuck(schedule=episodes, inner=inner),
    "drift": lambda episodes, inner=IDEAL: Drift(24.0, schedule=episodes, inner=inner),
    "calibration": lambda episodes, inner=IDEAL: Calibration(1.3, -7.0, schedule=episodes, inner=inner),
    "compression": lambda episodes, inner=IDEAL: Compression(0.4, tau_min=12.0, schedule=episodes, inner=inner),
    "saturation": lambda episodes, inner=IDEAL: Saturation(90.0, 150.0, schedule=episodes, inner=inner),
    "late": lambda episodes, inner=IDEAL: Late(15.0, schedule=episodes, inner=inner),
    "repeated": lambda episodes, inner=IDEAL: Repeated(3, schedule=episodes, inner=inner),
    "out of order": lambda episodes, inner=IDEAL: OutOfOrder(4, schedule=episodes, inner=inner),
}


# What becomes of readings (value, valid), given the age of the fault at each, -1 where there is none.


def plain_missing(readings, ages):
    return [(math.nan, False) if a >= 0 else r for r, a in zip(readings, ages, strict=True)]


def plain_nonsense(readings, ages, value=2000.0):
    return [(value, True) if a >= 0 else r for r, a in zip(readings, ages, strict=True)]


def changed(change):
    def of(readings, ages):
        return [(change(g, a), ok) if a >= 0 else (g, ok) for (g, ok), a in zip(readings, ages, strict=True)]

    return of


def plain_stuck(readings, ages):
    return [readings[t - a] if a >= 0 else readings[t] for t, a in enumerate(ages)]


def plain_repeated(readings, ages):
    return [readings[t - a % 3] if a >= 0 else readings[t] for t, a in enumerate(ages)]


def plain_late(readings, ages):
    line = [(START, True)] * 3 + readings
    return [line[t] if a >= 0 else readings[t] for t, a in enumerate(ages)]


def plain_compression(readings, ages):
    told, fall = [], 0.0
    for (glucose, ok), age in zip(readings, ages, strict=True):
        goal = 0.4 if age >= 0 else 0.0
        fall = goal + math.exp(-5.0 / 12.0) * (fall - goal)
        if age < 0 and fall <= 1e-4:
            fall = 0.0
        told.append((glucose * (1.0 - fall), ok))
    return told


PLAIN = {
    "missing": plain_missing,
    "nonsense": plain_nonsense,
    "no number": lambda readings, ages: plain_nonsense(readings, ages, math.nan),
    "spikes": changed(lambda glucose, age: glucose - 30.0),
    "stuck": plain_stuck,
    "drift": changed(lambda glucose, age: glucose + 2.0 * age),
    "calibration": changed(lambda glucose, age: 1.3 * glucose - 7.0),
    "compression": plain_compression,
    "saturation": changed(lambda glucose, age: glucose if math.isnan(glucose) else min(max(glucose, 90.0), 150.0)),
    "late": plain_late,
    "repeated": plain_repeated,
}


@pytree
class SideBySide:
    """Sensors that see the same glucose, so that all are compiled at once."""

    sensors: dict

    def init(self, glucose_mg_dl, key):
        return {name: sensor.init(glucose_mg_dl, key) for name, sensor in self.sensors.items()}

    def read(self, state, glucose_mg_dl, key):
        read = {name: sensor.read(state[name], glucose_mg_dl, key) for name, sensor in self.sensors.items()}
        return {name: state for name, (state, _) in read.items()}, {name: told for name, (_, told) in read.items()}


def every_fault(episodes, inner=IDEAL):
    return SideBySide(sensors={name: make(episodes, inner) for name, make in FAULTS.items()})


@jax.jit
def scan(sensor, glucose, key):
    """Readings of a sensor that starts at 100 mg/dl, with keys as in the loop."""
    first, rest = jax.random.split(key)

    def step(state, entry):
        number, value = entry
        return sensor.read(state, value, jax.random.fold_in(rest, number))

    state = sensor.init(jnp.full_like(glucose[0], START), first)
    return jax.lax.scan(step, state, (jnp.arange(glucose.shape[0]), glucose))[1]


def parts(reading):
    return np.asarray(reading.glucose_mg_dl), np.asarray(reading.valid)


def told(sensor, glucose, key=KEY):
    return parts(scan(sensor, jnp.asarray(glucose), key))


def pairs(sensor, glucose):
    values, valid = told(sensor, glucose)
    return list(zip(values.tolist(), valid.tolist(), strict=True))


def ages_of(start, length):
    return [t - start if 0 <= t - start < length else -1 for t in range(SAMPLES)]


GLUCOSE = st.lists(st.one_of(st.floats(20.0, 500.0), st.just(math.nan)), min_size=SAMPLES, max_size=SAMPLES)
WALK = 120.0 + 40.0 * np.sin(np.arange(SAMPLES) / 3.0)


def same(found, expected):
    np.testing.assert_allclose([v for v, _ in found], [v for v, _ in expected], rtol=1e-13)
    assert [ok for _, ok in found] == [bool(ok) for _, ok in expected]


@pytest.mark.long
@pytest.mark.parametrize("name", PLAIN)
@settings(max_examples=40)
@given(glucose=GLUCOSE, start=st.integers(0, SAMPLES + 1), length=st.integers(1, SAMPLES + 1))
def test_a_fault_does_what_it_should_to_the_very_readings_inside(name, glucose, start, length):
    inside = pairs(NOISY, glucose)  # so the noise is as it is without the fault
    same(pairs(FAULTS[name](once(start, length), NOISY), glucose), PLAIN[name](inside, ages_of(start, length)))


@pytest.mark.long
def test_every_fault_of_a_sensor_in_the_catalogue_is_tried_here():
    known = {name for name, entry in CATALOGUE.items() if entry.part == "sensor"}
    assert known <= {name.replace(" ", "-") for name in FAULTS}


@pytest.mark.long
@pytest.mark.parametrize("name", FAULTS)
def test_without_an_episode_not_one_bit_changes(name):
    expected = told(NOISY, WALK)
    np.testing.assert_array_equal(told(FAULTS[name](never(), NOISY), WALK), expected)
    early, late_on = 6, 8
    found = told(FAULTS[name](once(early, late_on - early), NOISY), WALK)
    before = slice(early)
    np.testing.assert_array_equal([part[before] for part in found], [part[before] for part in expected])
    if name != "compression":  # which takes its time to recover
        after = slice(late_on, None)
        np.testing.assert_array_equal([part[after] for part in found], [part[after] for part in expected])


def test_compression_is_over_after_a_while_and_then_changes_nothing():
    glucose = np.full(80, 130.0)
    values, _ = told(Compression(0.4, tau_min=12.0, schedule=once(2, 10), inner=NOISY), glucose)
    inside, _ = told(NOISY, glucose)
    share = values / inside
    assert np.all(np.diff(share[2:12]) < 0.0)
    assert share[11] == pytest.approx(1.0 - 0.4 * (1.0 - math.exp(-50.0 / 12.0)))
    assert np.all(np.diff(share[12:30]) > 0.0)
    np.testing.assert_array_equal(values[40:], inside[40:])


@pytest.mark.long
def test_a_key_gives_one_course_and_another_gives_another():
    sensors = every_fault(recurring(0.3, 2), NOISY)
    first, again, other = (scan(sensors, jnp.asarray(WALK), jax.random.key(seed)) for seed in (11, 11, 12))
    for name in FAULTS:
        np.testing.assert_array_equal(parts(first[name]), parts(again[name]))
        assert np.any(parts(first[name])[0] != parts(other[name])[0]), name


@pytest.mark.long
def test_many_people_are_each_alone():
    starts, lengths = np.array([0.0, 5.0, 9.0]), np.array([4.0, np.inf, 3.0])
    glucose = WALK[:, None] + np.array([0.0, 20.0, -15.0])
    people = Episodes(earliest=starts, latest=starts, length=lengths)
    together = scan(every_fault(people), jnp.asarray(glucose), KEY)
    for i in range(3):
        alone = scan(every_fault(once(int(starts[i]), lengths[i])), jnp.asarray(glucose[:, i]), KEY)
        for name in FAULTS:
            values, valid = parts(together[name])
            assert values.shape == valid.shape == glucose.shape
            if name == "out of order":  # people of one key draw apart
                assert set(values[:, i]) <= {START, *glucose[:, i]}
            else:
                np.testing.assert_array_equal([values[:, i], valid[:, i]], parts(alone[name]), err_msg=name)


@pytest.mark.long
def test_mapped_people_are_each_alone():
    sensor = OutOfOrder(4, schedule=recurring(0.3, 3), inner=Missing(schedule=recurring(0.1, key=1), inner=NOISY))
    keys = jax.random.split(KEY, 4)
    together = jax.vmap(lambda key: scan(sensor, jnp.asarray(WALK), key))(keys)
    for i in range(4):
        alone = told(sensor, WALK, keys[i])
        np.testing.assert_array_equal(together.glucose_mg_dl[i], alone[0])
        np.testing.assert_array_equal(together.valid[i], alone[1])


def test_each_of_the_latest_readings_is_told_as_often_as_the_others():
    glucose = np.arange(4000.0)
    values, valid = told(OutOfOrder(4, schedule=always(), inner=IdealSensor()), glucose)
    age = (glucose - values)[4:]
    counts = np.array([(age == k).sum() for k in range(4)])
    assert counts.sum() == age.size
    assert np.all(np.abs(counts - age.size / 4) < 5.0 * np.sqrt(age.size * 3 / 16))
    assert abs(np.corrcoef(age[:-1], age[1:])[0, 1]) < 5.0 / np.sqrt(age.size)
    assert valid.all()


CHAINS = [("stuck", "missing", "spikes"), ("drift", "late", "saturation"), ("missing", "repeated", "compression")]


@pytest.mark.long
@pytest.mark.parametrize("chain", CHAINS, ids=" in ".join)
@settings(max_examples=20)
@given(st.lists(st.tuples(st.integers(0, SAMPLES), st.integers(1, SAMPLES)), min_size=3, max_size=3))
def test_faults_compose_from_the_inside_out(chain, times):
    sensor, expected = NOISY, pairs(NOISY, WALK)
    for name, (start, length) in zip(chain, times, strict=True):
        sensor = FAULTS[name](once(start, length), sensor)
        expected = PLAIN[name](expected, ages_of(start, length))
    same(pairs(sensor, WALK), expected)


def by_engine(name, sensor, precision="float64"):
    """Readings ``(samples, people)`` of three people."""

    def step(own, state, reaching, shared, rng):
        del own, reaching
        key, number = rng
        return sensor.read(state, shared["glucose"], jax.random.fold_in(key, number))

    keys = jax.random.split(KEY, 3)
    state = jax.jit(jax.vmap(lambda key: sensor.init(jnp.asarray(START), key), out_axes=-1))(keys)
    example = jax.tree.map(lambda leaf: leaf[..., 0], state)
    engine = make_engine(step, (), example, {}, {"glucose": WALK[0]}, KEY, name=name, precision=precision)
    assert engine.name == name
    return engine.run((), state, {}, {"glucose": WALK}, keys)[1]


@pytest.mark.long
def test_native_code_takes_every_fault_and_computes_the_same():
    recurs = dataclasses.replace(once(2, 3, latest_sample=6), probability=0.2, random=True)
    sensors = every_fault(recurs, NOISY)
    native, mapped, single = (
        by_engine("native", sensors),
        by_engine("xla", sensors),
        by_engine("native", sensors, "float32"),
    )
    inside = told(NOISY, WALK)[0][:, None]
    for name in FAULTS:
        expected, valid = parts(mapped[name])
        assert np.any(expected != inside), name
        for found, tolerance in ((native[name], 1e-13), (single[name], 1e-6)):
            np.testing.assert_allclose(found.glucose_mg_dl, expected, rtol=tolerance, err_msg=name)
            np.testing.assert_array_equal(np.asarray(found.valid, bool), valid, err_msg=name)


REFUSED = [
    (lambda: Spikes(math.nan, schedule=always()), r"size_mg_dl is nan mg/dl; give a finite number"),
    (lambda: Spikes(math.inf, schedule=always()), r"size_mg_dl is inf mg/dl; give a finite number"),
    (lambda: Drift(math.nan, schedule=always()), r"mg_dl_h is nan mg/dl per hour; give a finite number"),
    (lambda: Drift(1.0, sample_time_min=0.0), r"a sample time of 0 min is not possible; give a finite"),
    (lambda: Calibration(0.0), r"gain is 0; give a finite number above 0"),
    (lambda: Calibration(math.inf), r"gain is inf; give a finite number above 0"),
    (lambda: Calibration(1.0, math.nan), r"offset_mg_dl is nan mg/dl; give a finite number"),
    (lambda: Saturation(50.0, 50.0), r"a sensor range of 50 to 50 mg/dl is not possible; give an upper end above"),
    (lambda: Saturation(-1.0), r"low_mg_dl is -1 mg/dl; give a finite number of 0 mg/dl or more"),
    (lambda: Saturation(40.0, math.inf), r"high_mg_dl is inf mg/dl; give a finite number above 0"),
    (lambda: Saturation(math.nan), r"low_mg_dl is nan mg/dl; give"),
    (lambda: Compression(0.0, schedule=always()), r"depth is 0; give a number above 0 and up to 1"),
    (lambda: Compression(1.1, schedule=always()), r"depth is 1.1; give a number above 0 and up to 1"),
    (lambda: Compression(math.nan, schedule=always()), r"depth is nan; give"),
    (lambda: Compression(0.3, tau_min=0.0, schedule=always()), r"tau_min is 0 min; give a finite"),
    (lambda: Compression(0.3, sample_time_min=math.inf), r"a sample time of inf min is not possible"),
    *((lambda n=n: Late(n, sample_time_min=5.0).samples, r"delay of (289|2000) samples is not possible; give 1 to 288")
      for n in (1441.0, 1e4)),
    *((lambda n=n: Late(n), r"delay_min is .*; give a finite number above 0 min") for n in (0.0, -1.0, math.inf)),
    *((lambda n=n: Repeated(n, schedule=always()), r"give a whole number")
      for n in (1, 2.5, math.nan, math.inf, True)),
    *((lambda n=n: OutOfOrder(n, schedule=always()), r"give a whole number")
      for n in (1, 49, 2.0, True)),
]  # fmt: skip


@pytest.mark.parametrize(("make", "sentence"), REFUSED)
def test_impossible_faults_are_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()
