"""CSV of results of simglucose: Time, BG, CGM, CHO [g/min] and insulin [U/min], averages over each sample."""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.simulated import amounts, sample_min
from glucoloop.records.times import times_of
from glucoloop.units import MIN_PER_H

_HEADER: Final = ("Time", "BG", "CGM", "CHO", "insulin")


class Simglucose(TableReaderComponent, name="simglucose"):
    """CSV of results of the simulator simglucose."""

    headers: ClassVar = (_HEADER,)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a table of simglucose."""
        _, table = self.table(content)
        frame = table.frame.select(**{name: table.texts(table.column(name)) for name in _HEADER})
        times, notes = times_of(frame["Time"], answers)
        minutes = sample_min(times["time"])
        notes += [
            f"Carbohydrate per min was made amounts of samples of {minutes:g} min.",
            "Basal rate and boluses are one rate in the file, which stands as the basal rate of each sample.",
        ]
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("CGM"),
                carbs=amounts("CHO", minutes),
                basal=amounts("insulin", MIN_PER_H),
                device=pl.lit("simulated"),
                kind=pl.lit("samples without a reading"),
            ),
            glucose_unit="mg/dl",
            largest_basal_U_h=100.0,
            notes=(*table.notes, *notes),
        )
