"""Rows of a file as its reader hands them on: what each says, still in the words and units of the file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import polars as pl

from glucoloop.records.record import AUTOMATIC, MANUAL
from glucoloop.text import how_many

VALUES: Final = ("glucose", "carbs", "bolus", "long_acting", "basal")
_LARGEST: Final = 1e30
_TYPES: Final = dict.fromkeys(("out_of_range", "device", "kind", "source", "person", "bolus_type"), pl.String())


@dataclass(frozen=True, kw_only=True)
class Extract:
    """Rows of one file.

    Columns of ``frame``: ``row``, the number of the row in the file, which several rows here may share; ``time``, which
    is ``in_utc`` or on the wall, and ``utc_offset_min``; ``glucose``, ``carbs`` [g], ``bolus`` [U], ``long_acting`` (
    insulin) [U] and ``basal`` [U/h], as texts or numbers; ``bolus_min``, the time over which a bolus is given, and
    ``bolus_type``, `record.AUTOMATIC` or `record.MANUAL` where the file tells it;
    ``out_of_range``; ``device``, its kind; ``source``, the device or app itself, which no record has; ``person`` of a
    file of several; and ``kind``, in words what a row is that has no value, as ``alerts``. Every row of the file is
    there, whether the record can use it or not.
    """

    frame: pl.DataFrame
    glucose_unit: str | None
    """Unit of glucose, or None where the file does not say it."""
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    """Names of columns that were given and are not in the file."""
    zones: tuple[str, ...] = ()
    """Time zones that the file tells of the person."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of the other columns by name, where they are not those of the record."""
    largest_basal_U_h: float = 35.0
    """Largest basal rate that is possible; no pump gives more than 35 U/h."""
    limits_mg_dl: tuple[float, float] = (40.0, 400.0)
    """Limits of the sensor, which stand for the words low and high."""


def extract_frame(
    rows: pl.DataFrame, times: pl.DataFrame, spoilt: pl.Series | None = None, /, **columns: pl.Expr
) -> pl.DataFrame:
    """Frame of an extract from the rows of a file, their times, and expressions of the columns it has.

    `spoilt` is the reason for which nothing in a row can be used, or null.
    """
    missing = {name: pl.lit(None, pl.Float64) for name in (*VALUES, "bolus_min") if name not in columns}
    words = {name: pl.lit(None, kind) for name, kind in _TYPES.items() if name not in columns}
    every = {**columns, **missing, **words}
    if spoilt is not None and spoilt.null_count() < len(spoilt):
        why = pl.lit(spoilt)
        every = {name: pl.when(why.is_null()).then(value) for name, value in every.items()}
        every["kind"] = pl.coalesce(why, every["kind"])
    return rows.with_columns(**every).select(
        pl.int_range(pl.len(), dtype=pl.Int64).alias("row"), *times.select("time", "in_utc", "utc_offset_min"), *every
    )


def bolus_types(text: pl.Expr, automatic: str) -> pl.Expr:
    """Type of each bolus by the words of a file: automatic where they match a pattern, null where there are none."""
    words = text.str.strip_chars()
    return (
        pl.when(words.str.contains(f"(?i){automatic}"))
        .then(pl.lit(AUTOMATIC))
        .when(~words.is_in(["", "0"]))
        .then(pl.lit(MANUAL))
    )


def parts_of(frame: pl.DataFrame, *names: str) -> list[pl.DataFrame]:
    """Rows of each combination of values of columns; the frame itself where there is one, as in most files."""
    if (
        frame.height
        and frame.select(pl.all_horizontal(pl.col(name).eq_missing(pl.first(name)) for name in names).all()).item()
    ):
        return [frame]
    return frame.partition_by(names)


def cells(values: Iterable[Any]) -> pl.Series:
    """Values of JSON or XML as texts, so that what is no number is told; null for what is not there."""
    texts = (None if value is None else str(value) if isinstance(value, int | float | str) else "?" for value in values)
    return pl.Series(list(texts), dtype=pl.String)


def finite(value: object) -> float | None:
    """A finite number of JSON; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < _LARGEST and not math.isnan(value) else None


def number_in(value: object) -> float | None:
    """A finite number of JSON, which some programs write as a text; None for anything else."""
    if isinstance(value, str):
        text = value.strip().removesuffix("%").replace(",", ".")
        try:
            value = float(text) if text.isascii() and "_" not in text else None
        except ValueError:
            return None
    return finite(value)


def notes_on_spread(count: int) -> list[str]:
    """Sentence on boluses that are given over a time; none where there are none."""
    given = how_many(count, "bolus is", "boluses are")
    return [f"{given} given over a time, in part or as a whole; bolus_min has that time."] if count else []


def with_doses(frame: pl.DataFrame, doses: list[tuple[int, float, float]]) -> pl.DataFrame:
    """Rows of an extract and those of boluses over a time: row of the file, insulin [U] and time [min] of each."""
    if not doses:
        return frame
    schema = {"row": pl.Int64(), "bolus": pl.Float64(), "bolus_min": pl.Float64()}
    table = pl.DataFrame(doses, schema=schema, orient="row").with_columns(pl.col("bolus").cast(frame["bolus"].dtype))
    whose = frame.select("row", "time", "in_utc", "utc_offset_min", "device", "source", "kind", "person", "bolus_type")
    table = table.join(whose.unique("row", keep="first"), on="row", how="left", maintain_order="left")
    bare = frame.filter(
        pl.col("row").is_in(table["row"].implode())
        & pl.all_horizontal(pl.col("glucose", "carbs", "bolus", "long_acting", "basal").is_null())
    )
    return pl.concat(
        [frame.join(bare.select("row"), on="row", how="anti", maintain_order="left"), table], how="diagonal"
    )


def with_basal(frame: pl.DataFrame, rates: list[tuple[int, Any, float]]) -> pl.DataFrame:
    """Rows of an extract and those of basal rates: row of the file, time and rate [U/h] of each."""
    schema = {"row": pl.Int64(), "time": pl.Datetime("us"), "basal": pl.Float64()}
    table = pl.DataFrame(rates, schema=schema, orient="row")
    whose = frame.select("row", "in_utc", "utc_offset_min", "device", "source").unique("row", keep="first")
    table = table.join(whose, on="row", how="left", maintain_order="left")
    bare = frame.filter(
        pl.col("row").is_in(table["row"].implode())
        & pl.all_horizontal(pl.col("glucose", "carbs", "bolus", "long_acting").is_null())
    )
    return pl.concat(
        [frame.join(bare.select("row"), on="row", how="anti", maintain_order="left"), table], how="diagonal"
    )
