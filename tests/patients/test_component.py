"""A patient is one class: its settings choose a person, its constants and equations are the person."""

from typing import ClassVar

import jax
import pytest

import glucoloop as gl
from glucoloop.patients import OdePatient, OperatingPoint
from glucoloop.patients.catalogue import PATIENTS, patient_entry


class Decay(OdePatient):
    """Glucose that falls in proportion to itself and to insulin."""

    nominal: ClassVar = {"rate": 0.01, "made": 2.0, "effect": 0.05}
    near_rest = (90.0,)
    near_basal_mU_min = 22.0

    def derivative(self, t_min, x, inputs):
        c = self.parameters
        return (c["made"] - c["rate"] * x[0] - c["effect"] * inputs.insulin_mU_min + inputs.meal_mg_min / 100.0)[None]

    def glucose_mg_dl(self, x):
        return x[0]


@pytest.mark.parametrize("name", PATIENTS)
def test_the_entry_makes_people_of_its_own_class(name):
    entry = PATIENTS[name]
    for point in entry.operating_points:
        person = gl.patient(name, point.name)
        assert type(person) is entry
        assert person.operating_point is None
        leaves, structure = jax.tree.flatten(person)
        again = jax.tree.unflatten(structure, leaves)
        assert again.operating_point is None
        assert jax.tree.structure(again) == structure
    assert set(entry.nominal) <= {*entry.meanings, "absorption_rate"} or not entry.meanings
    assert set(entry.of_other_packages) <= set(entry.populations)


def test_settings_do_not_compile_again():
    traces = []

    @jax.jit
    def twice(person):
        traces.append(person.operating_point)
        return 2.0 * person.setpoint_mg_dl

    person = Decay.resting_at(90.0)
    assert float(twice(person)) == 180.0
    assert float(twice(person.replaced(person="anna", setpoint_mg_dl=person.setpoint_mg_dl - 10.0))) == 160.0
    assert traces == [None]


def test_equations_alone_make_a_person_and_no_entry():
    # made - rate G = effect u
    assert float(Decay.resting_at(90.0).basal_insulin_mU_min) == pytest.approx((2.0 - 0.01 * 90.0) / 0.05)
    with pytest.raises(TypeError, match="Decay lacks operating_points or pulse_mU_min; add them"):
        Decay.refuse_incomplete()

    class Entered(Decay):
        """The same with what an entry needs."""

        operating_points = (OperatingPoint("at-90", "held at 90 mg/dl by 22 mU/min", glucose_mg_dl=90.0),)
        pulse_mU_min = 10.0

    assert float(Entered.at_operating_point("at-90").basal_insulin_mU_min) == pytest.approx(22.0)
    assert Entered.usual_pump.max_mU_min == patient_entry("parker-1999").max_insulin_mU_min
