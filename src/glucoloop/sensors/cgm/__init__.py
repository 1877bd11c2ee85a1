"""Continuous glucose monitors: their errors as published, their days of wear, and what they show."""

from glucoloop.sensors.cgm.breton_2008 import Breton2008
from glucoloop.sensors.cgm.dexcom_g5 import DexcomG5
from glucoloop.sensors.cgm.dexcom_g6 import DexcomG6
from glucoloop.sensors.cgm.display import Display
from glucoloop.sensors.cgm.facchinetti_2014 import Facchinetti2014
from glucoloop.sensors.cgm.model import ErrorModel
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.sensors.cgm.vettoretti_2019 import Vettoretti2019

__all__ = [
    "Breton2008",
    "DexcomG5",
    "DexcomG6",
    "Display",
    "ErrorModel",
    "Facchinetti2014",
    "Monitor",
    "Vettoretti2019",
]
