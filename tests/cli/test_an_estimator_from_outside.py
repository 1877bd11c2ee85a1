"""An estimator of meals of another package: one class, and the controller and the test of estimators know it."""

import pytest

from glucoloop.build.designs import controller_of
from glucoloop.estimation.unknown_meal import ESTIMATORS
from glucoloop.reporting.descriptions import _case_in_words
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.detection import Detection

NAME = "your_own_estimator:Juice"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_estimator", "estimators", "juice", "Juice")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "juice" in ESTIMATORS.names()
    assert ESTIMATORS.find("juice") == ESTIMATORS.find(NAME)


@pytest.mark.long
def test_the_controller_is_designed_with_it_and_its_settings(outside):
    run = configured(Run, controller=f"meal-mpc, estimator=({NAME}, share=0.25), meals_per_h=0.1")
    estimator = controller_of(run, run.case).meal_estimator
    assert (estimator.fast_meals, estimator.fast_horizon) == (0.25, 6)
    assert run.tree(whole=True)["controller"][0]["estimator"] == {"name": NAME, "share": 0.25}
    assert f"estimator {NAME}, share=0.25" in _case_in_words(run.case)


def test_it_is_tested_beside_others(outside):
    asked = configured(Detection, estimators=["kalman", f"{NAME}, share=0.2", NAME])
    assert [case.label for case in asked.trial.cases] == ["kalman", f"{NAME}, share=0.2", NAME]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("guess", "unknown estimator 'guess'; the known ones are: moving-horizon, kalman"),
        (f"({NAME}, share=1)", "share is 1; give a number of 0 or more and below 1"),
        ("(kalman, horizon=4)", "the estimator kalman has no setting 'horizon'"),
    ],
)
def test_what_it_cannot_be_is_said(outside, text, sentence):
    with pytest.raises(ValueError, match=sentence):
        configured(Run, controller=f"meal-mpc, estimator={text}")
