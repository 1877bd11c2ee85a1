"""Findings of a study: plain values and tables, written whole and read back whole.

Whatever is printed or drawn later follows from the plain values, so that nothing is computed or worded again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import polars as pl

from glucoloop.storage.files import json_text, stored_json, with_version
from glucoloop.storage.tables import csv, parquet


@dataclass(frozen=True)
class Findings:
    """Findings of a study."""

    plain: Mapping[str, Any]
    """Everything as plain values: JSON prints it, and a finished folder gives it back. A number that is not finite is
    None, and a tuple is a list, from the beginning.
    """
    tables: Mapping[str, pl.DataFrame] = field(default_factory=dict)
    """Tables by the name of their file, which ends in ``.csv`` or ``.parquet``; they are not read back."""

    extra: Any = None
    """Further results from which figures and pages are drawn; they are not kept."""

    def __post_init__(self) -> None:
        # as it will be read back
        object.__setattr__(self, "plain", json.loads(json_text(self.plain)))

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows among the plain values, one for each cell of the study."""
        rows: list[dict[str, Any]] = self.plain["rows"]
        return rows

    def text(self) -> str:
        """The plain values as a JSON text."""
        return json_text(with_version(self.plain)) + "\n"

    def files(self, summary: str) -> dict[str, bytes]:
        """The tables, and the plain values as JSON in the file `summary`."""
        tables = {name: csv(table) if name.endswith(".csv") else parquet(table) for name, table in self.tables.items()}
        return {**tables, summary: self.text().encode()}

    @classmethod
    def read(cls, place: Path) -> Findings:
        """Read earlier findings from the JSON file that holds them."""
        plain = stored_json(place, "move it away and run the same command again", dict[str, Any])
        return cls({key: value for key, value in plain.items() if key != "version"})
