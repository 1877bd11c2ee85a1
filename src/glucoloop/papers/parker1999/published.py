"""The records of ``published.toml``: printed numbers, choices where the paper is open, and reasons for differences."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from glucoloop.patients import OPERATING_POINTS


@dataclass(frozen=True, kw_only=True)
class PrintedEntry:
    """One printed number or statement, and what of the reproduction is compared with it."""

    id: str
    what: str
    printed: float | str
    """Number or word; the bound, where the entry is one."""
    unit: str = ""
    kind: Literal["value", "at-most"] = "value"
    page: int
    place: str
    controller: str = ""
    situation: str = ""
    """``"noise-free"``, or a dead time with noise: ``"10M"`` is one of 10 min that the controller knows."""
    metric: str
    less_than: str = ""
    """Controller of the same situation whose number this one is below, in percent."""
    more_than: str = ""
    interpretations: tuple[str, ...]
    """Names in `INTERPRETATIONS` on which the reproduced number depends."""
    input_at: tuple[str, ...] = ()
    """Operating points at which the printed number is put in, so that it cannot but agree."""


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Entries that do not reproduce for one reason, found by an experiment or by a calculation."""

    entries: tuple[str, ...]
    """Beginnings of the names of the entries."""
    reason: str
    points: tuple[str, ...] = tuple(OPERATING_POINTS)
    """Operating points at which it is the reason."""


def _records(name: str) -> list[dict[str, Any]]:
    return [{key: tuple(v) if isinstance(v, list) else v for key, v in row.items()} for row in _FILE[name]]


_FILE: Final = tomllib.loads(Path(__file__).with_name("published.toml").read_text(encoding="utf-8"))
ENTRIES: Final = tuple(PrintedEntry(**record) for record in _records("entry"))
"""All entries, in the order of the paper's tables."""
DEVIATIONS: Final = tuple(Deviation(**record) for record in _records("deviation"))
INTERPRETATIONS: Final[Mapping[str, str]] = _FILE["interpretations"]
"""Choices where the paper is open or illegible, by name: settings, never hidden constants."""


def reason_for(entry: str, operating_point: str) -> str:
    """The reason why an entry does not reproduce at an operating point; empty where none is known."""
    known = (one.reason for one in DEVIATIONS if entry.startswith(one.entries) and operating_point in one.points)
    return next(known, "")
