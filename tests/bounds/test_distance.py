"""How far a run is from the best."""

import dataclasses

import numpy as np
import pytest

import glucoloop as gl
from glucoloop.bounds import bound_of_situation, distance_to_bound
from glucoloop.bounds.trajectory import trajectory_of
from glucoloop.pumps.limits import PARKER_1999_LIMITS


@pytest.mark.long
def test_distance_of_no_control(best, scenario):
    course = trajectory_of(gl.patient(), scenario, 5.0, [scenario.meals])
    glucose = course.glucose_mg_dl(np.full((40, 1), course.resting_mU_min))[:, 0]
    distance = distance_to_bound(glucose, best(10.0))
    assert distance.deviation_mg_dl == pytest.approx(glucose.max() - 81.1)
    assert distance.distance_mg_dl == pytest.approx(distance.deviation_mg_dl - best(10.0).bound)
    assert distance_to_bound(best(10.0).glucose_mg_dl, best(10.0)).distance_mg_dl < 0.002


@pytest.mark.long
def test_other_runs_and_bounds_are_refused(best):
    with pytest.raises(ValueError, match="glucose of shape"):
        distance_to_bound(np.zeros(3), best(10.0))
    with pytest.raises(ValueError, match="work it out for 'deviation'"):
        distance_to_bound(best(10.0).glucose_mg_dl, dataclasses.replace(best(10.0), objective="sse"))


@pytest.mark.parametrize(("announced", "dead_time_min", "known_after_min"), [(False, 10.0, 10.0), (True, 10.0, -3.0)])
def test_situation_says_when_a_meal_is_known(monkeypatch, announced, dead_time_min, known_after_min):
    asked = {}
    globals_ = bound_of_situation.__globals__
    monkeypatch.setitem(globals_, "optimal_doses", lambda *args, **settings: asked.update(settings))
    scenario = gl.Scenario([gl.Meal(50.0, 53.0)], announced=announced)
    bound_of_situation(gl.patient(), scenario, PARKER_1999_LIMITS, dead_time_min=dead_time_min)
    assert asked["known_after_min"] == known_after_min
