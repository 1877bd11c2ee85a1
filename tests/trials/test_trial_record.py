"""A trial deals its people into shards, and knows itself again."""

import dataclasses

import numpy as np
import pytest

from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial, default_shard_people, fingerprint


def make(**keys):
    return configured(Trial, {"people": 1000, "shard_people": 64, "controller": "mpc", **keys})


def test_shards_hold_everybody_once():
    trial = make(first_person=500)
    people = np.concatenate([trial.shard(index) for index in range(trial.shards)])
    assert trial.shards == 16
    np.testing.assert_array_equal(people, np.arange(500, 1500))
    assert trial.shard(15).size == 1000 - 15 * 64


@pytest.mark.parametrize(("traces", "kept"), [("none", 0), ("all", 1000), (3, 3)])
def test_traces_are_of_the_first_people(traces, kept):
    trial = make(first_person=500, traces=traces)
    assert trial.traced(500 + np.arange(1000)).nonzero()[0].tolist() == list(range(kept))


@pytest.mark.parametrize(
    ("people", "days", "traced", "size"),
    [(1000, 1, 0, 2048), (10_000, 1, 0, 2048), (100_000, 1, 0, 8192), (1_000_000, 1, 0, 16_384),
     (1_000_000, 30, 0, 1024), (10_000, 1, 5, 2048), (10_000, 14, 5, 128), (10**9, 366, 0, 1024), (10**9, 366, 1, 64),
     (1000, 364, 0, 256), (100, 40, 0, 512)],
)  # fmt: skip
def test_usual_size_of_shards(people, days, traced, size):
    assert default_shard_people(people, 1440.0 * days, traced=traced) == size


@pytest.mark.parametrize(("people", "days"), [(2000, 2), (1000, 1), (10**9, 366), (40, 0.1)])
def test_slow_controllers_have_small_shards(people, days):
    assert default_shard_people(people, 1440.0 * days, slow=True) == 256


def test_fingerprint_is_of_everything_that_matters():
    trial = make()
    assert fingerprint(trial) == fingerprint(make())
    others = [
        make(**keys)
        for keys in (
            {"people": 999}, {"seed": 1}, {"first_person": 1}, {"population": "lognormal"}, {"days": 2}, {"meals": []},
            {"meal_size_spread_pct": 1.0}, {"sensor": "white-noise"}, {"sensor": "dead-time"}, {"precision": "float32"},
            {"design": "individual"}, {"traces": 1}, {"shard_people": 65}, {"controller": "mpc, move_weight=1"},
            {"setpoint_mg_dl": 82.0}, {"announce_meals": True}, {"pump": "max_insulin_mU_min=60"},
            {"pump": "resolution_mU_min=1"}, {"model": "memory=30"}, {"guard": "usual"},
            {"start": "07:00"}, {"arithmetic": "portable"},
        )
    ]  # fmt: skip
    assert len({fingerprint(other) for other in [trial, *others]}) == len(others) + 1


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"people": 0}, "people is 0; give a whole number from 1 to"),
        ({"first_person": 2**32 - 999}, "the first person is 4294966297; with 1000 people give from 0 to 4294966296"),
        ({"shard_people": 0}, "shard_people is 0; give a whole number from 1 to"),
        ({"start": "7.30"}, "'7.30' is no time of day; write it like 07:30"),
        ({"traces": 1001}, "traces of 1001 people are not possible; give none, all, or 1 to 1000"),
    ],
)
def test_impossible_trials_are_refused(change, told):
    with pytest.raises(ValueError, match=told):
        dataclasses.replace(make(), **change)
