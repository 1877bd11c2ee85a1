"""Numbers of a record beside those of a replay, and the recorded doses under a change of the therapy."""

import numpy as np
import pytest

from forecast_records import gridded
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import configured
from glucoloop.situations.therapy_text import read_change
from glucoloop.studies.replay import ReplayRequest
from glucoloop.studies.replay.changed_doses import CalculatorNumbers, changed_doses
from glucoloop.studies.replay.study import _record


@pytest.mark.parametrize("every", [1, 3])
def test_the_daily_dose_of_a_record_does_not_depend_on_how_often_it_was_read(every):
    readings = np.full(288, np.nan)
    readings[::every] = 120.0
    readings[200:236] = np.nan  # a gap of three hours
    bolus_U = np.zeros(288)
    bolus_U[200] = 5.0
    record = gridded(readings, basal_U=np.full(288, 0.05), bolus_U=bolus_U)
    [dose_U] = _record(record).numbers()["daily_dose_U"]
    assert dose_U == pytest.approx(2.0 * (144 * 0.05 + 5.0))  # of the half day from noon on


BREAKFAST, CORRECTION, SNACK, DINNER = 84, 180, 200, 240  # samples: 7:00, 15:00, 16:40 and 20:00
CALCULATOR = CalculatorNumbers(carb_ratio_g_U=10.0, correction_mg_dl_U=40.0, target_mg_dl=120.0)


@pytest.fixture(scope="module")
def day():
    """A day with two meals and their boluses, one of them over 15 min, a snack without one, and a correction."""
    bolus_U, carbs_g = np.zeros((2, 288))
    carbs_g[[BREAKFAST, SNACK, DINNER]] = 50.0, 20.0, 80.0
    bolus_U[BREAKFAST - 2] = 5.0
    bolus_U[DINNER : DINNER + 3] = 3.0
    bolus_U[CORRECTION] = 2.0
    readings = np.full(288, 120.0)
    readings[CORRECTION] = 200.0
    return gridded(readings, basal_U=np.full(288, 0.1), bolus_U=bolus_U, carbs_g=carbs_g)


@pytest.fixture(scope="module")
def boluses_of(day):
    """Insulin of breakfast, of the correction and of dinner under a change, and of all boluses."""

    def boluses(text):
        U = changed_doses(day, read_change(text), CALCULATOR).record.user_bolus_U
        return [*(float(of.sum()) for of in (U[: BREAKFAST + 6], U[CORRECTION : SNACK + 6], U[DINNER - 7 :])), U.sum()]

    return boluses


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("carbs, 20% too low", (4.0, 2.0, 9.0 - 1.6)),
        ("carb_ratio, 8", (50.0 / 8.0, 2.0, 9.0 + 2.0)),
        ("carb_ratio, -20%, breakfast", (50.0 / 8.0, 2.0, 9.0)),
        ("correction_factor, -20%", (5.0, 2.0 + 80.0 / 32.0 - 80.0 / 40.0, 9.0)),
        ("target, 140, from 14h", (5.0, 1.5, 8.5)),
        ("carb_ratio, 1000%", (0.5, 2.0, 9.0 - 7.2)),
        ("target, 300", (0.5, 0.0, 4.5)),  # never below 0
        ("bolus, 15 min earlier", (5.0, 2.0, 9.0)),
    ],
)
def test_boluses_are_those_that_the_calculator_would_have_computed(boluses_of, text, expected):
    assert boluses_of(text) == pytest.approx([*expected, sum(expected)])


def test_basal_insulin_of_a_record_changes_in_its_hours_alone(day):
    by_percent, by_rate = (
        changed_doses(day, read_change(text), CALCULATOR).record
        for text in ("basal, +10%, 22h-6h", "basal, 1.8, 0h-6h")
    )
    night = (day.clock < 72) | (day.clock >= 264)
    assert by_percent.basal_U == pytest.approx(np.where(night, 0.11, 0.1))
    assert by_rate.basal_U == pytest.approx(np.where(day.clock < 72, 1.8 / 12.0, 0.1))
    assert (by_percent.user_bolus_U == day.user_bolus_U).all()


def test_boluses_of_meals_move_as_a_whole(day):
    for text, samples in (("bolus, 15 min earlier", -3), ("bolus, 10 min later", 2)):
        moved = changed_doses(day, read_change(text), CALCULATOR).record.user_bolus_U
        places = np.array([BREAKFAST - 2, DINNER, DINNER + 1, DINNER + 2])
        assert np.flatnonzero(moved).tolist() == sorted([*(places + samples).tolist(), CORRECTION])


def test_a_bolus_is_moved_by_whole_samples(tmp_path):
    (tmp_path / "twin.json").write_text('{"patient": "hovorka-2004"}')
    (tmp_path / "person.toml").write_text('[[person]]\nname = "twin"\nS_IT = 50e-4\n')
    given = {"files": ["a.parquet"], "twin": str(tmp_path)}
    with pytest.raises(Refusal, match="give a multiple of that"):
        configured(ReplayRequest, {**given, "changes": ["bolus, 7 min earlier"]})
    assert configured(ReplayRequest, {**given, "changes": ["basal, +10%"]}).cases == ()
    [case] = configured(ReplayRequest, {**given, "changes": ["basal, +10%"], "controller": ["basal-bolus"]}).cases
    assert case.label == "basal-bolus"
