"""Patient model of Hovorka et al. (2004) and Wilinska et al. (2010): type 1 diabetes, subcutaneous insulin."""

from glucoloop.patients.hovorka.equations import STATE_NAMES, HovorkaParameters
from glucoloop.patients.hovorka.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_basal, at_setpoint
from glucoloop.patients.hovorka.wilinska import WILINSKA_2010, WilinskaParameters

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
