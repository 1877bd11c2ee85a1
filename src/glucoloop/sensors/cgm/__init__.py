"""Continuous glucose monitors: their errors as published, their days of wear, and what they show."""

from glucoloop.sensors.cgm.breton_2008 import BRETON_2008
from glucoloop.sensors.cgm.dexcom_g5 import DEXCOM_G5
from glucoloop.sensors.cgm.dexcom_g6 import DEXCOM_G6
from glucoloop.sensors.cgm.display import Display, display
from glucoloop.sensors.cgm.facchinetti_2014 import FACCHINETTI_2014
from glucoloop.sensors.cgm.model import ErrorModel
from glucoloop.sensors.cgm.monitor import Monitor, monitor
from glucoloop.sensors.cgm.vettoretti_2019 import VETTORETTI_2019

__all__ = [
    "BRETON_2008",
    "DEXCOM_G5",
    "DEXCOM_G6",
    "FACCHINETTI_2014",
    "VETTORETTI_2019",
    "Display",
    "ErrorModel",
    "Monitor",
    "display",
    "monitor",
]
