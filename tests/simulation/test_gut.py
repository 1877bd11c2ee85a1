"""A gut given by its equations, fed to patients in every way a loop is carried out."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.control import PIDTuning, design_open_loop, design_pid
from glucoloop.meals import DallaManGut, Eaten, Meal, Scenario, eaten
from glucoloop.patients.dalla_man import STATE_NAMES
from glucoloop.pumps import LimitedPump
from glucoloop.sensors import IdealSensor
from glucoloop.simulation import Adaptive, Explicit, Stepper, simulate
from glucoloop.simulation.closed_loop import usual_limits
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.plant import SampleGrid

PATIENT = gl.patient("uva-padova-2008")
DAY = Scenario([Meal(45.0, 420.0, 9.0), Meal(70.0, 750.0), Meal(15.0, 762.4, 3.0), Meal(80.0, 1140.0, 16.0)], 1440.0)
PID = design_pid(PIDTuning(0.05, 400.0))


def fine(patient, scenario, integrator=None, rate=None):
    rate = float(patient.basal_insulin_mU_min) if rate is None else rate
    return np.asarray(
        simulate(patient, design_open_loop(rate), scenario=scenario, integrator=integrator).fine_glucose_mg_dl
    )


@pytest.mark.long
def test_the_average_person_is_that_of_the_adaptive_method():
    truth = fine(PATIENT, DAY, Adaptive(1e-11))
    assert np.max(truth) > 250.0
    np.testing.assert_allclose(fine(PATIENT, DAY), truth, rtol=0.0, atol=0.01)


@pytest.mark.long
def test_an_overdose_is_right_above_40_and_leaves_no_state_below_zero():
    rate, scenario = 9.0 * float(PATIENT.basal_insulin_mU_min), Scenario([Meal(60.0, 60.0, 12.0)], 900.0)
    truth = fine(PATIENT, scenario, Adaptive(1e-11), rate)
    assert np.min(truth) < 5.0
    above = truth > 40.0
    np.testing.assert_allclose(fine(PATIENT, scenario, rate=rate)[above], truth[above], rtol=0.0, atol=0.01)
    states = np.asarray(simulate(PATIENT, design_open_loop(rate), scenario=scenario).states)
    amounts = np.delete(states, STATE_NAMES.index("X"), axis=1)
    assert amounts.min() >= 0.0


@pytest.mark.long
def test_an_exponential_patient_can_have_such_a_gut():
    patient = gl.patient("hovorka-2004")
    scenario = Scenario([Meal(60.0, 63.0, 12.0), Meal(30.0, 150.0, 6.0)], 300.0, meal_model=DallaManGut())
    truth = fine(patient, scenario, Adaptive(1e-11))
    assert np.ptp(truth) > 30.0
    np.testing.assert_allclose(fine(patient, scenario), truth, rtol=0.0, atol=0.06)
    other = fine(patient, dataclasses.replace(scenario, meal_model=None))
    assert np.max(np.abs(other - truth)) > 5.0


@pytest.mark.long
@pytest.mark.parametrize("integrator", [Explicit(), Adaptive(1e-8)], ids=["explicit", "adaptive"])
def test_stepping_equals_the_simulation_and_goes_on_after_a_restore(integrator):
    scenario = Scenario([Meal(50.0, 10.0), Meal(20.0, 17.4, 8.0)], 60.0)
    trace = simulate(PATIENT, design_open_loop(7.0), scenario=scenario, integrator=integrator)
    stepper = Stepper(PATIENT, integrator=integrator)
    saved = None
    for sample in range(12):
        if sample == 2:
            stepper.eat(50.0)
        if sample == 3:
            stepper.eat(20.0, after_min=2.4, eating_min=8.0)
        if sample == 6:
            saved = stepper.save()
        stepper.step(7.0)
    np.testing.assert_allclose(stepper.state, trace.states[-1], rtol=1e-12)
    end = np.asarray(stepper.state)
    stepper.reset()
    stepper.restore(saved)
    for _ in range(6):
        stepper.step(7.0)
    np.testing.assert_array_equal(stepper.state, end)
    stepper.reset()
    assert float(stepper.glucose_mg_dl) == pytest.approx(120.0)


PEOPLE = 3
GRID = SampleGrid(sample_time_min=5.0, samples=96)
OWN = Eaten(
    t_min=np.array([[60.0, 0.0, 100.0], [200.0, 203.3, 150.0]]),
    carbs_g=np.array([[60.0, 20.0, 0.0], [30.0, 80.0, 45.0]]),
    eating_min=np.array([[12.0, 0.0, 0.0], [6.0, 16.0, 1.0]]),
)


CONSTANTS = {
    "b": np.array([0.7, 0.82, 0.9]),
    "k_max": np.array([0.04, 0.0558, 0.06]),
    "V_mx": np.array([0.04, 0.047, 0.06]),
}


@pytree
class Nothing:
    """A fold that keeps nothing."""

    def init(self, glucose_mg_dl, insulin_mU_min):
        return jnp.zeros(())

    def step(self, state, happened, t_min):
        return state


def people(own_meals):
    patient = type(PATIENT).resting_at(120.0, **CONSTANTS)
    x = np.asarray(patient.steady_state(patient.basal_insulin_mU_min))
    return People(
        patient=patient,
        x=x,
        insulin_mU_min=np.asarray(patient.basal_insulin_mU_min),
        key=jax.random.split(jax.random.key(0), PEOPLE),
        meals=OWN if own_meals else None,
    )


def run(everybody, meals, **options):
    pump = LimitedPump(limits=usual_limits(PATIENT))
    cohort = Cohort(
        PATIENT,
        everybody.patient,
        PID,
        IdealSensor(),
        pump,
        GRID,
        Nothing(),
        setpoint_mg_dl=120.0,
        meals=meals,
        **options,
    )
    return cohort, cohort.run(everybody)


@pytest.mark.long
@pytest.mark.parametrize("own_meals", [True, False], ids=["own meals", "common meals"])
def test_people_are_what_each_is_alone_in_every_engine(own_meals):
    everybody = people(own_meals)
    common = None if own_meals else eaten([Meal(60.0, 60.0, 12.0), Meal(30.0, 203.3)])
    cohort, native = run(everybody, common, engine="native")
    assert cohort.engine == "native"
    assert cohort.not_native is None
    for i in range(PEOPLE):
        meals = [
            Meal(float(g), float(t), float(e))
            for t, g, e in zip(OWN.t_min[:, i], OWN.carbs_g[:, i], OWN.eating_min[:, i], strict=True)
            if g > 0.0
        ]
        scenario = Scenario(meals if own_meals else [Meal(60.0, 60.0, 12.0), Meal(30.0, 203.3)], 480.0)
        alone = type(PATIENT).resting_at(120.0, **{k: float(v[i]) for k, v in CONSTANTS.items()})
        trace = simulate(alone, PID, scenario=scenario)
        assert np.ptp(np.asarray(trace.glucose_mg_dl)) > 20.0
        np.testing.assert_allclose(native.glucose_mg_dl[:-1, i], trace.glucose_mg_dl, rtol=1e-9)
    _, compiled = run(everybody, common, engine="xla")
    np.testing.assert_allclose(native.glucose_mg_dl, compiled.glucose_mg_dl, rtol=1e-9)
    _, single = run(everybody, common, engine="native", precision="float32")
    np.testing.assert_allclose(single.glucose_mg_dl, native.glucose_mg_dl, rtol=1e-3)
