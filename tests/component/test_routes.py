"""What is usual of a patient follows from the route of insulin, unless its entry says otherwise."""

from types import SimpleNamespace

import pytest

import glucoloop as gl
from glucoloop.component.grammar import as_tree
from glucoloop.component.request import completed, configuration_from
from glucoloop.component.routes import PUMP_OF_1999, ROUTES, SUBCUTANEOUS, route_of
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.guard_settings import guard_of
from glucoloop.patients.catalogue import PATIENTS, patient_entry
from glucoloop.patients.component import OperatingPoint, PatientComponent
from glucoloop.simulation.closed_loop import usual_limits
from glucoloop.situations.run import Run


def entry_of(route):
    """A patient of another package that says no more than it has to."""

    class Somebody(PatientComponent, name="somebody"):
        """Somebody."""

        operating_points = (OperatingPoint("at-rest", "at steady state"),)
        insulin_route = route
        pulse_mU_min = 10.0

    return Somebody


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize(("route", "like"), [("subcutaneous", "hovorka-2004"), ("intravenous", "parker-1999")])
def test_tunings_identification_and_guard_of_another_package_are_those_of_the_route(controller, route, like):
    somebody, known = entry_of(route), patient_entry(like)
    for noisy in (False, True):
        part = CONTROLLERS[controller]()
        found = completed(part, somebody().controller_defaults(controller), noisy=noisy).values()
        usual = completed(part, known().controller_defaults(controller), noisy=noisy).values()
        if route == "subcutaneous" and "prediction_horizon" in usual:
            assert found.pop("prediction_horizon") == 0  # it follows from the model
            assert usual.pop("prediction_horizon") in (36, 48)
        assert found == usual
    assert somebody.identification(5.0) == known.identification(5.0)
    assert guard_of(somebody) == guard_of(known)


def test_pump_is_that_of_the_route():
    assert ROUTES["intravenous"].pump is PUMP_OF_1999
    found = entry_of("subcutaneous")
    assert (found.min_insulin_mU_min, found.max_insulin_mU_min, found.max_change_mU_min) == (0.0, 500.0, 500.0)


@pytest.mark.parametrize("name", list(PATIENTS))
def test_python_and_the_commands_take_the_same_pump(name):
    entry, limits = patient_entry(name), usual_limits(gl.patient(name))
    assert limits.max_mU_min == entry.max_insulin_mU_min
    assert limits.max_change_mU_min == entry.max_change_mU_min
    assert limits.min_mU_min == entry.min_insulin_mU_min


def test_person_of_ones_own_has_the_pump_of_the_route():
    assert usual_limits(SimpleNamespace(insulin_route=SUBCUTANEOUS)).max_mU_min == 500.0
    assert usual_limits(SimpleNamespace()).max_mU_min == PUMP_OF_1999.max_mU_min
    with pytest.raises(ValueError, match=r"^unknown route of insulin 'nasal'; the known ones are: intravenous"):
        usual_limits(SimpleNamespace(insulin_route="nasal"))
    with pytest.raises(ValueError, match=r"^unknown route of insulin 'subcutanous'; did you mean 'subcutaneous'"):
        route_of("subcutanous")


def test_pump_of_30_units_an_hour_is_unusual_into_a_vein_only():
    pump = {"max_insulin_mU_min": 500.0}
    assert configuration_from(Run, as_tree({"patient": "hovorka-2004", "pump": pump}, "")).limits.max_mU_min == 500.0
    with pytest.raises(ValueError, match=r"^max_insulin_mU_min of the pump is 500 mU/min; "):
        configuration_from(Run, as_tree({"pump": pump}, ""))


@pytest.mark.long
def test_person_who_names_the_route_alone_in_python():
    person = gl.patient("kanderian-2009")
    found = gl.identify(person)
    assert found.model.memory == 288
    stepper = gl.Stepper(person, sample_time_min=5.0)
    assert float(stepper.step(1000.0).delivered_mU_min) == 500.0
