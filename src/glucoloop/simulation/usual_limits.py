"""Limits of the pump that a loop has unless another one is given."""

from __future__ import annotations

from glucoloop.patients.capabilities import usual_pump
from glucoloop.patients.protocol import Patient
from glucoloop.pumps.limits import DoseLimits


def usual_limits(patient: Patient) -> DoseLimits:
    """Limits of the pump that is usual for a patient, or for the route by which it has insulin.

    Designs, `summarise` and `LimitedPump` see no patient and take the limits of 1999; for insulin under the skin those
    keep a controller far within what the pump can give.

    Parameters
    ----------
    patient : Patient

    Returns
    -------
    DoseLimits

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.usual_limits(gl.patient()).max_mU_min
    66.9
    """
    usual = usual_pump(patient)
    return DoseLimits(
        max_change_mU_min=usual.max_change_mU_min, min_mU_min=usual.min_mU_min, max_mU_min=usual.max_mU_min
    )
