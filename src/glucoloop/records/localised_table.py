"""Exports in the language of their owner: columns by known words, or by their place where the words are unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import polars as pl

from glucoloop.records.file_text import CellTable, FileText
from glucoloop.refusal import Refusal

UNITS: Final = ("mmol/l", "mg/dl")
"""Units of glucose as headers write them, in every language."""


@dataclass(frozen=True)
class LocalisedRows:
    """Rows of such an export."""

    table: CellTable
    frame: pl.DataFrame
    """Texts of the columns, by our names."""
    glucose_unit: str | None
    is_known: bool
    """Whether its words are among the known ones."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class LocalisedTable:
    """Form of a table that an app exports in many languages, with the same columns in the same order."""

    headers: tuple[tuple[str, ...], ...]
    """Beginnings of names in the header of each known language."""
    names: Mapping[str, tuple[str, ...]]
    """Beginnings of the name of each column in the known languages, by our name."""
    places: Mapping[str, int]
    """Place of each column, by our name, for the other languages."""
    place_by_form: Callable[[FileText], tuple[int, str] | None]
    """Line and delimiter of a header whose words are unknown, by the form of its fields and of the rows below it."""
    glucose: str
    """Our name of a column whose header has the unit of glucose."""
    export: str
    """Columns that a file without such a header lacks, for the refusal."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has such a header."""
        return self._place_by_words(content) is not None or self.place_by_form(content) is not None

    def rows(self, content: FileText) -> LocalisedRows:
        """Rows of a file; Refusal if it has no such header."""
        by_words = self._place_by_words(content)
        place = by_words or self.place_by_form(content)
        if place is None:
            raise Refusal(f"it has no header of {self.export} and so on; export it again")
        table = content.table(place)
        columns = table.frame.columns
        names = {name: table.column(*starts) for name, starts in self.names.items()}
        notes: tuple[str, ...] = ()
        by_place = {name: columns[at] if at < len(columns) else None for name, at in self.places.items()}
        if by_words is None:
            names = by_place
            notes = ("Its language is not known here: its columns were taken by their place, as in all languages.",)
        elif all(name is None or name == by_place[target] for target, name in names.items()):
            names = {target: name or by_place[target] for target, name in names.items()}
        header = (names[self.glucose] or "").casefold()
        return LocalisedRows(
            table=table,
            frame=table.frame.select(**{name: table.texts(column) for name, column in names.items()}),
            glucose_unit=next((unit for unit in UNITS if unit in header), None),
            is_known=by_words is not None,
            notes=(*table.notes, *notes),
        )

    def _place_by_words(self, content: FileText) -> tuple[int, str] | None:
        return next((place for names in self.headers if (place := content.header(*names))), None)
