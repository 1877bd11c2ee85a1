"""Virtual patients."""

from glucoloop.patients.operating_point import OPERATING_POINTS, SorensenPatient, at_basal, at_setpoint, patient
from glucoloop.patients.population import (
    PRESETS,
    Draw,
    Population,
    VirtualPeople,
    draw,
    population,
    virtual_people,
)
from glucoloop.patients.protocol import Inputs, Patient, SemilinearPatient
from glucoloop.patients.variation import Variation

__all__ = [
    "OPERATING_POINTS",
    "PRESETS",
    "Draw",
    "Inputs",
    "Patient",
    "Population",
    "SemilinearPatient",
    "SorensenPatient",
    "Variation",
    "VirtualPeople",
    "at_basal",
    "at_setpoint",
    "draw",
    "patient",
    "population",
    "virtual_people",
]
