"""Workbooks of the data sets ShanghaiT1DM and ShanghaiT2DM, one of each stay of a person, with a row every 15 min.

Glucose of the sensor in mg/dl, finger pricks beside it. ``Insulin dose - s.c.`` is a text, an insulin and its units,
and several of these divided by semicolons: as ``Novolin R, 2 IU``. The bolus of a pump is a number, its basal rate one
in U/h that holds until the next row with one (cells are merged); ``temporarily suspend insulin delivery`` stands in the
place of either. Infusions tell their bag, as ``500ml 0.9% sodium chloride, 12 IU Novolin R``, and not their duration.
Meals are foods by their weight, without carbohydrate.

References
----------
Q. Zhao et al., "Chinese diabetes datasets for data-driven machine learning", Scientific Data 10, 35, 2023,
doi:10.1038/s41597-023-01940-7.
"""

from __future__ import annotations

import re
from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.devices import rapid_share
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of
from glucoloop.text import how_many

_COLUMNS: Final = {
    "time": ("Date",),
    "glucose": ("CGM",),
    "finger": ("CBG",),
    "meal": ("Dietary intake", "饮食", "进食量"),
    "injected": ("Insulin dose - s.c.",),
    "bolus": ("CSII - bolus",),
    "basal": ("CSII - basal", "胰岛素泵基础量"),
    "infused": ("Insulin dose - i.v.",),
}
_DOSE: Final = re.compile(r"(?i)([^;,]*),?\s*(?<![\w.])(\d+(?:\.\d+)?)\s*I?U\b")
_SUSPENDED: Final = "(?i)suspend"


class ShanghaiT1DM(TableReaderComponent, name="shanghai-t1dm"):
    """Workbooks of the data sets ShanghaiT1DM and ShanghaiT2DM."""

    headers: ClassVar = (("Date", "CGM", "CBG", "Insulin dose - s.c."),)
    whole: ClassVar = False

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a stay of a person."""
        _, table = self.table(content)
        frame = table.frame.select(
            **{name: table.texts(table.column(*starts)) for name, starts in _COLUMNS.items()}
        ).with_columns(_doses("injected"))
        times, notes = times_of(frame["time"], answers)
        suspended = pl.any_horizontal(pl.col("bolus", "basal").str.contains(_SUSPENDED)).fill_null(False)
        frame = frame.with_columns(
            basal=pl.when(suspended).then(pl.lit("0")).otherwise("basal"),
            pump=pl.when(~pl.col("bolus").str.contains(_SUSPENDED)).then("bolus"),
        )
        units = pl.col("pump").cast(pl.Float64, strict=False)
        both = pl.when(units.is_not_null() & pl.col("rapid").is_not_null()).then(
            (units + pl.col("rapid")).cast(pl.String)
        )
        meals, infusions = (frame[name].len() - frame[name].null_count() for name in ("meal", "infused"))
        unread = frame.filter(pl.col("injected").is_not_null(), pl.col("rapid").is_null(), pl.col("slow").is_null())
        notes += [
            note
            for count, note in (
                (meals, f"{how_many(meals, 'meal')} told as foods, without grams of carbohydrate: not in the record."),
                (infusions, f"{how_many(infusions, 'infusion')} of insulin into a vein: not in the record."),
                (unread.height, f"{how_many(unread.height, 'injection')} without a dose in units: not in the record."),
            )
            if count
        ]
        if frame["mixed"].any():
            count = int(frame["mixed"].sum())
            notes.append(
                f"{how_many(count, 'dose')} of premixed insulin: the share of rapid-acting or regular insulin in its "
                "name is a bolus, the rest long-acting insulin."
            )
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.col("glucose"),
                bolus=pl.coalesce(both, pl.col("rapid").cast(pl.String), "pump"),
                long_acting=pl.col("slow"),
                basal=pl.col("basal"),
                kind=pl.when(pl.col("finger").is_not_null())
                .then(pl.lit("finger pricks"))
                .when(pl.col("meal").is_not_null())
                .then(pl.lit("meals without grams of carbohydrate"))
                .otherwise(pl.lit("rows without a reading or insulin")),
            ),
            glucose_unit="mg/dl",
            notes=(*table.notes, *notes),
        )


def _doses(column: str) -> list[pl.Expr]:
    """Units of rapid-acting and of long-acting insulin that texts tell, and whether one is of a premixed insulin."""
    doses = pl.Struct({"rapid": pl.Float64, "slow": pl.Float64, "mixed": pl.Boolean})
    told = pl.col(column).map_elements(_dose, return_dtype=doses, skip_nulls=False)
    return [told.struct.field(name) for name in ("rapid", "slow", "mixed")]


def _dose(text: str | None) -> dict[str, float | bool | None]:
    rapid = slow = 0.0
    mixed = False
    for name, units in _DOSE.findall(text or ""):
        share = rapid_share(name)
        rapid += share * float(units)
        slow += (1.0 - share) * float(units)
        mixed = mixed or 0.0 < share < 1.0
    return {"rapid": round(rapid, 3) or None, "slow": round(slow, 3) or None, "mixed": mixed}
