"""Faults of a pump: small objects that wrap any pump, and one another."""

from glucoloop.pumps.faults.battery_gap import BatteryGap, battery_gap
from glucoloop.pumps.faults.occlusion import Occlusion, missed_pulses, occlusion
from glucoloop.pumps.faults.unheard import Unheard, unheard

__all__ = ["BatteryGap", "Occlusion", "Unheard", "battery_gap", "missed_pulses", "occlusion", "unheard"]
