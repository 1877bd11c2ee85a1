"""Check of the time between readings, for faults whose settings are in minutes."""

from __future__ import annotations

import math

from glucoloop.refusal import Refusal


def checked_sample_time(sample_time_min: float) -> float:
    """A sample time, refused unless it is positive and finite."""
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")
    return float(sample_time_min)
