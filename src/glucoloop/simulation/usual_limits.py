"""Limits of the pump that a loop has unless another one is given."""

from __future__ import annotations

from glucoloop.patients.capabilities import usual_pump
from glucoloop.patients.protocol import Patient
from glucoloop.pumps.limits import DoseLimits


def usual_limits(patient: Patient) -> DoseLimits:
    """Limits of the pump that is usual for a patient, or for the route by which it has insulin."""
    usual = usual_pump(patient)
    return DoseLimits(
        max_change_mU_min=usual.max_change_mU_min, min_mU_min=usual.min_mU_min, max_mU_min=usual.max_mU_min
    )
