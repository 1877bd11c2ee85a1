"""Situations in which a controller's model is wrong."""

import numpy as np
import pytest

from glucoloop.papers.meal_aware.measures import AT_SAMPLES, numbers_at_samples
from glucoloop.papers.meal_aware.mismatched_loops import MismatchedLoops, designer, mismatched_people
from glucoloop.papers.meal_aware.mismatches import GROUPS, MISMATCHES
from glucoloop.papers.meal_aware.situations import SITUATIONS, read_asked
from glucoloop.patients.model import patient_model

ROWS = {row.name: row for row in MISMATCHES}


def test_names_are_of_one_situation_each():
    assert len(ROWS) == len(MISMATCHES)
    assert {row.group for row in MISMATCHES} == set(GROUPS)
    assert not set(GROUPS) & {situation.name for situation in SITUATIONS}


def test_measures_of_a_written_course():
    glucose = np.full((121, 2), 81.0)
    glucose[30, 0], glucose[60, 0] = 59.0, 101.0  # before the last 200 min
    glucose[100:, 1] += 2.0
    insulin = np.full((120, 2), 20.0)
    insulin[110:, 1] += 3.0
    found = numbers_at_samples(glucose, insulin, 81.0, 5.0)
    assert set(found) == {measure.name for measure in AT_SAMPLES}
    assert found["undershoot_mg_dl"].tolist() == [22.0, 0.0]
    assert found["overshoot_mg_dl"].tolist() == [20.0, 2.0]
    assert found["time_below_60_pct"].tolist() == [pytest.approx(100.0 / 121.0), 0.0]
    assert found["late_offset_mg_dl"].tolist() == [0.0, pytest.approx(2.0 * 21 / 41)]
    assert found["late_swing_mg_dl"].tolist() == [0.0, 2.0]
    assert found["late_variation_mU_min"].tolist() == [0.0, 3.0]


def test_corners_are_40_percent_off_and_at_rest():
    people = mismatched_people(ROWS["corners, late 10 min, correlated"], 3, 8)
    nominal = patient_model(people.name).nominal
    for name, values in people.draw.values.items():
        np.testing.assert_allclose(np.abs(values - nominal[name]), 0.4 * abs(nominal[name]), rtol=1e-12)
    glucose = np.asarray(people.patient.glucose_mg_dl(people.rest))
    np.testing.assert_allclose(glucose[people.feasible], 81.0, atol=1e-6)


@pytest.mark.long
def test_a_run_does_not_depend_on_the_other_situations():
    names = ("people, no fault", "people, blocked line", "stomach: slow", "setpoint 95, 50 g, no noise")
    rows = [ROWS[name] for name in names]
    told = []
    together = MismatchedLoops(rows, [3, 3, 2, 1], 5).run(designer("imc"), progress=told.append)
    assert sum(told) == 9
    alone = MismatchedLoops(rows[1:2], [2], 5).run(designer("imc"))
    for name, values in alone["people, blocked line"].numbers.items():
        np.testing.assert_allclose(values, together["people, blocked line"].numbers[name][:2], atol=1e-9)
    # the same people with the same noise: until the line is blocked glucose is the same, and then it rises
    free, blocked = (together[name].numbers["overshoot_mg_dl"] for name in names[:2])
    assert np.all(blocked > free + 10.0)
    assert together["setpoint 95, 50 g, no noise"].numbers["minimum_mg_dl"][0] > 80.0


def test_runs_follow_the_extent():
    asked = read_asked({"seeds": 16, "people": 64})
    assert ROWS["fasting, no noise"].runs_of(asked) == 1
    assert ROWS["fasting, white"].runs_of(asked) == 16
    assert ROWS["people, late 10 min, correlated"].runs_of(asked) == 64
    whole = read_asked({})
    assert ROWS["fasting, white"].runs_of(whole) == 30
    assert ROWS["people, late 10 min, correlated"].runs_of(whole) == 1000
