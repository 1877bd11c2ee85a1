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
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal

_HEADERS: Final = {
    "glucose": ("bg_ts", "value"),
    "bolus": ("bolus_ts", "bolus_dose"),
    "basal": ("basal_ts", "basal_dose", "insulin_kind"),
    "carbs": ("meal_ts", "carbs_g"),
}
_KINDS: Final = {
    "glucose": "readings without a value",
    "bolus": "boluses without a dose",
    "basal": "basal insulin without a dose, or of an unknown kind",
    "carbs": "meals without carbohydrate",
}


class T1dUom(ReaderComponent, name="t1d-uom"):
    """CSV of the data set T1D-UOM; give the files of a person together."""

    in_parts: ClassVar = True

    def recognised(self, content: FileText) -> bool:
        """Whether a file has a header of the data set."""
        return any(content.header(*names, whole=True) for names in _HEADERS.values())

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of one of the files of a person."""
        places = ((of, content.header(*names, whole=True)) for of, names in _HEADERS.items())
        what, place = next(((of, place) for of, place in places if place is not None), ("", None))
        if place is None:
            raise Refusal("it has no header of T1D-UOM, as bg_ts and value; give it as published")
        table = content.table(place)
        time, value = _HEADERS[what][:2]
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
