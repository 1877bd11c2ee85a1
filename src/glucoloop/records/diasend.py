"""Workbooks of Diasend: tables of the sensor, of meters, and of insulin and carbohydrate.

``CGM`` and ``Name and glucose`` have times and glucose in the unit that heads the column, the latter of meters.
``Insulin use and carbs`` has the basal rate from a time on, the whole volume of a bolus, of which the immediate part
comes at once and the extended one over its duration, and carbohydrate. Settings, alarms and events have tables of their
own.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.extract import Extract, extended_boluses, extract_frame, notes_on_spread, with_doses
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of
from glucoloop.records.user_files import sheet_name

_INSULIN: Final = ("Time", "Basal Amount (U/h)", "Bolus Type", "Bolus Volume (U)")
_GLUCOSE: Final = tuple(("Time", unit) for unit in UNITS)
_METER: Final = "Name and glucose"
_COLUMNS: Final = {
    "time": "Time",
    "basal": "Basal Amount (U/h)",
    "bolus": "Bolus Volume (U)",
    "immediate": "Immediate Volume (U)",
    "extended": "Extended Volume (U)",
    "minutes": "Duration (min)",
    "carbs": "Carbs",
}


class Diasend(TableReaderComponent, name="diasend"):
    """Workbooks that Diasend exports."""

    in_parts: ClassVar = True
    headers: ClassVar = (_INSULIN, *_GLUCOSE)

    def recognised(self, content: FileText) -> bool:
        """Whether a text is a table of such a workbook; glucose beside times alone could be of any other program."""
        return bool(content.header(*_INSULIN)) or (bool(sheet_name(content.head[0])) and super().recognised(content))

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of one of the tables of an export."""
        header, table = self.table(content)
        if header != _INSULIN:
            values = {"time": table.texts("Time"), "glucose": table.texts(table.column(header[1]))}
            frame = table.frame.select(**values)
            times, notes = times_of(frame["time"], answers)
            of_meter = sheet_name(content.head[0]) == _METER
            columns = {} if of_meter else {"glucose": pl.col("glucose")}
            kind = pl.lit("finger pricks" if of_meter else "rows without a reading")
            return Extract(
                frame=extract_frame(frame, times, table.spoilt, **columns, kind=kind),
                glucose_unit=header[1],
                notes=(*table.notes, *notes),
            )
        frame = table.frame.select(**{name: table.texts(table.column(start)) for name, start in _COLUMNS.items()})
        times, notes = times_of(frame["time"], answers)
        extended = extended_boluses(frame)
        rows = pl.Series([row for row, _, _ in extended], dtype=pl.Int64)
        spread = pl.int_range(pl.len(), dtype=pl.Int64).is_in(rows.implode())
        notes += notes_on_spread(len(extended))
        result = extract_frame(
            frame.with_columns(bolus=pl.when(spread).then("immediate").otherwise("bolus")),
            times,
            table.spoilt,
            carbs=pl.col("carbs"),
            bolus=pl.col("bolus"),
            basal=pl.col("basal"),
            kind=pl.lit("rows without insulin or carbohydrate"),
        )
        return Extract(frame=with_doses(result, extended), glucose_unit=None, notes=(*table.notes, *notes))
