"""Patient model of Kanderian et al. (2009), the Medtronic virtual patient: type 1 diabetes, subcutaneous insulin."""

from glucoloop.patients.kanderian.parameters.kanderian2009 import CONSTANTS, people
from glucoloop.patients.kanderian.patient import KanderianPatient

__all__ = ["CONSTANTS", "KanderianPatient", "people"]
