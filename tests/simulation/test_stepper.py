"""One patient in steps: the loop of `simulate` to the bit, and exactly where it was after a restore."""

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import design_pid
from glucoloop.control.pid import PIDTuning
from glucoloop.meals import Meal, Scenario
from glucoloop.pumps import with_resolution
from glucoloop.sensors import dead_time, white_noise
from glucoloop.simulation import Stepper, simulate
from glucoloop.snapshot import fingerprint, pack, unpack

# The scenario is one for controllers of all kinds, of whom some hear of no meal.
pytestmark = pytest.mark.filterwarnings("ignore:announced has no effect")

PID = design_pid(PIDTuning(0.5, 150.0))
SENSOR = dead_time(1, white_noise(1.45))
PUMP = with_resolution(0.5)
SCENARIO = Scenario([Meal(50.0, 50.0), Meal(20.0, 52.5, eating_min=80.0)], 100.0, setpoint_mg_dl=90.0, announced=True)
STEP = jax.jit(PID.step)
MEALS = {10: 50.0}


@pytest.fixture(scope="module")
def stepper(patient_81):
    return Stepper(patient_81, SENSOR, PUMP, setpoint_mg_dl=90.0, key=3)


def run(stepper, seen, state, samples):
    """Samples under the PID controller; what happened at each."""
    happened = []
    for _ in range(samples):
        carbs_g = MEALS.get(stepper.sample, 0.0)
        if stepper.sample == 10:
            stepper.eat(50.0)
            stepper.eat(20.0, after_min=2.5, eating_min=80.0)
        announced = 70.0 if carbs_g else 0.0
        state, decision = STEP(state, stepper.observation(announced))
        seen = stepper.step(decision.insulin_mU_min)
        happened.append(stepper.last)
    return seen, state, jax.tree.map(lambda *leaves: np.stack(leaves), *happened)


@pytest.mark.long
def test_stepping_equals_the_simulation_to_the_bit(stepper, patient_81):
    trace = simulate(patient_81, PID, SENSOR, PUMP, SCENARIO, 3)
    seen = stepper.reset()
    _, _, happened = run(stepper, seen, PID.init(seen), 20)
    np.testing.assert_array_equal(happened.x, trace.states[:-1])
    np.testing.assert_array_equal(stepper.state, trace.states[-1])
    np.testing.assert_array_equal(happened.reading.glucose_mg_dl, trace.reading_mg_dl)
    np.testing.assert_array_equal(happened.decision.insulin_mU_min, trace.command_mU_min)
    np.testing.assert_array_equal(happened.delivery.insulin_mU_min, trace.insulin_mU_min)
    np.testing.assert_array_equal(happened.inside_mg_dl.ravel(), trace.fine_glucose_mg_dl[1:])
    assert stepper.t_min == 100.0
    assert stepper.glucose_mg_dl == float(trace.fine_glucose_mg_dl[-1])


@pytest.mark.long
def test_a_restored_stepper_goes_on_to_the_same_bits(stepper, patient_81):
    seen = stepper.reset()
    seen, state, _ = run(stepper, seen, PID.init(seen), 11)
    saved = stepper.save()
    _, _, expected = run(stepper, seen, state, 6)
    end = stepper.save()
    other = Stepper(patient_81, SENSOR, PUMP, setpoint_mg_dl=90.0, key=99)  # the key is part of what is restored
    again = other.restore(saved)
    jax.tree.map(np.testing.assert_array_equal, again, seen)
    _, _, happened = run(other, again, unpack(pack(state), PID.init(again)), 6)
    jax.tree.map(np.testing.assert_array_equal, happened, expected)
    assert other.save() == end


@pytest.mark.long
def test_there_is_room_for_any_number_of_meals(stepper):
    stepper.reset()
    for _ in range(20):
        stepper.eat(5.0)
    many = stepper.save()
    stepper.step(25.0)
    after = stepper.save()
    stepper.reset()
    stepper.restore(many)
    stepper.step(25.0)
    assert stepper.save() == after


@pytest.mark.long
def test_resetting_forgets_everything_but_the_key(stepper):
    first = stepper.reset(key=5)
    start = stepper.save()
    stepper.step(60.0, carbs_g=50.0)
    assert stepper.last is not None
    jax.tree.map(np.testing.assert_array_equal, stepper.reset(), first)
    assert stepper.save() == start
    stepper.reset(3)
    assert stepper.save() != start


def test_a_snapshot_of_another_patient_is_refused(stepper, patient_22):
    saved = stepper.save()
    for other in (
        Stepper(patient_22, SENSOR, PUMP, setpoint_mg_dl=90.0),
        Stepper(patient_22),
    ):
        with pytest.raises(ValueError, match="taken elsewhere: its patient, sensor, pump"):
            other.restore(saved)


@settings(max_examples=60)
@given(data=st.data())
def test_a_damaged_snapshot_is_refused_and_nothing_changes(stepper, data):
    saved = stepper.save()
    place = data.draw(st.integers(0, len(saved) - 1))
    damaged = data.draw(
        st.sampled_from(
            [saved[:place], saved[:place] + bytes([saved[place] ^ 0x10]) + saved[place + 1 :], saved + b"x", b""]
        )
    )
    with pytest.raises(ValueError, match="snapshot"):
        stepper.restore(damaged)
    assert stepper.save() == saved


def test_a_snapshot_of_another_version_or_kind_is_refused():
    saved = pack(np.ones(3), "mine")
    with pytest.raises(ValueError, match=r"of version '2', but this program reads version 1"):
        unpack(saved.replace(b"snapshot 1", b"snapshot 2"), np.ones(3), "mine")
    with pytest.raises(ValueError, match="a state of another kind"):
        unpack(saved, np.ones(3, int), "mine")
    with pytest.raises(ValueError, match="a state of another kind"):
        unpack(saved, (np.ones(3), np.ones(3)), "mine")
    with pytest.raises(ValueError, match="taken elsewhere"):
        unpack(saved, np.ones(3), "yours")
    with pytest.raises(ValueError, match="no snapshot"):
        unpack("text", np.ones(3))


def test_states_of_every_kind_come_back():
    state = {"key": jax.random.key(7), "flag": np.array(True), "count": np.int32(4), "nothing": np.zeros((0, 3))}
    again = unpack(pack(state), {**state, "key": jax.random.key(0)})
    assert jax.random.key_data(again["key"]).tolist() == jax.random.key_data(state["key"]).tolist()
    for name in ("flag", "count", "nothing"):
        assert again[name].dtype == state[name].dtype
        np.testing.assert_array_equal(again[name], state[name])


def test_a_fingerprint_tells_numbers_and_structures_apart(patient_81, patient_22):
    assert fingerprint(patient_81) == fingerprint(dataclasses.replace(patient_81))
    told = {fingerprint(tree) for tree in (patient_81, patient_22, PID, (PID,), white_noise(1.0), white_noise(2.0))}
    assert len(told) == 6
    assert fingerprint(np.tanh) != fingerprint(np.sin)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda s: s.step("25"), "insulin_mU_min is '25', a str"),
        (lambda s: s.step(25.0, carbs_g=-1.0), "a meal of -1 g is not possible"),
        (
            lambda s: s.eat(50.0, after_min=5.0),
            "a meal 5 min into a sample of 5 min is not possible; give 0",
        ),
        (lambda s: s.eat(50.0, after_min=-1.0), "a meal -1 min into a sample"),
    ],
)
def test_an_impossible_step_is_refused(stepper, call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call(stepper)
