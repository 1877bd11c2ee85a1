"""CSV files of Glooko, which exports a ZIP with one for each kind of data: sensor, boluses, basal rates, and so on.

The first line names the person, the second the columns. Of boluses ``Insulin Delivered`` is the whole dose, of which
``Extended Delivery`` comes over a time that the file does not tell. A basal row has a rate or the percentage of a
temporary one, and its duration; a suspension has neither a rate nor insulin. Daily totals and alarms are named.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of

_SENSOR: Final = ("Timestamp", "CGM Glucose Value (")
_BOLUS: Final = ("Timestamp", "Insulin Type", "Insulin Delivered (U)", "Carbs Input (")
_BASAL: Final = ("Timestamp", "Insulin Type", "Duration (minutes)", "Rate")
_NAMED: Final = {
    ("Timestamp", "Total Bolus (U)", "Total Basal (U)"): "daily totals",
    ("Timestamp", "Glucose Value (", "Manual Reading"): "finger pricks",
    ("Timestamp", "Alarm/Event"): "alarms",
}


class Glooko(TableReaderComponent, name="glooko"):
    """CSV files that Glooko exports in a ZIP, or that ZIP."""

    in_parts: ClassVar = True
    in_exports: ClassVar = True
    headers: ClassVar = (_SENSOR, _BOLUS, _BASAL, *_NAMED)
    whole: ClassVar = False

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of one of the files of an export."""
        header, table = self.table(content)
        glucose = table.column("CGM Glucose Value (")
        frame = table.frame.select(
            time=table.texts(table.column("Timestamp")),
            glucose=table.texts(glucose),
            carbs=table.texts(table.column("Carbs Input (")),
            bolus=table.texts(table.column("Insulin Delivered (U)")),
            rate=table.texts(table.column("Rate")),
            percentage=table.texts(table.column("Percentage (")),
            type=table.texts(table.column("Insulin Type")),
            serial=table.texts(table.column("Serial Number")),
        )
        times, notes = times_of(frame["time"], answers)
        columns: dict[str, pl.Expr] = {}
        if header == _SENSOR:
            columns = {"glucose": pl.col("glucose"), "source": pl.col("serial")}
        elif header == _BOLUS:
            columns = {"bolus": pl.col("bolus"), "carbs": pl.col("carbs")}
        elif header == _BASAL:
            suspended = pl.col("type").str.contains("(?i)suspend")
            unknown = pl.col("rate").is_null() & pl.col("percentage").is_not_null()
            rate = pl.when(suspended).then(pl.lit("0")).when(unknown).then(pl.lit("?")).otherwise("rate")
            columns = {"basal": rate}
        return Extract(
            frame=extract_frame(
                frame, times, table.spoilt, **columns, kind=pl.lit(_NAMED.get(header, "rows without a value"))
            ),
            glucose_unit=next((unit for unit in UNITS if unit in (glucose or "").casefold()), None),
            notes=(*table.notes, *notes),
        )
