"""Text of a fault: ``missing, start_min=120, duration_min=30``."""

from __future__ import annotations

import math

from glucoloop.registry.faults import Fault, fault
from glucoloop.registry.keyed_values import keyed_values


def parse_fault(text: str) -> Fault:
    """Read a fault from its text.

    Raises
    ------
    ValueError
        For a text that is not a fault, an unknown fault, or settings that the fault does not have.
    """
    name, _, rest = text.partition(",")
    if not name.strip() or "=" in name:
        raise ValueError(f"{text!r} is not a fault; write one like 'missing, start_min=120, duration_min=30'")
    parts = [part.strip() for part in rest.split(",")] if rest.strip() else []
    try:
        return fault(name.strip(), keyed_values(parts, f"fault {text!r}", "start_min=120"))
    except ValueError as error:
        told = str(error)
        raise ValueError(told if text in told else f"{told} (in {text!r})") from None


def fault_text(told: Fault) -> str:
    """Text from which the same fault is read."""
    return ", ".join([told.name, *(f"{key}={_value_text(value)}" for key, value in told.settings.items())])


def _value_text(value: float | int | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isfinite(value):
        return repr(value).removesuffix(".0")
    return str(value)
