"""Patient model of Hovorka et al. (2004) and Wilinska et al. (2010): type 1 diabetes, subcutaneous insulin."""

from glucoloop.patients.hovorka.equations import STATE_NAMES, HovorkaParameters
from glucoloop.patients.hovorka.parameters.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.parameters.wilinska2010 import WILINSKA_2010
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_basal, at_setpoint
from glucoloop.patients.hovorka.wilinska import WilinskaParameters

__all__ = [
    "HOVORKA_2004",
    "STATE_NAMES",
    "WILINSKA_2010",
    "HovorkaParameters",
    "HovorkaPatient",
    "WilinskaParameters",
    "at_basal",
    "at_setpoint",
]
