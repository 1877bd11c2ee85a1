"""Answers to questions that a file leaves open, such as the order of day and month."""

from __future__ import annotations

import re
import zoneinfo
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.component.setting import choices_text, known_names
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

DAY_FIRST: Final = "day-first"
MONTH_FIRST: Final = "month-first"
YEAR_FIRST: Final = "year-first"
UNITS: Final = ("mg/dl", "mmol/l")
TARGETS: Final = (
    "time",
    "date",
    "glucose_mg_dl",
    "glucose_mmol_l",
    "carbs_g",
    "bolus_U",
    "bolus_min",
    "bolus_type",
    "long_acting_U",
    "basal_U_h",
    "glucagon_ug",
)
"""Columns that the columns of any table can be named as; ``date`` is that of times that are a clock alone."""
AMOUNTS: Final = ("carbs", "bolus", "long_acting", "basal", "glucagon")
"""Amounts whose unit can be said."""


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Answers to what a file leaves open; None and nothing where they were not given."""

    dates: str | None = None
    """Order of day and month, or that a year of two digits comes first."""
    glucose_unit: str | None = None
    time_zone: str | None = None
    """Time zone of the clock on the wall, as ``Europe/Berlin``."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Name in the file of each column of the record; several files may have one each, with a bar between them."""
    file_units: Mapping[str, str] = field(default_factory=dict)
    """Unit of each of `AMOUNTS` in the file, as ``mU/h``, ``U/5min``, ``10g`` or ``mg``."""
    device: str | None = None
    """Device whose readings are used, where several read at the same time."""
    person_column: str | None = None
    """Column that says whose each row of a table of several people is."""
    basal_profiles: tuple[Mapping[str, Any], ...] = ()
    """Profiles of Nightscout, with the usual basal rates of a person."""
    scans: bool = False
    """Whether scans are kept beside the readings of a sensor that stores its own."""

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("dates", self.dates, (DAY_FIRST, MONTH_FIRST, YEAR_FIRST)),
            ("glucose_unit", self.glucose_unit, UNITS),
        ):
            if value is not None and value not in choices:
                raise Refusal(f"{name} is {value!r}; give {choices_text(choices)}")
        if self.time_zone is not None:
            try:
                zoneinfo.ZoneInfo(self.time_zone)
            except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
                raise Refusal(f"time_zone is {self.time_zone!r}; give the name of one, like Europe/Berlin") from None
        unknown = next((name for name in self.columns if name not in TARGETS), None)
        if unknown is not None:
            raise Refusal(f"a record has no column {unknown!r}; {known_names(unknown, TARGETS)}")
        unknown = next((name for name in self.file_units if name not in AMOUNTS), None)
        if unknown is not None:
            raise Refusal(f"there is no unit of {unknown!r} to say; {known_names(unknown, AMOUNTS)}")
        for name, text in self.file_units.items():
            unit_factor(name, text)
        if self.columns and "time" not in self.columns:
            raise Refusal("columns name no time; add time=NAME with the name of the column of times")
        if {"glucose_mg_dl", "glucose_mmol_l"} <= self.columns.keys():
            raise Refusal("columns name glucose in mg/dl and in mmol/l; leave one out")


_NEXT_PAIR: Final = re.compile(r",(?=[^,=]*=)")


def pairs_from_text(text: str, what: str, example: str) -> dict[str, str]:
    """Names and their texts from one like ``time=Zeit,glucose_mg_dl=BZ``; a text may have commas in it."""
    pairs = [part.partition("=") for part in _NEXT_PAIR.split(text)]
    for target, sign, name in pairs:
        if not (sign and target.strip() and name.strip()):
            raise Refusal(f"{what} are {text!r}; give them like {example}")
    return {target.strip(): name.strip() for target, _, name in pairs}


MIXED_RATES: Final = "U/h|mU/h"
"""Unit of rates that are in U/h for a while and in mU/h for another."""
_AMOUNT: Final = re.compile(
    r"(?P<size>\d+(?:\.\d+)?)? *(?P<unit>[^\W\d_]+)(?: *(?:/|per) *(?P<every>\d+)? *(?P<time>[a-z]+))?"
)
_INSULIN: Final = {"u": 1.0, "iu": 1.0, "ie": 1.0, "ui": 1.0, "mu": 1e-3}
_GLUCAGON: Final = {"ng": 1e-3, "ug": 1.0, "\N{GREEK SMALL LETTER MU}g": 1.0, "mcg": 1.0, "mg": 1000.0}
_TIMES: Final = {"h": MIN_PER_H, "hour": MIN_PER_H, "min": 1.0, "d": MIN_PER_DAY, "day": MIN_PER_DAY}


def unit_factor(name: str, text: str) -> float:
    """Factor of a unit to that of the record, as 0.06 of ``mU/min`` or 10 of ``10g``; Refusal for what is no unit."""
    examples = {"carbs": "g or 10g", "basal": f"U/h, mU/h, U/5min or {MIXED_RATES}", "glucagon": "ug or mg"}.get(
        name, "U or mU"
    )
    refusal = Refusal(f"the unit of {name} is {text!r}; give one like {examples}")
    if name == "basal" and text.replace(" ", "") == MIXED_RATES:
        return 1.0
    result = _AMOUNT.fullmatch(text.strip())
    if result is None:
        raise refusal
    size, unit = float(result["size"] or 1.0), result["unit"].casefold()
    if not 0.0 < size <= 1e6:
        raise refusal
    if name == "carbs":
        if unit != "g" or result["time"]:
            raise refusal
        return size
    factors = _GLUCAGON if name == "glucagon" else _INSULIN
    if unit not in factors or (result["time"] is not None) != (name == "basal"):
        raise refusal
    if name != "basal":
        return size * factors[unit]
    every = float(result["every"] or 1)
    if result["time"] not in _TIMES or not every:
        raise refusal
    return size * _INSULIN[unit] * MIN_PER_H / (every * _TIMES[result["time"]])
