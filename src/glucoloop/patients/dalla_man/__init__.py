"""Patient model of the UVA/Padova simulator of 2008, after Dalla Man et al. (2007): type 1 diabetes."""

from glucoloop.patients.dalla_man.equations import STATE_NAMES
from glucoloop.patients.dalla_man.patient import DallaManPatient
from glucoloop.patients.dalla_man.simglucose import NamedPeople, people_of_simglucose

__all__ = ["STATE_NAMES", "DallaManPatient", "NamedPeople", "people_of_simglucose"]
