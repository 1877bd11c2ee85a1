"""``glucoloop list``: what there is, from the declarations."""

import pytest

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.faults import FAULTS
from glucoloop.patients.settings import PATIENTS


def test_everything_is_listed_a_line_each(glucoloop):
    told = glucoloop("list")
    assert told.code == 0
    for name in (*PATIENTS, *CONTROLLERS, *FAULTS):
        assert f"  {name} " in told.out
    assert max(map(len, told.out.splitlines())) <= 100


@pytest.mark.parametrize("kind", ["fault", "faults"])
def test_a_kind_is_listed_alone(glucoloop, kind):
    told = glucoloop("list", kind, "--json").json["parts"]
    assert [part["name"] for part in told] == list(FAULTS)
    assert {part["kind"] for part in told} == {"fault"}


def test_one_part_is_told_with_its_settings_their_units_bounds_and_usual_values(glucoloop):
    [told] = glucoloop("list", "mpc", "--json").json["parts"]
    horizon = next(setting for setting in told["settings"] if setting["name"] == "prediction_horizon")
    assert horizon["usual"] == {"": 8, "with noise": 10, "under the skin": 0}
    assert horizon["possible"] == "a whole number from 0 to 288"
    text = glucoloop("list", "lag").out
    assert "lag_min = 10   (a number above 0 min and up to 120 min, or one in h, s or d)" in text


def test_a_name_of_two_kinds_is_told_of_both(glucoloop):
    assert [part["kind"] for part in glucoloop("list", "resolution", "--json").json["parts"]] == ["pump", "fault"]


def test_a_patient_is_told_with_its_points_and_populations(glucoloop):
    text = glucoloop("list", "hovorka-2004").out
    assert "Operating point fasting-120: held at 120 mg/dl" in text
    assert "Population boiroux2017" in text
    assert "min_insulin_mU_min 0, max_insulin_mU_min 66.9" in text


def test_what_another_package_adds_is_listed(glucoloop, install):
    install("your_own_sensor", "sensors", "late-steps", "LateSteps")
    assert "late-steps" in glucoloop("list", "sensors").out
    assert "step_mg_dl = 1" in glucoloop("list", "late-steps").out


def test_an_unknown_name_is_refused_with_the_likely_one(refused):
    assert refused("list", "spike") == "there is no part and no kind of parts 'spike'; did you mean 'spikes'?"
