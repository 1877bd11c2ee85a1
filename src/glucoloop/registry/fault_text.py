"""Text of a fault: ``missing, start_min=120, duration_min=30``."""

from __future__ import annotations

from glucoloop.refusal import Refusal
from glucoloop.registry.entries import parsed, part_text
from glucoloop.registry.faults import Fault, fault


def parse_fault(text: str) -> Fault:
    """Read a fault from its text.

    Raises
    ------
    ValueError
        For a text that is not a fault, an unknown fault, or settings that the fault does not have.
    """
    name, given = parsed(text, "fault", "missing, start_min=120, duration_min=30")
    try:
        return fault(name, given)
    except Refusal as error:
        raise Refusal(f"{error} (in {text!r})") from None


def fault_text(told: Fault) -> str:
    """Text from which the same fault is read."""
    return part_text(told.name, told.settings)
