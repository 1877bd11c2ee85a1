"""Exports of Juggluco, divided by tabs: readings of the stream, of scans or of a sensor's history, and amounts.

Every row has the second since 1970 and, in hours, the offset from UTC of the clock of the phone. The column of readings
is named by its unit. An amount has the label that the owner of the phone chose; those that the app begins with are
known in some languages.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.devices import is_long_acting
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import from_utc
from glucoloop.units import MIN_PER_H

_READINGS: Final = ("Sensorid", "nr", "UnixTime", "TZ", "Min")
_AMOUNTS: Final = ("Source", "nr", "UnixTime", "TZ", "Value", "Label")
_CARBS: Final = ("carbo", "carbohid", "kohlenh", "koolh", "glucid", "węglow", "kolhyd", "碳水")
_FAST: Final = ("fast", "rapid", "rápid", "schnell", "snel", "szybk", "快速")
_SLOW: Final = ("long", "lang", "basal", "basins", "larg", "lent", "dług", "长效")
"""Parts of the labels that the app begins with, in the languages of the Latin alphabet and in Chinese."""
_LARGEST_OFFSET_H: Final = 14.0


class Juggluco(TableReaderComponent, name="juggluco"):
    """Readings and amounts that Juggluco exports."""

    in_parts: ClassVar = True
    headers: ClassVar = (_READINGS, _AMOUNTS)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of readings or of amounts."""
        header, table = self.table(content)
        labels = table.frame.select(table.texts("Label")).to_series()
        seconds = table.texts("UnixTime").cast(pl.Float64, strict=False)
        hours = table.texts("TZ").cast(pl.Float64, strict=False)
        times = table.frame.select(
            at=pl.when(seconds.is_between(0.0, 1e11)).then(seconds * 1e6).cast(pl.Int64).cast(pl.Datetime("us")),
            offset=pl.when(hours.abs() <= _LARGEST_OFFSET_H).then((hours * MIN_PER_H).round()),
        )
        if header == _AMOUNTS:
            columns, unit = _amounts(labels, table.texts("Value")), None
            kind = "amounts whose label is none of carbohydrate or insulin"
        else:
            name = table.column(*UNITS)
            unit = next((unit for unit in UNITS if name is not None and name.casefold() == unit), None)
            history = table.column("Rate") is None
            columns = {
                "glucose": table.texts(name),
                "source": pl.concat_str(
                    table.texts("Sensorid"), pl.lit("history" if history else "stream"), separator="|"
                ),
            }
            kind = "rows without a reading"
        return Extract(
            frame=extract_frame(
                table.frame, from_utc(times["at"], times["offset"]), table.spoilt, **columns, kind=pl.lit(kind)
            ),
            glucose_unit=unit,
            notes=table.notes,
        )


def _amounts(labels: pl.Series, value: pl.Expr) -> dict[str, pl.Expr]:
    """Columns of amounts by the words of their labels."""
    words = {label: label.strip().casefold() for label in labels.drop_nulls().unique()}
    slow = [label for label, text in words.items() if is_long_acting(text) or any(word in text for word in _SLOW)]
    fast = [label for label, text in words.items() if label not in slow and any(word in text for word in _FAST)]
    carbs = [label for label, text in words.items() if text.startswith(_CARBS)]
    return {
        name: pl.when(pl.lit(labels).is_in(known)).then(value)
        for name, known in (("carbs", carbs), ("bolus", fast), ("long_acting", slow))
    }
