"""A warm-up: all of it is simulated, and the run that counts is the rest of that longer run."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree, static
from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.control import Decision, PIDTuning, Status, design_pid
from glucoloop.meals import Meal, Scenario
from glucoloop.metrics import summarise
from glucoloop.patients.population import virtual_people
from glucoloop.simulation import simulate
from glucoloop.simulation.stepper import scenario_stepper, simulate_stepped
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import alone, prepare, run_people
from glucoloop.trials.people_run import simulate_people
from glucoloop.trials.trial import Trial

# The scenario is one for controllers of all kinds, of whom some hear of no meal and know no time of day.
pytestmark = [
    pytest.mark.filterwarnings("ignore:announced has no effect"),
    pytest.mark.filterwarnings("ignore:start_min has no effect"),
]

PID = design_pid(PIDTuning(0.5, 150.0))
MEALS = (Meal(30.0, -80.0), Meal(50.0, 35.0, announced_g=40.0, announced_min=55.0))
NOISY = gl.white_noise(4.0)


def shifted(meals, by_min):
    """The same meals in a run that begins earlier."""
    return tuple(
        dataclasses.replace(
            meal,
            t_min=meal.t_min + by_min,
            announced_min=None if meal.announced_min is None else meal.announced_min + by_min,
        )
        for meal in meals
    )


@pytest.mark.long
def test_the_trace_is_the_rest_of_a_longer_run(patient_81):
    warm = simulate(
        patient_81, PID, NOISY, scenario=Scenario(MEALS, 300.0, announced=True, start_min=60.0, warm_up_min=120.0)
    )
    whole = simulate(
        patient_81, PID, NOISY, scenario=Scenario(shifted(MEALS, 120.0), 420.0, announced=True, start_min=1380.0)
    )
    np.testing.assert_array_equal(warm.t_min, np.arange(0.0, 300.0, 5.0))
    np.testing.assert_array_equal(warm.fine_t_min, np.arange(301.0))
    np.testing.assert_array_equal(warm.fine_glucose_mg_dl, whole.fine_glucose_mg_dl[120:])
    for name in ("reading_mg_dl", "command_mU_min", "insulin_mU_min", "status", "carbs_g", "announced_carbs_g"):
        np.testing.assert_array_equal(getattr(warm, name), getattr(whole, name)[24:])
    np.testing.assert_array_equal(warm.states, whole.states[24:])
    assert float(warm.rate_before_mU_min) == float(whole.insulin_mU_min[23]) != float(warm.basal_insulin_mU_min)
    assert np.flatnonzero(np.asarray(warm.announced_carbs_g)).tolist() == [11]
    assert float(warm.announced_carbs_g[11]) == 40.0


@pytest.mark.long
def test_nothing_of_the_warm_up_is_counted(patient_81):
    trace = simulate(patient_81, PID, scenario=Scenario((Meal(90.0, -600.0),), 300.0, warm_up_min=720.0))
    counted = summarise(trace)
    glucose = np.asarray(trace.fine_glucose_mg_dl)
    assert float(counted.peak_mg_dl) == glucose.max()
    np.testing.assert_allclose(float(counted.mean_mg_dl), glucose.mean(), rtol=1e-12)
    np.testing.assert_allclose(
        float(counted.insulin_total_mU), 5.0 * np.asarray(trace.insulin_mU_min).sum(), rtol=1e-12
    )
    changes = np.abs(np.diff(np.append(trace.rate_before_mU_min, trace.insulin_mU_min)))
    np.testing.assert_allclose(float(counted.insulin_total_variation_mU_min), changes.sum(), rtol=1e-12)


def test_without_a_warm_up_the_trace_is_the_run(patient_81):
    trace = simulate(patient_81, PID, scenario=Scenario((Meal(50.0, 50.0),), 300.0))
    assert trace.after(0) is trace
    assert trace.rate_before_mU_min is None


@pytree
class Clock:
    """A controller whose dose is the time of day."""

    sample_time_min: float = static(default=5.0)

    def init(self, observation):
        return observation.time_of_day_min

    def step(self, state, observation):
        del state
        time = observation.time_of_day_min
        return time, Decision(insulin_mU_min=time, status=jnp.asarray(int(Status.OK)))


@pytest.mark.long
def test_the_time_of_day_is_that_of_the_end_of_the_warm_up(patient_81):
    trace = simulate(patient_81, Clock(), scenario=Scenario((), 60.0, start_min=10.0, warm_up_min=2880.0 + 30.0))
    np.testing.assert_allclose(trace.command_mU_min, 10.0 + 5.0 * np.arange(12))


@pytest.mark.long
def test_a_planned_fault_counts_from_the_end_of_the_warm_up():
    keys = {"controller": ["basal"], "duration_min": 120.0, "meals": [], "faults": ["missing, start_min=30"]}
    warm = configured(Run, keys, warm_up_min=60.0)
    trace = close_loop(warm, controller_of(warm, warm.case), warm.as_scenario())
    np.testing.assert_array_equal(trace.reading_valid, np.arange(24) < 6)


@pytest.mark.long
def test_stepping_is_the_simulation(patient_81):
    scenario = Scenario(MEALS, 150.0, announced=True, warm_up_min=100.0)
    pump = gl.LimitedPump()
    expected = simulate(patient_81, PID, NOISY, pump, scenario, 3)
    stepper = scenario_stepper(patient_81, NOISY, pump, scenario, sample_time_min=5.0, key=3)
    step = jax.jit(PID.step)
    state = [None]

    def decide(index, seen):
        state[0] = PID.init(seen) if index == 0 else state[0]
        state[0], decision = step(state[0], seen)
        return decision

    found = simulate_stepped(stepper, scenario, decide)
    np.testing.assert_allclose(found.fine_glucose_mg_dl, expected.fine_glucose_mg_dl, rtol=1e-12)
    np.testing.assert_allclose(found.insulin_mU_min, expected.insulin_mU_min, rtol=1e-12)
    assert float(found.rate_before_mU_min) == pytest.approx(float(expected.rate_before_mU_min), rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("announced", [False, True])
def test_people_of_a_trial_are_those_of_one_at_a_time(announced):
    trial = configured(
        Trial,
        patient="hovorka-2004",
        people=2,
        controller=["basal-bolus" if announced else "pid"],
        announce_meals=announced,
        sensor=["white-noise, variance=4"],
        days=1,
        warm_up_min=720.0,
        habits=["snack, time=21h, probability=1", *(["announced-late, minutes=20"] if announced else [])],
    )
    prepared = prepare(trial)
    label = trial.cases[0].label
    found = run_people(prepared, label, trial.shard(0), traces=True)
    assert found.glucose_mg_dl.shape == (289, 2)
    assert found.glucose_counts.shape[0] == 289
    for i in range(2):
        trace = alone(prepared, label, i)
        single = summarise(trace, trial.limits)
        # float32 traces, and people's steps of the integrator
        np.testing.assert_allclose(found.glucose_mg_dl[:-1, i], trace.glucose_mg_dl, rtol=1e-4)
        for name in ("mean_mg_dl", "insulin_total_mU", "insulin_total_variation_mU_min", "largest_change_mU_min"):
            np.testing.assert_allclose(found.metrics[name][i], getattr(single, name), rtol=2e-3, err_msg=name)


@pytest.mark.long
def test_people_from_python_have_a_warm_up_too():
    people = virtual_people(gl.population("nominal"), 0, np.arange(1))
    scenario = Scenario(MEALS, 200.0, announced=True, warm_up_min=100.0)
    found = simulate_people(people, PID, scenario=scenario)
    expected = simulate(gl.patient(), PID, scenario=scenario)
    assert found.t_min.tolist() == list(range(0, 205, 5))
    np.testing.assert_allclose(found.glucose_mg_dl[:-1, 0], expected.glucose_mg_dl, rtol=1e-4)
    np.testing.assert_allclose(found.metrics.peak_mg_dl[0], summarise(expected).peak_mg_dl, rtol=1e-4)
