"""Insulin pumps: limits of the basal rate and of boluses, delivery resolution, and faults.

What wraps an `inner` pump wraps one with the limits of the paper by default.
"""

from glucoloop.pumps.expiring import Expiring, expiring, rate_in_force
from glucoloop.pumps.faults import battery_gap, missed_pulses, occlusion, unheard
from glucoloop.pumps.limits import (
    PARKER_1999_LIMITS,
    USUAL_BOLUS_LIMITS,
    BolusLimits,
    DoseLimits,
    LimitedPump,
    bolus_limits,
    dose_limits,
)
from glucoloop.pumps.protocol import Delivery, Pump
from glucoloop.pumps.resolution import Resolution, with_resolution

__all__ = [
    "PARKER_1999_LIMITS",
    "USUAL_BOLUS_LIMITS",
    "BolusLimits",
    "Delivery",
    "DoseLimits",
    "Expiring",
    "LimitedPump",
    "Pump",
    "Resolution",
    "battery_gap",
    "bolus_limits",
    "dose_limits",
    "expiring",
    "missed_pulses",
    "occlusion",
    "rate_in_force",
    "unheard",
    "with_resolution",
]
