"""Insulin pumps: limits of rate and magnitude, delivery resolution, and faults."""

from glucoloop.pumps.faults import battery_gap, missed_pulses, occlusion
from glucoloop.pumps.limited import LimitedPump
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits, dose_limits
from glucoloop.pumps.protocol import Delivery, Pump
from glucoloop.pumps.resolution import Resolution, with_resolution

__all__ = [
    "PARKER_1999_LIMITS",
    "Delivery",
    "DoseLimits",
    "LimitedPump",
    "Pump",
    "Resolution",
    "battery_gap",
    "dose_limits",
    "missed_pulses",
    "occlusion",
    "with_resolution",
]
