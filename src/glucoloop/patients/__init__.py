"""Virtual patients, by family."""

from glucoloop.patients.joint import JointVariation
from glucoloop.patients.model import PatientModel, patient
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.population import (
    Draw,
    Population,
    VirtualPeople,
    draw,
    population,
    populations_of,
    virtual_people,
)
from glucoloop.patients.protocol import Inputs, Patient, SemilinearPatient
from glucoloop.patients.sorensen.patient import OPERATING_POINTS, SorensenPatient, at_basal, at_setpoint
from glucoloop.patients.table import PeopleTable
from glucoloop.patients.variation import Variation

__all__ = [
    "OPERATING_POINTS",
    "Draw",
    "Inputs",
    "JointVariation",
    "OdePatient",
    "Patient",
    "PatientModel",
    "PeopleTable",
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
    "populations_of",
    "virtual_people",
]
