"""A constant with its unit, meaning and source."""

from __future__ import annotations

from typing import NamedTuple


class Constant(NamedTuple):
    """One value of a published parameter set."""

    name: str
    """Field of the parameter record; a dot leads into a nested one."""
    value: float
    unit: str
    meaning: str
    source: str
