"""CSV of xDrip in the form of SiDiary: day and time, glucose of the sensor and of meters, carbohydrate and boluses.

Glucose is in whole mg/dl, carbohydrate in g, boluses in U; days come first in dates, on the clock of the phone.
"""

from __future__ import annotations

from typing import ClassVar

import polars as pl

from glucoloop.records.answers import DAY_FIRST, Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of


class XDrip(TableReaderComponent, name="xdrip"):
    """CSV that xDrip exports, in the form of SiDiary."""

    headers: ClassVar = (("DAY", "TIME", "UDT_CGMS"),)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of xDrip."""
        _, table = self.table(content)
        names = ("DAY", "TIME", "UDT_CGMS", "BG_LEVEL", "CH_GR", "BOLUS", "BASAL")
        frame = table.frame.select(**{name: table.texts(table.column(name)) for name in names})
        times, notes = times_of(
            frame.select(pl.concat_str("DAY", "TIME", separator=" ")).to_series(), answers, usual=DAY_FIRST
        )
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("UDT_CGMS"),
                carbs=pl.col("CH_GR"),
                bolus=pl.col("BOLUS"),
                long_acting=pl.col("BASAL"),
                kind=pl.when(pl.col("BG_LEVEL").is_not_null())
                .then(pl.lit("finger pricks"))
                .otherwise(pl.lit("rows without a reading, a meal or insulin")),
            ),
            glucose_unit="mg/dl",
            notes=(*table.notes, *notes),
        )
