"""CSV of data of ReplayBG: t, glucose, cho [g/min], bolus and basal [U/min] of each sample, which is held over it."""

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

_HEADER: Final = ("t", "glucose", "cho", "bolus", "basal")


class ReplayBG(TableReaderComponent, name="replaybg"):
    """CSV of data of ReplayBG."""

    headers: ClassVar = (_HEADER,)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a table of ReplayBG."""
        _, table = self.table(content)
        names = {name.casefold(): name for name in table.frame.columns}
        frame = table.frame.select(**{name: table.texts(names[name]) for name in _HEADER})
        times, notes = times_of(frame["t"], answers)
        minutes = sample_min(times["time"])
        notes.append(f"Carbohydrate and boluses per min were made amounts of samples of {minutes:g} min.")
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("glucose"),
                carbs=amounts("cho", minutes),
                bolus=amounts("bolus", minutes),
                basal=amounts("basal", MIN_PER_H),
                kind=pl.lit("samples without a reading"),
            ),
            glucose_unit="mg/dl",
            largest_basal_U_h=100.0,
            notes=(*table.notes, *notes),
        )
