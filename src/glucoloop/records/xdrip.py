"""Exports of xDrip: CSV in the form of SiDiary, and its database.

The CSV has day and time, glucose of the sensor and of meters in whole mg/dl, carbohydrate in g, boluses in U; days come
first in dates, on the clock of the phone. The database has a table of readings in mg/dl, one of treatments and one of
finger pricks, with times in UTC; an insulin of a treatment may have a name in ``insulinJSON``.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import DAY_FIRST, Answers
from glucoloop.records.devices import is_long_acting
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import CellTable, FileText, json_of
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import from_utc, times_of
from glucoloop.records.user_files import XDRIP_TABLES

_CSV: Final = ("DAY", "TIME", "UDT_CGMS")
_ERROR_MG_DL: Final = 38.0
"""Value that stands for an error; smaller ones are codes of errors too."""
_READINGS, _TREATMENTS, _PRICKS = (tuple(columns) for columns in XDRIP_TABLES.values())


class XDrip(TableReaderComponent, name="xdrip"):
    """CSV in the form of SiDiary and database that xDrip exports."""

    in_parts: ClassVar = True
    headers: ClassVar = (_CSV, _READINGS, _TREATMENTS, _PRICKS)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of xDrip, or of one of the tables of its database."""
        header, table = self.table(content)
        return _rows_of_csv(table, answers) if header == _CSV else _rows_of_table(header, table)


def _rows_of_csv(table: CellTable, answers: Answers) -> Extract:
    names = (*_CSV, "BG_LEVEL", "CH_GR", "BOLUS", "BASAL")
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


def _rows_of_table(header: tuple[str, ...], table: CellTable) -> Extract:
    frame = table.frame.select(**{name: table.texts(name) for name in header})
    milliseconds = frame["timestamp"].cast(pl.Float64, strict=False)
    sound = milliseconds.is_between(0.0, 1e14)
    instants = pl.select(pl.when(sound).then(milliseconds).cast(pl.Int64).cast(pl.Datetime("ms"))).to_series()
    columns: dict[str, pl.Expr] = {}
    kind = "finger pricks" if header == _PRICKS else "readings without a value"
    if header == _READINGS:
        displayed, calculated = (
            pl.col(name).cast(pl.Float64, strict=False) for name in ("dg_mgdl", "calculated_value")
        )
        value = pl.when(calculated.is_null() | (calculated > _ERROR_MG_DL)).then("calculated_value")
        columns = {"glucose": pl.when(displayed > _ERROR_MG_DL).then("dg_mgdl").otherwise(value)}
    elif header == _TREATMENTS:
        slow = pl.lit(pl.Series([_is_slow(text) for text in frame["insulinJSON"]], dtype=pl.Boolean))
        columns = {
            "carbs": pl.col("carbs"),
            "bolus": pl.when(~slow).then("insulin"),
            "long_acting": pl.when(slow).then("insulin"),
        }
        kind = "treatments without carbohydrate or insulin"
    return Extract(
        frame=extract_frame(frame, from_utc(instants), table.spoilt, **columns, kind=pl.lit(kind)),
        glucose_unit="mg/dl",
        notes=table.notes,
    )


def _is_slow(text: str | None) -> bool:
    """Whether all insulins of a treatment are long-acting."""
    items = json_of(text) if text else None
    names = (
        [str(item.get("insulin", "")) for item in items if isinstance(item, dict)] if isinstance(items, list) else []
    )
    return bool(names) and all(map(is_long_acting, names))
