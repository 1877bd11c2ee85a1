"""Loops whose sensor errs: they are the loops of `simulate`, and the worst one found is told as it was."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import glucoloop as gl
from glucoloop.build.designs import controller_of
from glucoloop.control import Status
from glucoloop.sensors import erring
from glucoloop.situations.situation import configured
from glucoloop.studies.adversary import Adversary
from glucoloop.studies.adversary.attack import Attack, ErrorSpace, generations, judge_of, random_errors, worst_of
from glucoloop.studies.adversary.study import loops
from glucoloop.trials.engine import prepare, run_people

ASKED = configured(
    Adversary,
    {
        "controller": ["pid"],
        "guards": "without",
        "errors_pct": [30.0],
        "duration_min": 240.0,
        "people": 5,
        "generations": 8,
        "starts": 1,
        "sequences": 4,
    },
)


@pytest.fixture(scope="module")
def pid():
    return controller_of(ASKED.base, ASKED.base.cases[0])


@pytest.fixture(scope="module")
def attack(pid):
    ((search,),) = loops(ASKED)
    return Attack(search.trial, pid, search.space, lanes=4)


@pytest.fixture(scope="module")
def space():
    ((search,),) = loops(ASKED)
    return search.space


def test_it_is_the_loop_of_simulate(attack, pid, space):
    errors = 0.3 * np.sin(np.arange(space.samples))
    stuck = np.array([3.0, 20.0, 40.0])
    loop, harm = attack.trace(attack.person(None), errors, stuck)
    trace = gl.simulate(gl.patient(), pid, erring(errors, stuck, 6), scenario=gl.Scenario(horizon_min=240.0))
    for name in ("t_min", "glucose_mg_dl", "reading_mg_dl", "insulin_mU_min"):
        np.testing.assert_allclose(loop[name], getattr(trace, name), atol=0.05)
    status = [Status(code).name.lower().replace("_", " ") for code in np.asarray(trace.status).tolist()]
    assert (loop["status"] == pl.Series(status)).mean() > 0.9
    assert harm.lowest_mg_dl[0] == pytest.approx(float(jnp.min(trace.fine_glucose_mg_dl)), abs=0.05)


def test_carbohydrate_is_announced_as_people_count_it():
    keys = {"controller": ["basal-bolus"], "guards": "without", "duration_min": 120.0, "people": 3, "seed": 5}
    told = {"announce_meals": True, "carb_error_pct": 30.0, "carb_bias_pct": -20.0}
    ((search,),) = loops(configured(Adversary, {**keys, **told, "errors_pct": [10.0]}))
    trial = search.trial
    attack = Attack(trial, controller_of(trial, trial.cases[0]), search.space, lanes=4)
    none, never = np.zeros((trial.samples, 3)), np.full((search.space.stretches, 3), float(trial.samples))
    found = attack.harm(attack.people(3), none, never)
    tried = run_people(prepare(trial), "basal-bolus", np.arange(3)).metrics
    np.testing.assert_allclose(found.lowest_mg_dl, tried["minimum_mg_dl"], atol=1e-6)
    np.testing.assert_allclose(found.peak_mg_dl, tried["peak_mg_dl"], atol=1e-6)


def test_a_sequence_does_the_same_whichever_others_are_tried_beside_it(attack, space):
    errors = np.random.default_rng(0).uniform(-0.3, 0.3, (space.samples, 7))
    stuck = np.tile(np.array([[2.0], [30.0], [40.0]]), 7)
    who = attack.person(None)
    together = attack.harm(who, errors, stuck)
    alone = attack.harm(who, errors[:, 5:6], stuck[:, 5:6])
    for name in ("lowest_mg_dl", "below_54_min", "peak_mg_dl"):
        assert getattr(together, name)[5] == getattr(alone, name)[0]


def test_the_worst_found_is_as_harmful_as_the_search_was_told(attack, space):
    who = attack.person(3)
    *_, last = generations(judge_of(attack, who), space, ASKED)
    worst = worst_of(attack, who, space, last)
    assert np.abs(worst.errors).max() <= 0.3
    assert worst.sequences == 32
    fresh = attack.harm(attack.person(3), worst.errors[:, None], worst.stuck_from[:, None])
    assert fresh.lowest_mg_dl[0] == worst.harm.lowest_mg_dl[0]
    assert worst.loop["glucose_mg_dl"].min() >= worst.harm.lowest_mg_dl[0]


def test_each_person_has_random_errors_of_their_own(attack, space):
    found = random_errors(attack, space, 5, seed=1)
    fewer = random_errors(attack, space, 3, seed=1)
    np.testing.assert_array_equal(found.lowest_mg_dl[:3], fewer.lowest_mg_dl)
    assert np.unique(found.lowest_mg_dl).size == 5
    assert random_errors(attack, space, 0, seed=1).lowest_mg_dl.size == 0


def test_what_does_not_fit_is_refused(pid):
    space = ErrorSpace(samples=10, error=0.1)
    with pytest.raises(ValueError, match="errors of 10 samples do not fit a run of 48"):
        Attack(ASKED.base, pid, space)
    with pytest.raises(ValueError, match="leave their spreads at 0"):
        Attack(dataclasses.replace(ASKED.base, meal_size_spread_pct=10.0), pid, space)
