"""Patient model of Hovorka et al. (2004): type 1 diabetes, subcutaneous insulin."""

from glucoloop.patients.hovorka.equations import STATE_NAMES, HovorkaParameters
from glucoloop.patients.hovorka.parameters.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_basal, at_setpoint

__all__ = ["HOVORKA_2004", "STATE_NAMES", "HovorkaParameters", "HovorkaPatient", "at_basal", "at_setpoint"]
