"""The loops of the claims are those that anybody can close with ``glucoloop run`` and ``glucoloop trial``."""

import numpy as np
import pytest

from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial
from glucoloop.tuning.oscillation import oscillation
from meal_aware.loops import bound_of, close_loops
from meal_aware.measures import numbers_by_minute
from meal_aware.situations import MISMATCHES, SITUATIONS, Extent

BY_NAME = {row.name: row for row in SITUATIONS}
DEAD_TIME, PEOPLE = BY_NAME["dead-time-10"], BY_NAME["people"]


@pytest.fixture(scope="module")
def loops():
    """Linear MPC, which has a model of its own for each seed."""
    ((situation, controller, runs),) = close_loops(Extent(seed=11, seeds=2), [DEAD_TIME], controllers=("mpc",))
    assert (situation, controller) == ("dead-time-10", "mpc")
    return runs


def _run(seed, **other):
    run = configured(Run, {**DEAD_TIME.run_of("mpc", seed), **other})
    return close_the_loop(run, run.case)


def test_a_seed_is_the_run_of_that_seed(loops):
    assert loops.run.tolist() == [11, 12]
    one = _run(12)
    for name in ("undershoot_mg_dl", "overshoot_mg_dl", "minimum_mg_dl", "insulin_total_variation_mU_min"):
        assert loops.numbers[name][1] == pytest.approx(float(getattr(one.metrics, name)), abs=1e-5)
    assert abs(np.diff(loops.numbers["undershoot_mg_dl"])[0]) > 0.1


def test_oscillation_is_that_of_the_same_controller_without_noise(loops):
    noisy = configured(Run, DEAD_TIME.run_of("mpc", 11))
    tuned = {"controller": noisy.case.tree(whole=True), "sensor": ["dead-time, minutes=10"]}
    alone = oscillation(_run(11, **tuned).trace)
    found = [loops.numbers[name].tolist() for name in ("quiet_crossings", "quiet_turns")]
    assert found == [[int(alone.crossings)], [int(alone.turns)]]


def test_people_are_those_of_a_trial():
    ((_, _, loops),) = close_loops(Extent(seed=11, people=3), [PEOPLE], controllers=("basal",))
    assert loops.run.tolist() == [0, 1, 2]
    assert loops.infeasible == 0
    trial = configured(Trial, PEOPLE.trial_of("basal", 11, 3))
    one = engine.run_people(engine.prepare(trial), "basal", [1], traces=True)
    assert loops.numbers["overshoot_mg_dl"][1] == pytest.approx(float(one.metrics["overshoot_mg_dl"][0]))
    within = np.abs(np.asarray(one.glucose_mg_dl)[:, 0] - trial.target_mg_dl) <= 15.0
    assert loops.numbers["time_near_pct"][1] == pytest.approx(100.0 * within.mean(), abs=1.5)
    # without a controller everybody follows an individual basal rate
    assert np.all(loops.numbers["insulin_total_variation_mU_min"] < 1e-6)
    assert np.all(loops.numbers["overshoot_mg_dl"] > 15.0)


def test_loops_that_are_kept_are_not_closed_again():
    done = {(PEOPLE.name, "basal"), (MISMATCHES[0].name, "imc")}
    assert list(close_loops(Extent(), [PEOPLE], controllers=("basal",), done=done)) == []
    assert list(close_loops(Extent(), [], MISMATCHES[:1], controllers=("imc",), done=done)) == []


def test_the_bound_is_that_of_the_nominal_person_and_the_meal():
    rows = {row.name: row for row in MISMATCHES}
    assert bound_of(PEOPLE) is None
    for name in ("people, no fault", "late", "corners, late 10 min, correlated", "guarded, no fault"):
        assert all(bound_of(row) is None for row in rows.values() if row.name == name)
    assert bound_of(rows["fasting, white"]).bound == pytest.approx(0.0, abs=1e-3)
    assert bound_of(rows["fasting, no noise"]) is bound_of(rows["fasting, white"])


def test_time_between_samples_is_taken_as_straight():
    t_min = np.arange(0.0, 601.0, 5.0)
    ramp = 81.1 + 30.0 * t_min[:, None] / 600.0  # beyond 15 from 300 min on
    metrics = dict.fromkeys(("minimum_mg_dl", "insulin_total_variation_mU_min", "undershoot_mg_dl"), np.zeros(1))
    found = numbers_by_minute({**metrics, "overshoot_mg_dl": np.full(1, 30.0)}, t_min, ramp, 81.1)
    assert found["time_near_pct"][0] == pytest.approx(100.0 * 301 / 601, abs=100.0 / 601 + 1e-9)
    assert found["deviation_mg_dl"][0] == 30.0
    assert found["late_swings"][0] == 0.0
