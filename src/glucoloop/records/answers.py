"""Answers to questions that a file leaves open, such as the order of day and month."""

from __future__ import annotations

import zoneinfo
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.component.setting import choices_text, known_names
from glucoloop.refusal import Refusal

DAY_FIRST: Final = "day-first"
MONTH_FIRST: Final = "month-first"
UNITS: Final = ("mg/dl", "mmol/l")
TARGETS: Final = ("time", "glucose_mg_dl", "glucose_mmol_l", "carbs_g", "bolus_U", "basal_U_h")
"""Columns that the columns of any table can be named as."""


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Answers to what a file leaves open; None and nothing where they were not given."""

    dates: str | None = None
    """Order of day and month."""
    glucose_unit: str | None = None
    time_zone: str | None = None
    """Time zone of the clock on the wall, as ``Europe/Berlin``."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Name in the file of each column of the record."""
    basal_profiles: tuple[Mapping[str, Any], ...] = ()
    """Profiles of Nightscout, with the usual basal rates of a person."""
    scans: bool = False
    """Whether scans are kept beside the readings of a sensor that stores its own."""

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("dates", self.dates, (DAY_FIRST, MONTH_FIRST)),
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
        if self.columns and "time" not in self.columns:
            raise Refusal("columns name no time; add time=NAME with the name of the column of times")
        if {"glucose_mg_dl", "glucose_mmol_l"} <= self.columns.keys():
            raise Refusal("columns name glucose in mg/dl and in mmol/l; leave one out")


def columns_from_text(text: str) -> dict[str, str]:
    """Columns from a text like ``time=Zeit,glucose_mg_dl=BZ``."""
    pairs = [part.partition("=") for part in text.split(",")]
    for target, sign, name in pairs:
        if not (sign and target.strip() and name.strip()):
            raise Refusal(f"columns are {text!r}; give them like time=Zeit,glucose_mg_dl=BZ")
    return {target.strip(): name.strip() for target, _, name in pairs}
