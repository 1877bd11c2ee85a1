"""``glucoloop list``: what there is, from the declarations."""

import pytest

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.faults import FAULTS
from glucoloop.patients.catalogue import PATIENTS


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


def test_one_part_is_told_with_its_settings_their_units_bounds_and_defaults(glucoloop):
    [told] = glucoloop("list", "mpc", "--json").json["parts"]
    horizon = next(setting for setting in told["settings"] if setting["name"] == "prediction_horizon")
    assert horizon["default"] == {"": 8, "with noise": 10, "under the skin": 0}
    assert horizon["possible"] == "a whole number from 0 to 288"
    text = glucoloop("list", "lag").out
    assert "lag_min = 10   (a number above 0 min and up to 120 min, or one in h, s or d)" in text


def test_a_name_of_two_kinds_is_told_of_both(glucoloop):
    assert [part["kind"] for part in glucoloop("list", "resolution", "--json").json["parts"]] == ["pump", "fault"]


def test_a_patient_is_told_with_its_points_and_populations(glucoloop):
    text = " ".join(glucoloop("list", "hovorka-2004").out.split())
    assert "Operating point fasting-120: held at 120 mg/dl" in text
    assert "Population boiroux2017" in text
    assert "min_insulin_mU_min 0, max_insulin_mU_min 66.9" in text


def test_what_another_package_adds_is_listed(glucoloop, install):
    install("your_own_sensor", "sensors", "late-steps", "LateSteps")
    assert "late-steps" in glucoloop("list", "sensors").out
    assert "step_mg_dl = 1" in glucoloop("list", "late-steps").out


def test_an_unknown_name_is_refused_with_the_likely_one(refused):
    assert refused("list", "spike") == "there is no component and no kind of components 'spike'; did you mean 'spikes'?"


def test_the_people_of_a_population_by_its_name(glucoloop):
    text = " ".join(glucoloop("list", "kanderian2009").out.split())
    assert text.startswith(
        "population kanderian2009: the ten people of Kanderian et al. (2009), by name 1 to 10 10 people"
    )
    assert "10 people of kanderian-2009, by name: 1, 2, 3, 4, 5, 6, 7, 8, 9, 10" in text
    [told] = glucoloop("list", "kanderian2009", "--json").json["parts"]
    assert [person["total_daily_dose_U"] for person in told["person"]] == [50, 43, 30, 65, 42, 21, 40, 30, 50, 34]
    of_patient = glucoloop("list", "kanderian-2009").out
    assert of_patient.count("kanderian2009") == 1  # one line, however many people there are


def test_how_a_population_is_drawn(glucoloop):
    told = " ".join(glucoloop("list", "boiroux2017").out.split())
    assert "one alone: --patient 'hovorka-2004, person=17'" in told
    assert "weight_kg from 65 to 95, about 80 (uniform): body weight" in told


def test_components_of_one_name_are_listed_whole(glucoloop):
    told = glucoloop("list", "loop-like").out
    assert "controller loop-like: " in told
    assert "forecast method loop-like: " in told
    assert "  fitted = false" in told
