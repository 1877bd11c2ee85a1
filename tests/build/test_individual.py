"""Controllers designed for many people at once are those designed for each of them alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.designs import controller_of
from glucoloop.build.individual import individual_design
from glucoloop.control.mpc_se import MPCSE, FilteredModels
from glucoloop.patients import population, virtual_people
from glucoloop.pumps import PARKER_1999_LIMITS
from glucoloop.sensors import DeadTime
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import Situation, default_situation
from glucoloop.trials.trial import Trial

# of seed 1 these have a basal rate above the amplitude of the paper's pulses, so that one record serves both
PERSONS = (0, 2, 8)


def case(name, **more):
    return dataclasses.replace(default_case(name, Situation()), **more)


def with_floor(one):
    return dataclasses.replace(
        one, controller=dataclasses.replace(one.controller, glucose_floor_mg_dl=65.0, floor_weight=4.0)
    )


def trial_of(one):
    return Trial(
        people=10,
        meals=("50g@50min",),
        duration_min=600.0,
        controller=(one,),
        seed=1,
        sensor=(DeadTime(minutes=10.0),),
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
    design = individual_design(trial, one, controller_of(trial, one), people)
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
    trial = trial_of(one)
    assert individual_design(trial, one, controller_of(trial, one), people) is None


def test_somebody_without_a_basal_rate_does_not_disturb_the_others():
    persons = [11, 12]  # of seed 0 at 120 mg/dl nothing holds the first
    found = virtual_people(population("parker2000"), 0, persons, setpoint_mg_dl=120.0)
    assert found.feasible.tolist() == [False, True]
    one = case("mpc")
    trial = trial_of(one)
    together = individual_design(trial, one, controller_of(trial, one), found)(found)
    assert np.isnan(np.asarray(together.step_response)[:, 0]).all()
    assert np.isfinite(np.asarray(together.step_response)[:, 1]).all()


@pytest.mark.long
@pytest.mark.parametrize(("name", "of"), [("mpc", "boiroux2017"), ("mpc-se", "nominal"), ("nlqdmc-se", "nominal")])
def test_a_horizon_that_follows_from_the_model_is_that_of_the_nominal_patient_for_all(name, of):
    situation = default_situation("hovorka-2004")
    one = default_case(name, situation)
    one = dataclasses.replace(one, controller=dataclasses.replace(one.controller, prediction_horizon=0))
    nominal = controller_of(situation, one)
    for persons in ([0], [1, 2]):  # whoever else is in a block
        found = virtual_people(population(of, patient="hovorka-2004"), 1, persons)
        assert individual_design(situation, one, nominal, found)(found).horizons == nominal.horizons


def test_the_rate_of_somebody_on_whom_insulin_is_not_seen_within_the_horizon_is_kept():
    fast, slow = np.exp(-0.1), np.exp(-0.0005)
    models = FilteredModels(
        Phi=np.array([[[fast, slow]]]),
        Gamma=np.array([[-0.3, -0.001]]),
        C=np.ones((1, 2)),
        kalman_gain=np.full((1, 2), 0.5),
        rest=np.array([[-0.3 / (1.0 - fast), -0.001 / (1.0 - slow)]]),
    )
    found = MPCSE(2, 8).of_people(
        models,
        PARKER_1999_LIMITS,
        basal_mU_min=jnp.full(2, 20.0),
        basal_glucose_mg_dl=jnp.full(2, 100.0),
        sample_time_min=5.0,
    )
    gain = np.asarray(found.plan.gain)
    assert np.isfinite(gain[:, 0]).all()
    assert np.isnan(gain[:, 1]).all()
