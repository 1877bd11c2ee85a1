"""Units: the conversion constants of the project, the units in use, and numbers as a person writes them.

Everything is computed in mg/dl, mU/min, min, g and U, and names that cross a boundary end in their unit. Multiply by a
constant to convert, divide to convert back. Functions take numbers and arrays alike, of NumPy and JAX too. The largest
numbers that several layers share stand here too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final, Protocol, Self, TypeVar

from glucoloop.refusal import Refusal


class _Scalable(Protocol):
    def __mul__(self, factor: float, /) -> Self: ...
    def __truediv__(self, divisor: float, /) -> Self: ...


Number = TypeVar("Number", bound=_Scalable)
"""Any number or array."""

MOLAR_MASS_GLUCOSE_G_MOL = 180.156

MG_PER_G = 1000.0
MU_PER_U = 1000.0
PMOL_PER_U = 6000.0  # 1 U of human insulin is defined as 6 nmol
MIN_PER_H = 60.0
S_PER_MIN = 60.0
MIN_PER_DAY = 1440.0
MIN_PER_WEEK = 7.0 * MIN_PER_DAY
HOURS_PER_DAY = 24.0
MG_DL_PER_MMOL_L = MOLAR_MASS_GLUCOSE_G_MOL / 10.0
MU_MIN_PER_U_H = MU_PER_U / MIN_PER_H
MU_MIN_PER_PMOL_MIN = MU_PER_U / PMOL_PER_U
PG_ML_PER_UG_L = 1000.0

UNIT_BY_ENDING: Final = {
    "_mg_dl_h": "mg/dl per h",
    "_mg_dl_min": "mg/dl per min",
    "_mg_dl_U": "mg/dl per U",
    "_mg_min": "mg/min",
    "_g_U": "g per U",
    "_ug_per_mg_dl": "ug per mg/dl",
    "_mg_dl": "mg/dl",
    "_ug": "ug",
    "_mU_min": "mU/min",
    "_min": "min",
    "_pct": "%",
    "_mU": "mU",
    "_U": "U",
    "_g": "g",
}
"""Unit of a value by the end of its name."""
OTHER_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "mg/dl": {"mmol/l": MG_DL_PER_MMOL_L},
    "(mg/dl)²": {"(mmol/l)²": MG_DL_PER_MMOL_L**2},
    "mg/dl per h": {"mmol/l per h": MG_DL_PER_MMOL_L},
    "mg/dl per min": {"mmol/l per min": MG_DL_PER_MMOL_L, "mg/dl per h": 1.0 / MIN_PER_H},
    "mg/dl per U": {"mmol/l per U": MG_DL_PER_MMOL_L},
    "mU/min": {"U/h": MU_MIN_PER_U_H, "mU/h": 1.0 / MIN_PER_H, "pmol/min": MU_MIN_PER_PMOL_MIN},
    "mU/min per mg/dl": {"U/h per mmol/l": MU_MIN_PER_U_H / MG_DL_PER_MMOL_L},
    "min": {"m": 1.0, "h": MIN_PER_H, "s": 1.0 / S_PER_MIN, "d": MIN_PER_DAY},
    "mg/min": {"g/min": MG_PER_G},
    "g": {"mg": 1.0 / MG_PER_G, "kg": 1000.0},
    "U": {"mU": 1.0 / MU_PER_U},
    "mU": {"U": MU_PER_U},
}
"""The other units in use of each unit of the project, and their factors to it."""


def ending_of(name: str) -> str:
    """End of a name that is a unit, as in ``_mg_dl``; empty for a name without one."""
    return next((ending for ending in UNIT_BY_ENDING if f"_{name}".endswith(ending)), "")


def factor_to(unit: str, other: str) -> float | None:
    """Factor to a unit from itself or another of its quantity, in any spelling in use; None if it is no such unit.

    ``mmol/L`` is read as mmol/l, ``g/U`` as g per U, and ``^2`` as ².
    """
    known = {_spelt(unit): 1.0, **{_spelt(name): factor for name, factor in OTHER_UNITS.get(unit, {}).items()}}
    return known.get(_spelt(other))


def _spelt(unit: str) -> str:
    return unit.replace(" per ", "/").replace(" ", "").replace("dL", "dl").replace("/L", "/l").replace("^2", "²")


def mmol_l_from_mg_dl(glucose_mg_dl: Number) -> Number:
    """Glucose concentration in mmol/l."""
    return glucose_mg_dl / MG_DL_PER_MMOL_L


def mg_dl_from_mmol_l(glucose_mmol_l: Number) -> Number:
    """Glucose concentration in mg/dl."""
    return glucose_mmol_l * MG_DL_PER_MMOL_L


def u_h_from_mu_min(insulin_mU_min: Number) -> Number:
    """Insulin rate in U/h, the unit of pump displays."""
    return insulin_mU_min * MIN_PER_H / MU_PER_U


def mu_min_from_u_h(insulin_U_h: Number) -> Number:
    """Insulin rate in mU/min, the unit of the equations."""
    return insulin_U_h * MU_PER_U / MIN_PER_H


UNITS_OF_TIME: Final = {"min": 1.0, "m": 1.0, "h": MIN_PER_H, "d": MIN_PER_DAY}
"""Minutes in each unit in which a time may be written."""
# No two parts in a row can take the same characters: a long text that is no number is refused as fast as it is read.
NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
"""Pattern of a number, to be used with ``re.ASCII``."""


def number_of(text: str) -> float:
    """A number from its text; ValueError for none, also one with underscores or digits of another script."""
    if not text.isascii() or "_" in text:
        raise Refusal(f"{text!r} is no number; write it in digits from 0 to 9, without underscores")
    return float(text)


def parse_time_of_day(text: str) -> float:
    """Minutes after midnight from a text like 07:30."""
    result = re.fullmatch(r"([0-9]{1,2}):([0-5][0-9])", text.strip())
    minutes = math.nan if result is None else int(result[1]) * MIN_PER_H + int(result[2])
    if not minutes < MIN_PER_DAY:
        raise Refusal(f"{text!r} is no time of day; write it like 07:30, from 00:00 to 23:59")
    return minutes


LARGEST_COUNTER: Final = 2**32 - 1
"""Largest seed of people, number of a person, or index."""
LARGEST_SEED: Final = 2**32 - 1
"""Largest seed of a sensor."""
MAX_PEOPLE: Final = 1_000_000_000
MAX_DAYS: Final = 366
LONGEST_RUN_MIN: Final = 366 * 1440.0
LARGEST_MEAL_G: Final = 1000.0
LONGEST_AHEAD_MIN: Final = 180.0
"""Longest time before eating at which a meal may be announced."""
