"""CSV of the data set T1D-UOM: glucose, boluses, basal insulin and meals of a person in files of their own.

Days come first in dates; glucose in mmol/l; a basal dose is a rate of a pump in U/h where ``insulin_kind`` is R, and
units of a long-acting insulin where it is L. Give the files of a person together.

References
----------
"T1D-UOM: a longitudinal multimodal dataset of type 1 diabetes", University of Manchester, 2025,
doi:10.5281/zenodo.15169263.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import DAY_FIRST, Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of

_COLUMNS: Final = {
    ("bg_ts", "value"): "glucose",
    ("bolus_ts", "bolus_dose"): "bolus",
    ("basal_ts", "basal_dose", "insulin_kind"): "basal",
    ("meal_ts", "carbs_g"): "carbs",
}
"""Our name of the values of each file, by its header."""
_KINDS: Final = {
    "glucose": "readings without a value",
    "bolus": "boluses without a dose",
    "basal": "basal insulin without a dose, or of an unknown kind",
    "carbs": "meals without carbohydrate",
}


class T1dUom(TableReaderComponent, name="t1d-uom"):
    """CSV of the data set T1D-UOM; give the files of a person together."""

    in_parts: ClassVar = True
    headers: ClassVar = tuple(_COLUMNS)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of one of the files of a person."""
        header, table = self.table(content)
        what, (time, value) = _COLUMNS[header], header[:2]
        frame = table.frame.select(
            time=table.texts(time), value=table.texts(value), kind=table.texts(table.column("insulin_kind"))
        )
        times, notes = times_of(frame["time"], answers, usual=DAY_FIRST)
        columns = {what: pl.col("value")}
        if what == "basal":
            columns = {
                "basal": pl.when(pl.col("kind") == "R").then("value"),
                "long_acting": pl.when(pl.col("kind") == "L").then("value"),
            }
        return Extract(
            frame=extract_frame(frame, times, table.spoilt, **columns, kind=pl.lit(_KINDS[what])),
            glucose_unit="mmol/l",
            notes=(*table.notes, *notes),
        )
