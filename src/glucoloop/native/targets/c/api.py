"""Common parts of exported controllers beside their two functions: the header, and saved states."""

from __future__ import annotations

from typing import Final

from glucoloop.native.targets.c.helpers import template

MEANINGS: Final = {
    "observation": {
        "glucose_mg_dl": "reading of the sensor [mg/dl]; any bits where it is not valid",
        "valid": "0: the sensor has no valid reading, otherwise: it has",
        "setpoint_mg_dl": "glucose that is to be reached [mg/dl]",
        "delivered_mU_min": "rate that the pump delivered since the last step [mU/min]",
        "announced_carbs_g": "carbohydrate of a meal that begins before the next step [g]; 0: none, or none is told",
        "announced_in_min": "time from now until that meal is eaten [min]; 0: before the next step",
        "delivered_bolus_mU": "bolus that the pump delivered since the last step, apart from that rate [mU]; 0: none",
        "time_of_day_min": "minutes after midnight, from 0 to below 1440 [min]",
    },
    "decision": {
        "insulin_mU_min": "rate until the next step [mU/min]",
        "bolus_mU": "insulin to be given at once, beside that rate [mU]; 0: none",
        "status": "why: one of the numbers of a status, 0 where all is well",
    },
}
"""Meanings of the fields of an observation and of a decision."""
_AROUND: Final = 20
"""Number of bytes of a record around the state: mark, digest and CRC."""


def record_bytes(state_bytes: int) -> int:
    """Number of bytes of a saved state."""
    return state_bytes + _AROUND


def header(structures: str, state_bytes: int) -> str:
    """The header around the structures."""
    return template("header.h").replace("@STRUCTURES@", structures).replace("@SIZE@", str(record_bytes(state_bytes)))


def saving(state_bytes: int, design: str) -> str:
    """``gl_save`` and ``gl_restore``, for a design with a digest."""
    mark = ["47", "4C", "53", "54", *(design[i : i + 2].upper() for i in range(0, 24, 2))]
    text = "\n" + template("saving.c").replace("@MARK@", ", ".join(f"0x{byte}U" for byte in mark))
    return text.replace("@SIZE@", str(state_bytes))
