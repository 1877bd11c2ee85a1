"""The printed numbers, with page and place in the paper."""

from __future__ import annotations

import importlib.resources
import tomllib
from dataclasses import dataclass
from typing import Final

UNSETTLED: Final = "551+"


@dataclass(frozen=True)
class PrintedEntry:
    """One printed number or statement."""

    id: str
    what: str
    printed: float | str
    unit: str
    page: int
    place: str
    kind: str
    """``"value"``, or ``"at-most"`` for a bound."""
    readings: tuple[str, ...]
    """Names in `readings.READINGS` on which the reproduced number depends."""
    input_at: tuple[str, ...] = ()
    """Operating points at which the printed number is put in, so that it cannot but agree."""


def published() -> tuple[PrintedEntry, ...]:
    """All entries, in the order of the paper's tables."""
    text = importlib.resources.files(__package__).joinpath("published.toml").read_text(encoding="utf-8")
    return tuple(
        PrintedEntry(**{**entry, "readings": tuple(entry["readings"]), "input_at": tuple(entry.get("input_at", ()))})
        for entry in tomllib.loads(text)["entry"]
    )
