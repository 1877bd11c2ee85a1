"""CSV of the data set HUPA-UCM, with a row every 5 min with glucose, insulin and carbohydrate, divided by semicolons.

Glucose in mg/dl, ``basal_rate`` the basal insulin of the 5 min in U, ``bolus_volume_delivered`` in U, ``carb_input``
in portions of 10 g. Glucose is interpolated to the 5 min by those who published it.

References
----------
J. I. Hidalgo et al., "HUPA-UCM diabetes dataset", Data in Brief 55, 110559, 2024, doi:10.17632/3hbcscwz44.1.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of

_HEADER: Final = ("time", "glucose", "basal_rate", "bolus_volume_delivered", "carb_input")


class HupaUcm(TableReaderComponent, name="hupa-ucm"):
    """CSV of the data set HUPA-UCM."""

    headers: ClassVar = (_HEADER,)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of the file of one person."""
        _, table = self.table(content)
        frame = table.frame.select(**{name: table.texts(name) for name in _HEADER})
        times, notes = times_of(frame["time"], answers)
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("glucose"),
                carbs=pl.col("carb_input"),
                bolus=pl.col("bolus_volume_delivered"),
                basal=pl.col("basal_rate"),
                kind=pl.lit("rows without a reading, a meal or insulin"),
            ),
            glucose_unit="mg/dl",
            units={"basal": "U/5min", "carbs": "10g"},
            notes=(*table.notes, *notes, "Carbohydrate is in portions of 10 g there, and basal insulin in U of 5 min."),
        )
