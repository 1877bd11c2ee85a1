"""Rescue carbohydrate: its course in closed form, that none is lost, when it is eaten, and one person as many."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop._pytree import pytree, static
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control import Decision, Status
from glucoloop.meals import Ingestion, rescue_carbs
from glucoloop.pumps import DoseLimits, LimitedPump
from glucoloop.refusal import Refusal
from glucoloop.sensors import IdealSensor
from glucoloop.simulation.stepper import scenario_stepper
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.therapy import Profile

NO_MEAL = jnp.zeros((5, 3))


def means(rescue, seen, sample_time_min=5.0, moments=NO_MEAL):
    """Mean appearance in each step [mg/min] and what is eaten [g], with glucose as the person sees it."""
    state, appears, eaten = rescue.init(jnp.zeros(())), [], []
    for glucose in seen:
        state, grams, after = rescue.eat(state, jnp.asarray(glucose, float), moments, sample_time_min)
        appears += np.asarray(after - moments)[:, 0].tolist()
        eaten.append(float(grams))
    return np.array(appears), np.array(eaten)


@pytest.mark.long
@given(tau=st.floats(2.0, 60.0), carbs=st.floats(1.0, 50.0))
@settings(max_examples=30, deadline=None)
def test_it_appears_as_two_compartments_in_a_row_let_it(tau, carbs):
    """``D t / tau^2 exp(-t / tau)``, whose integral is ``D (1 - (1 + t / tau) exp(-t / tau))``."""
    appears, _ = means(rescue_carbs(carbs_g=carbs, time_to_maximum_min=tau), [60.0, *[100.0] * 11])
    t = np.arange(61.0)
    gone = 1000.0 * carbs * (1.0 - (1.0 + t / tau) * np.exp(-t / tau))
    np.testing.assert_allclose(appears, np.diff(gone), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("gut", [gl.meals.HovorkaGut(), Ingestion()])
def test_nothing_of_it_is_lost(gut):
    appears, eaten = means(rescue_carbs().for_gut(gut), [65.0] * 12 + [120.0] * 100)
    assert eaten.sum() == 4 * 15.0
    assert appears.sum() == pytest.approx(1000.0 * eaten.sum(), rel=1e-6)


def test_the_person_eats_when_glucose_is_low_and_again_while_it_is():
    seen = [70.0, 69.9, 60.0, 60.0, 60.0, 80.0, 69.0, math.nan, 69.0, 69.0]
    _, eaten = means(rescue_carbs(carbs_g=20.0, again_min=15.0), seen)
    assert eaten.tolist() == [0.0, 20.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 20.0, 0.0]


def test_a_patient_who_digests_eats_it_by_the_next_sample():
    appears, _ = means(rescue_carbs().for_gut(Ingestion()), [60.0, 100.0])
    np.testing.assert_allclose(appears, [3000.0] * 5 + [0.0] * 5)


PATIENT = gl.patient("hovorka-2004")
TOO_MUCH = gl.control.design_open_loop(2.0 * float(PATIENT.basal_insulin_mU_min), gl.usual_limits(PATIENT))


def fasting(rescue):
    return gl.Scenario([], 1440.0, rescue=rescue)


@pytest.mark.long
def test_who_has_too_much_insulin_is_held_up_by_eating():
    without = gl.simulate(PATIENT, TOO_MUCH, scenario=fasting(None))
    assert float(without.glucose_mg_dl.min()) < 55.0
    assert without.rescue_g is None
    rescued = gl.simulate(PATIENT, TOO_MUCH, scenario=fasting(rescue_carbs()))
    assert float(rescued.glucose_mg_dl.min()) > 60.0
    ate, reading = np.asarray(rescued.rescue_g), np.asarray(rescued.reading_mg_dl)
    assert set(ate.tolist()) == {0.0, 15.0}
    assert np.all(reading[ate > 0.0] < 70.0)
    at = np.flatnonzero(ate)
    assert np.diff(at).min() >= 3
    before = slice(0, at[0] + 1)
    np.testing.assert_allclose(rescued.glucose_mg_dl[before], without.glucose_mg_dl[before], rtol=1e-12)
    table = rescued.to_polars()
    assert table["rescue_g"].sum() == ate.sum()


@pytest.mark.long
def test_by_true_glucose_noise_of_the_sensor_makes_nobody_eat():
    sensor = gl.sensors.white_noise(400.0)
    by_glucose = gl.simulate(PATIENT, TOO_MUCH, sensor, scenario=fasting(rescue_carbs(by="glucose")))
    ate = np.asarray(by_glucose.rescue_g) > 0.0
    assert ate.any()
    assert np.all(np.asarray(by_glucose.glucose_mg_dl)[ate] < 70.0)


@pytest.mark.long
@pytest.mark.parametrize(("patient", "population"), [("hovorka-2004", "boiroux2017"), ("uva-padova-2008", "lognormal")])
def test_both_engines_let_people_eat_alike(patient, population):
    people = gl.virtual_people(gl.population(population, patient=patient), seed=3, person=range(4))
    nominal = gl.patient(patient)
    profile = Profile(basal_mU_min=float(nominal.basal_insulin_mU_min), setpoint_mg_dl=nominal.setpoint_mg_dl)
    basal = gl.control.BasalBolus().of_person(profile, gl.usual_limits(nominal))
    meals = [gl.Meal(50.0, 100.0, announced_g=250.0)]
    scenario = gl.Scenario(meals, 720.0, announced=True, rescue=rescue_carbs())
    native, xla = (gl.simulate_people(people, basal, scenario=scenario, engine=engine) for engine in ("native", "xla"))
    assert native.engine == "native"
    feasible = people.feasible
    np.testing.assert_allclose(native.glucose_mg_dl[:, feasible], xla.glucose_mg_dl[:, feasible], rtol=1e-9)
    without = gl.simulate_people(people, basal, scenario=gl.Scenario(meals, 720.0, announced=True))
    assert np.nanmin(native.glucose_mg_dl[:, feasible]) > np.nanmin(without.glucose_mg_dl[:, feasible]) + 1.0


def test_an_integrator_that_knows_all_meals_before_is_refused():
    with pytest.raises(ArgumentTypeError, match="rescue carbohydrate depends on the run"):
        gl.simulate(PATIENT, TOO_MUCH, scenario=fasting(rescue_carbs()), integrator=gl.Adaptive())


def test_a_stepped_patient_is_refused_it():
    stepped = {"sample_time_min": 5.0, "key": 0}
    with pytest.raises(Refusal, match="leave the rescue out of the scenario"):
        scenario_stepper(PATIENT, IdealSensor(), LimitedPump(), fasting(rescue_carbs()), **stepped)


@pytest.mark.parametrize("wrong", [{"below_mg_dl": 0.0}, {"carbs_g": -1.0}, {"again_min": 0.0}, {"by": "feeling"}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(Refusal):
        rescue_carbs(**wrong)


def test_a_situation_has_it_by_one_option():
    run = configured(Run, patient="hovorka-2004", rescue="below_mg_dl=65, carbs_g=20")
    made = run.rescue_carbs
    assert (made.below_mg_dl, made.carbs_g, made.by_reading) == (65.0, 20.0, True)
    assert run.scenario_of(()).rescue == made
    assert configured(Run).rescue_carbs is None


@pytest.mark.long
def test_its_metric_counts_what_is_eaten():
    trace = gl.simulate(PATIENT, TOO_MUCH, scenario=fasting(rescue_carbs()))
    found = gl.summarise(trace, metrics=("rescues",))
    assert float(found.rescue_carbs_g) == float(jnp.sum(trace.rescue_g))
    assert float(found.rescues) == np.count_nonzero(trace.rescue_g)


def test_it_is_a_pytree_of_numbers():
    leaves = jax.tree.leaves(rescue_carbs())
    assert len(leaves) == 4


@pytree
class Repeats:
    """A controller whose rate is high, and tells the carbohydrate of which it was told."""

    sample_time_min: float = static(default=5.0)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        told = 0.0 if observation.rescue_carbs_g is None else observation.rescue_carbs_g
        rate = jnp.full_like(observation.glucose_mg_dl, 30.0) + told
        return state, Decision(insulin_mU_min=rate, status=jnp.asarray(int(Status.OK)))


def test_what_was_eaten_is_told_once_at_the_next_sample_or_not_at_all():
    patient = gl.patient("hovorka-2004")
    pump = LimitedPump(limits=DoseLimits(max_change_mU_min=100.0, max_mU_min=100.0))

    def of(told):
        scenario = gl.Scenario([], 300.0, rescue=rescue_carbs(told=told))
        return gl.simulate(patient, Repeats(), pump=pump, scenario=scenario)

    trace = of(True)
    eaten = np.asarray(trace.rescue_g)
    assert np.count_nonzero(eaten) > 1
    np.testing.assert_array_equal(trace.command_mU_min, 30.0 + np.r_[0.0, eaten[:-1]])
    np.testing.assert_array_equal(of(False).command_mU_min, 30.0)
