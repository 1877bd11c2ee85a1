"""Insulin pumps: limits of rate and magnitude, and delivery resolution."""

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
    "dose_limits",
    "with_resolution",
]
