"""Each person's own profile, where insulin is dosed."""

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.control import BasalBolus
from glucoloop.control.protocol import Decision, Status
from glucoloop.meals import Meal, Scenario
from glucoloop.situations.situation import configured
from glucoloop.therapy import Profile
from glucoloop.trials.engine import alone, people_of, prepare, run_people
from glucoloop.trials.people_run import simulate_people
from glucoloop.trials.shard import compute_shard, read_people
from glucoloop.trials.trial import Trial

KEYS = {
    "patient": "hovorka-2004",
    "population": {
        "person": [
            {"name": "anna", "S_IT": 40e-4, "carb_ratio_g_U": 10.0, "correction_mg_dl_U": 40.0},
            {"name": "ben", "S_IT": 50e-4, "total_daily_dose_U": 40.0},
            {"name": "cleo", "S_IT": 60e-4},
        ]
    },
    "meals": ["20g@60min"],
    "duration_min": 300.0,
    "announce_meals": True,
}
RATIO_G_U = (10.0, 500.0 / 40.0, None)
"""Ratio of each: of the table, by the daily dose of the table, and by the basal rate."""


def boluses_U(trial, label, people=(0, 1, 2)):
    """Bolus of each at the meal, where all are at the setpoint."""
    found = run_people(prepare(trial), label, np.array(people), traces=True)
    at = round(60.0 / trial.sample_time_min)
    extra = found.insulin_mU_min[at].astype(float) - found.basal_insulin_mU_min
    return extra * trial.sample_time_min / 1000.0, found


@pytest.mark.long
@pytest.mark.parametrize("more", [{}, {"design": "individual"}, {"guard": {}}, {"design": "individual", "guard": {}}])
def test_basal_bolus_doses_by_each_persons_own_profile(more):
    trial = configured(Trial, {**KEYS, "controller": ["basal-bolus"], **more})
    given, found = boluses_U(trial, "basal-bolus")
    by_rule = 500.0 / (2.0 * 1.44 * found.basal_insulin_mU_min)
    wanted = [20.0 / (ratio or by_rule[i]) for i, ratio in enumerate(RATIO_G_U)]
    np.testing.assert_allclose(given, 0.05 * np.floor(np.array(wanted) / 0.05 + 1e-6), atol=2e-5)
    one = alone(prepare(trial), "basal-bolus", 1)
    assert float(one.bolus_mU[12]) == pytest.approx(1000.0 * given[1], rel=1e-5)


@pytest.mark.long
def test_what_is_given_wins():
    trial = configured(Trial, {**KEYS, "controller": ["basal-bolus, carb_ratio_g_U=20"]})
    np.testing.assert_allclose(boluses_U(trial, "basal-bolus, carb_ratio_g_U=20")[0], 1.0, atol=2e-5)


@pytest.mark.long
def test_people_in_a_shard_have_their_names_and_profiles():
    trial = configured(Trial, {**KEYS, "controller": ["basal-bolus", "basal"]})
    prepared = prepare(trial)
    files = compute_shard(trial, 0, lambda label, person, traces: run_people(prepared, label, person, traces=traces))
    rows = pl.read_parquet(files["people.parquet"])
    assert rows["name"].to_list() == ["anna", "ben", "cleo"] * 2
    assert rows["profile_carb_ratio_g_U"].to_list() == [10.0, None, None] * 2
    assert rows["profile_total_daily_dose_U"].to_list() == [None, 40.0, None] * 2
    assert rows["S_IT"].to_list() == [40e-4, 50e-4, 60e-4] * 2


@pytest.mark.long
def test_a_shard_with_names_is_read_back(tmp_path):
    trial = configured(Trial, {**KEYS, "controller": ["basal"]})
    prepared = prepare(trial)
    files = compute_shard(trial, 0, lambda label, person, traces: run_people(prepared, label, person, traces=traces))
    (tmp_path / "people.parquet").write_bytes(files["people.parquet"])
    people = read_people(tmp_path, trial, 0)["basal"]
    assert people.profile["correction_mg_dl_U"][0] == 40.0
    assert "name" not in people.metrics
    assert not any(name.startswith("profile_") for name in people.metrics)


@pytest.mark.long
def test_own_meals_are_eaten_and_titrated_profiles_used():
    keys = {"patient": "kanderian-2009", "meals": ["own"], "announce_meals": True, "controller": ["basal-bolus"]}
    trial = configured(Trial, {**keys, "profile_by": "titration", "people": 2})
    found = run_people(prepare(trial), "basal-bolus", np.arange(2), traces=True)
    ratio = people_of(trial, np.arange(2)).profile.carb_ratio_g_U
    np.testing.assert_array_equal(found.profile["carb_ratio_g_U"], ratio)
    breakfast = (found.insulin_mU_min[84].astype(float) - found.basal_insulin_mU_min) * 5e-3
    np.testing.assert_allclose(breakfast, 0.05 * np.floor(np.array([72.0, 8.0]) / ratio / 0.05), atol=2e-5)


@pytree
class ByWeight:
    """A controller of somebody's own that gives a rate by what it knows of the person."""

    rate_mU_min: Any
    sample_time_min: ClassVar[float] = 5.0

    def with_profile(self, profile: Profile):
        return dataclasses.replace(self, rate_mU_min=jnp.asarray(profile.weight_kg) / 10.0)

    def init(self, observation):
        return ()

    def step(self, state, observation):
        rate = jnp.zeros_like(observation.glucose_mg_dl) + self.rate_mU_min
        return state, Decision(insulin_mU_min=rate, status=jnp.zeros_like(rate, int) + int(Status.OK))


@pytest.mark.long
def test_a_controller_of_ones_own_is_told_the_profile():
    people = gl.virtual_people(gl.population("boiroux2017", patient="hovorka-2004"), 0, np.arange(5))
    run = simulate_people(people, ByWeight(rate_mU_min=1.0), scenario=Scenario([Meal(50.0, 50.0)], 100.0))
    np.testing.assert_allclose(run.insulin_mU_min[-1], people.draw.values["weight_kg"] / 10.0)


def test_a_profile_that_knows_no_doses_leaves_a_controller_as_it_was():
    controller = BasalBolus().of_person(Profile(basal_mU_min=6.73, setpoint_mg_dl=120.0))
    same = controller.with_profile(Profile(basal_mU_min=6.73, setpoint_mg_dl=120.0, weight_kg=75.0))
    assert float(same.carbs_per_U) == float(controller.carbs_per_U)
    assert float(same.fall_per_U) == float(controller.fall_per_U)
