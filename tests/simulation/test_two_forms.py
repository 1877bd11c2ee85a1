"""A patient whose derivative is not what the fast integrator takes is refused, or carried by the adaptive one."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.meals import Scenario
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.hovorka.patient import HovorkaPatient
from glucoloop.simulation import Adaptive, Exponential
from glucoloop.simulation.people_plant import PeoplePlant
from glucoloop.simulation.plant import SampleGrid
from glucoloop.simulation.user_objects import goes_fast, refuse_two_patients

DAY = Scenario(meals=(), horizon_min=720.0)


class Circadian(HovorkaPatient):
    """A patient who makes more glucose in the morning."""

    def derivative(self, t_min, x, inputs):
        more = jnp.sin(2.0 * jnp.pi * t_min / 1440.0)
        slow, driven = self.split(super().derivative(t_min, x, inputs))
        return self.join(slow.at[0].add(0.1 * more), driven)


class Mistaken(HovorkaPatient):
    """A patient whose transport has a slip."""

    def transport(self, y):
        return 1.01 * super().transport(y)


def made(kind):
    of = gl.patient("hovorka-2004")
    return kind(**{field.name: getattr(of, field.name) for field in dataclasses.fields(of)})


def basal(person):
    return gl.design_open_loop(person.basal_insulin_mU_min, sample_time_min=5.0)


@pytest.mark.parametrize(
    ("name", "point"), [(entry.name, point.name) for entry in PATIENTS.values() for point in entry.operating_points]
)
def test_the_forms_of_every_patient_are_the_same(name, point):
    patient = gl.patient(name, point)
    if not isinstance(patient, SemilinearPatient):
        assert not goes_fast(patient)
        return
    refuse_two_patients(patient)
    assert goes_fast(patient)


@pytest.mark.long
def test_a_patient_of_the_clock_keeps_it_by_default():
    person = made(Circadian)
    controller = basal(person)
    usual, reference = (
        gl.simulate(person, controller, scenario=DAY, integrator=of).fine_glucose_mg_dl for of in (None, Adaptive())
    )
    np.testing.assert_allclose(usual, reference, atol=1e-5)
    assert float(jnp.max(usual)) > float(person.setpoint_mg_dl) + 20.0


@pytest.mark.parametrize(
    ("kind", "why", "mend"),
    [
        (Circadian, "its derivative follows the time", "Leave the integrator out"),
        (Mistaken, "its derivative is not what transport, kinetics", "Make both forms the same"),
    ],
)
def test_the_fast_integrator_and_native_code_refuse_another_patient(kind, why, mend):
    person, grid = made(kind), SampleGrid(5.0, 4)
    told = rf"{kind.__name__} is another patient .*{why}.* At [\d.]+ min after the start, the rate of state \d.*{mend}"
    with pytest.raises(ValueError, match=told):
        gl.simulate(person, basal(person), scenario=DAY, integrator=Exponential())
    with pytest.raises(ValueError, match=told):
        PeoplePlant(person, person, grid, 2)
