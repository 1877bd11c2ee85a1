"""Situations, the extent of a comparison, and the loops of those in which a controller's model is wrong."""

import numpy as np
import pytest

from glucoloop.patients.catalogue import patient_entry
from meal_aware.measures import numbers_at_samples
from meal_aware.mismatched_loops import MismatchedLoops, designer, mismatched_people
from meal_aware.situations import GROUPS, MISMATCHES, SITUATIONS, Extent

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
    assert found["undershoot_mg_dl"].tolist() == [22.0, 0.0]
    assert found["overshoot_mg_dl"].tolist() == [20.0, 2.0]
    assert found["time_below_60_pct"].tolist() == [pytest.approx(100.0 / 121.0), 0.0]
    assert found["late_offset_mg_dl"].tolist() == [0.0, pytest.approx(2.0 * 21 / 41)]
    assert found["late_swing_mg_dl"].tolist() == [0.0, 2.0]
    assert found["late_variation_mU_min"].tolist() == [0.0, 3.0]


def test_corners_are_40_percent_off_and_at_rest():
    people = mismatched_people(ROWS["corners, late 10 min, correlated"], 3, 8)
    nominal = patient_entry(people.name).nominal
    for name, values in people.draw.values.items():
        np.testing.assert_allclose(np.abs(values - nominal[name]), 0.4 * abs(nominal[name]), rtol=1e-12)
    glucose = np.asarray(people.patient.glucose_mg_dl(people.rest))
    np.testing.assert_allclose(glucose[people.feasible], 81.0, atol=1e-6)


@pytest.mark.long
def test_a_run_does_not_depend_on_the_other_situations():
    names = ("people, no fault", "people, blocked line", "stomach: slow", "setpoint 95, 50 g, no noise")
    rows = [ROWS[name] for name in names]
    together = MismatchedLoops(rows, [3, 3, 2, 1], 5).run(designer("imc"))
    alone = MismatchedLoops(rows[1:2], [2], 5).run(designer("imc"))
    for name, values in alone["people, blocked line"].numbers.items():
        np.testing.assert_allclose(values, together["people, blocked line"].numbers[name][:2], atol=1e-9)
    # the same people with the same noise: until the line is blocked glucose is the same, and then it rises
    free, blocked = (together[name].numbers["overshoot_mg_dl"] for name in names[:2])
    assert np.all(blocked > free + 10.0)
    assert together["setpoint 95, 50 g, no noise"].numbers["minimum_mg_dl"][0] > 80.0


def test_runs_follow_the_extent():
    small = Extent(seed=7, seeds=16, people=64)
    assert ROWS["fasting, no noise"].runs_of(small) == 1
    assert ROWS["fasting, white"].runs_of(small) == 16
    assert ROWS["people, late 10 min, correlated"].runs_of(small) == 64
    assert ROWS["fasting, white"].runs_of(Extent()) == 30
    assert ROWS["people, late 10 min, correlated"].runs_of(Extent()) == 1000
    assert ROWS["fasting, no noise"].runs_in_words(small) == "one run"
    assert ROWS["corners, late 10 min, correlated"].runs_in_words(small) == "64 people at corners of seed 7"
    told = {situation.name: situation.runs_in_words(small) for situation in SITUATIONS}
    assert (told["noise-free"], told["noise"], told["people"]) == (
        "one run",
        "seeds 7 to 22",
        "people 0 to 63 of seed 7",
    )


def test_overlap_with_the_tuning_is_found():
    assert Extent(seed=1).tuned_on == ()
    assert Extent(seed=899_900, seeds=101).tuned_on == ("seeds 900000 to 900000 of the sensor",)
    assert Extent(seed=899_900, seeds=100).tuned_on == ()
    assert Extent(seed=900_199).tuned_on == ("seeds 900199 to 900199 of the sensor",)
    assert Extent(seed=900_200).tuned_on == ()
    assert Extent(seed=424_242).tuned_on == ("the people of seed 424242",)
    assert Extent(seed=1000).tuned_on == ("the people and the noise of seed 1000",)
