"""Patient model of the UVA/Padova simulator of 2008, after Dalla Man et al. (2007): type 1 diabetes."""

from glucoloop.patients.dalla_man.equations import STATE_NAMES
from glucoloop.patients.dalla_man.patient import DallaManPatient

__all__ = ["STATE_NAMES", "DallaManPatient"]
