"""Virtual patients."""

from glucoloop.patients.operating_point import OPERATING_POINTS, SorensenPatient, at_basal, at_setpoint, patient
from glucoloop.patients.protocol import Inputs, Patient, SemilinearPatient

__all__ = [
    "OPERATING_POINTS",
    "Inputs",
    "Patient",
    "SemilinearPatient",
    "SorensenPatient",
    "at_basal",
    "at_setpoint",
    "patient",
]
