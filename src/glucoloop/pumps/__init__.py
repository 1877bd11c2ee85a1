"""Insulin pumps, each one class; all but the limited one wrap another pump, their ``inner``.

A pump joins every command by one class, entered in `PUMPS` or by the entry point of another package in the group
``glucoloop.pumps``.
"""

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.pumps.expiring import Expiring, rate_in_force
from glucoloop.pumps.infusion_set import InfusionSet
from glucoloop.pumps.limits import (
    DEFAULT_BOLUS_LIMITS,
    PARKER_1999_LIMITS,
    BolusLimits,
    DoseLimits,
    LimitedPump,
    PumpAround,
    PumpComponent,
    bolus_limits,
    dose_limits,
)
from glucoloop.pumps.pen import Pen
from glucoloop.pumps.protocol import Delivery, Pump, deliver
from glucoloop.pumps.resolution import Resolution, with_resolution

PUMPS: Final = Catalogue(
    PumpComponent,
    (LimitedPump, Resolution, Expiring, InfusionSet, Pen),
    example="expiring, samples=3",
    unnamed=True,
)

__all__ = [
    "DEFAULT_BOLUS_LIMITS",
    "PARKER_1999_LIMITS",
    "PUMPS",
    "BolusLimits",
    "Delivery",
    "DoseLimits",
    "Expiring",
    "InfusionSet",
    "LimitedPump",
    "Pen",
    "Pump",
    "PumpAround",
    "PumpComponent",
    "Resolution",
    "bolus_limits",
    "deliver",
    "dose_limits",
    "rate_in_force",
    "with_resolution",
]
