"""The time between readings, which a fault that is told in minutes has to know."""

from __future__ import annotations

import math


def checked_sample_time(sample_time_min: float) -> float:
    """A sample time, if it is one."""
    if not 0.0 < sample_time_min < math.inf:
        raise ValueError(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")
    return float(sample_time_min)
