"""Results of a study: plain values and tables, written whole and read back whole.

Whatever is printed or drawn later follows from the plain values, so that nothing is computed or worded again.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.storage.files import json_text, stored_json, with_version
from glucoloop.storage.tables import csv, parquet

_MEND: Final = "move it away and run the same command again"


@dataclass(frozen=True)
class Results:
    """Results of a study."""

    values: Mapping[str, Any]
    """Everything as the study computes it, of which `plain` is made."""
    tables: Mapping[str, pl.DataFrame] = field(default_factory=dict)
    """Tables by the name of their file, which ends in ``.csv`` or ``.parquet``; they are not read back."""

    extra: Any = None
    """Further results from which figures and pages are drawn; they are not kept."""

    @functools.cached_property
    def plain(self) -> dict[str, Any]:
        """Everything as plain values: JSON prints it, and a finished folder gives it back.

        A number that is not finite is None, and a tuple is a list, as they will be read back.
        """
        return dict(json.loads(json_text(self.values)))

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

    place: Path | None = None
    """File from which they were read back; None for what was computed just now."""

    @classmethod
    def read(cls, place: Path) -> Results:
        """Read earlier results from the JSON file that holds them."""
        plain = stored_json(place, _MEND, dict[str, Any])
        return cls({key: value for key, value in plain.items() if key != "version"}, place=place)

    @contextlib.contextmanager
    def refusing_damage(self) -> Iterator[None]:
        """Refuse results that were read back and are not those of the study that shows them in the block.

        Their form is what the columns and sentences of the study ask for, and is written nowhere else.
        """
        try:
            yield
        except (
            LookupError,
            TypeError,
            ValueError,
            AttributeError,
            ArithmeticError,
            pl.exceptions.PolarsError,
        ) as error:
            if self.place is None or isinstance(error, Refusal):
                raise
            raise Refusal(f"{self.place} does not hold what this study finds; {_MEND}") from error
