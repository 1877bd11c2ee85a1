"""CSV of the data set AZT1D: a row for every reading, with boluses, carbohydrate and basal rates in the nearest row.

Glucose in mg/dl every 5 min on a local clock, the whole dose of each bolus (``CorrectionDelivered`` and
``FoodDelivered`` are its parts), carbohydrate in g, and the basal rate until the next row that has one, in U/h; in some
people weeks of rates are in mU/h. Extended boluses stand whole at their beginning. Of some people the sensor's column
is called otherwise, and empty cells are zeros.

References
----------
M. Khamesian et al., "AZT1D: a real-world dataset for type 1 diabetes", 2025, doi:10.17632/gk9m674wcx.1.
"""

from __future__ import annotations

from typing import ClassVar

import polars as pl

from glucoloop.records.answers import MIXED_RATES, Answers
from glucoloop.records.extract import Extract, bolus_types, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of


class AZT1D(TableReaderComponent, name="azt1d"):
    """CSV of the data set AZT1D, of pumps of Tandem and sensors of Dexcom."""

    headers: ClassVar = (("EventDateTime", "BolusType", "Basal", "TotalBolusInsulinDelivered", "CarbSize"),)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of the file of one person."""
        _, table = self.table(content)
        frame = table.frame.select(
            time=table.texts("EventDateTime"),
            glucose=table.texts(table.column("CGM", "Readings (CGM")),
            carbs=table.texts("CarbSize"),
            bolus=table.texts("TotalBolusInsulinDelivered"),
            basal=table.texts("Basal"),
            type=table.texts("BolusType"),
        )
        times, notes = times_of(frame["time"], answers)
        extended = int(frame["type"].str.contains("(?i)extended").fill_null(False).sum())
        if extended:
            notes.append(f"{extended} extended boluses stand whole at their beginning, as in the file.")
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.when(pl.col("glucose").cast(pl.Float64, strict=False) != 0.0).then("glucose"),
                carbs=pl.col("carbs"),
                bolus=pl.col("bolus"),
                bolus_type=bolus_types(pl.col("type"), "automatic"),
                basal=pl.col("basal"),
                device=pl.lit("Dexcom G6"),
                kind=pl.lit("rows without a reading, a meal or insulin"),
            ),
            glucose_unit="mg/dl",
            units={"basal": MIXED_RATES},
            notes=(*table.notes, *notes),
        )
