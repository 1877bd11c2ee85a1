"""Controllers designed for many people at once are those designed for each of them alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.cohorts.trial import Trial
from glucoloop.control import catalogue
from glucoloop.experiments.case import Case
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.individual import individual_design
from glucoloop.meals import Meal
from glucoloop.meals.plan import MealPlan
from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.patients import population, virtual_people

# of seed 1 these have a basal rate above the amplitude of the paper's pulses, so that one record serves both
PERSONS = (0, 2, 8)


def case(name, **more):
    tuning = catalogue.complete(name, {}, USUAL_PATIENT, "setpoint-81", noisy=False)
    return Case(
        label=name,
        controller=name,
        tuning=tuning,
        model_noise_variance=0.0,
        memory=36,
        laguerre_pole=0.84,
        laguerre_functions=2,
        **more,
    )


def with_floor(one):
    return dataclasses.replace(one, tuning={**one.tuning, "glucose_floor_mg_dl": 65.0, "floor_weight": 4.0})


def trial_of(one):
    return Trial(
        population=population("parker2000"),
        people=10,
        plan=MealPlan([Meal(50.0, 50.0)], horizon_min=600.0),
        cases=(one,),
        seed=1,
        dead_time_samples=2,
        design="individual",
    )


@pytest.fixture(scope="module")
def people():
    found = virtual_people(population("parker2000"), 1, PERSONS)
    assert (found.basal_insulin_mU_min > 22.33).all()
    return found


@pytest.mark.parametrize(
    ("one", "error"),
    [
        (case("mpc"), 1e-5),  # another integrator carries the record
        (case("mpc", known_dead_time=True), 1e-5),
        (case("mpc-se"), 1e-7),
        (with_floor(case("mpc", known_dead_time=True)), 1e-5),
        (with_floor(case("mpc-se")), 1e-7),
        (case("imc"), 0.0),
    ],
    ids=["mpc", "mpc, known dead time", "mpc-se", "mpc, floor", "mpc-se, floor", "imc"],
)
def test_a_design_for_many_is_that_for_each(people, one, error):
    trial = trial_of(one)
    design = individual_design(trial, one, people)
    together = design(people)
    for place in range(len(PERSONS)):
        person = jax.tree.map(lambda a, i=place: a[i] if jnp.ndim(a) else a, people.patient)
        alone = controller_of(trial, one, person)
        for many, single in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            own = np.asarray(many)[..., place] if np.ndim(many) > np.ndim(single) else many
            scale = max(1.0, float(np.abs(single).max()))
            assert np.abs(np.asarray(own) - np.asarray(single)).max() <= error * scale


def test_no_design_where_there_is_nothing_to_design(people):
    one = case("basal")
    assert individual_design(trial_of(one), one, people) is None


def test_somebody_without_a_basal_rate_does_not_disturb_the_others():
    persons = [11, 12]  # of seed 0 at 120 mg/dl nothing holds the first
    found = virtual_people(population("parker2000"), 0, persons, setpoint_mg_dl=120.0)
    assert found.feasible.tolist() == [False, True]
    one = case("mpc")
    together = individual_design(trial_of(one), one, found)(found)
    assert np.isnan(np.asarray(together.step_response)[:, 0]).all()
    assert np.isfinite(np.asarray(together.step_response)[:, 1]).all()
