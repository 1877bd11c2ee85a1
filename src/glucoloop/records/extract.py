"""Rows of a file as its reader hands them on: what each says, still in the words and units of the file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Final, Literal

import polars as pl

from glucoloop.records.record import AUTOMATIC, MANUAL
from glucoloop.text import how_many

VALUES: Final = ("glucose", "carbs", "bolus", "long_acting", "basal", "glucagon")
_LARGEST: Final = 1e30
_TYPES: Final = dict.fromkeys(("out_of_range", "device", "kind", "source", "person", "bolus_type"), pl.String())


@dataclass(frozen=True, kw_only=True)
class Extract:
    """Rows of one file.

    Columns of ``frame``: ``row``, the number of the row in the file, which several rows here may share; ``time``, which
    is ``in_utc`` or on the wall, and ``utc_offset_min``; ``glucose``, ``carbs`` [g], ``bolus`` [U], ``long_acting`` (
    insulin) [U], ``basal`` [U/h] and ``glucagon`` [ug], as texts or numbers; ``bolus_min``, the time over which a bolus
    is given, and ``bolus_type``, `record.AUTOMATIC` or `record.MANUAL` where the file tells it;
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


def extended_boluses(frame: pl.DataFrame) -> list[tuple[int, float, float]]:
    """Row, insulin [U] and time [min] of each bolus over a time, of the columns ``extended`` and ``minutes``."""
    return [
        (row, units, minutes)
        for row, (dose, span) in enumerate(frame.select("extended", "minutes").iter_rows())
        if (units := number_in(dose)) and (minutes := number_in(span))
    ]


def with_doses(frame: pl.DataFrame, doses: list[tuple[int, float, float]]) -> pl.DataFrame:
    """Rows of an extract and those of boluses over a time: row of the file, insulin [U] and time [min] of each."""
    if not doses:
        return frame
    schema = {"row": pl.Int64(), "bolus": pl.Float64(), "bolus_min": pl.Float64()}
    table = pl.DataFrame(doses, schema=schema, orient="row").with_columns(pl.col("bolus").cast(frame["bolus"].dtype))
    whose = frame.select("row", "time", "in_utc", "utc_offset_min", "device", "source", "kind", "person", "bolus_type")
    table = table.join(whose.unique("row", keep="first"), on="row", how="left", maintain_order="left")
    bare = frame.filter(pl.col("row").is_in(table["row"].implode()) & pl.all_horizontal(pl.col(*VALUES).is_null()))
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
        & pl.all_horizontal(pl.col(name for name in VALUES if name != "basal").is_null())
    )
    return pl.concat(
        [frame.join(bare.select("row"), on="row", how="anti", maintain_order="left"), table], how="diagonal"
    )


_VALUES: Final = ("glucose_mg_dl", "carbs_g", "bolus_U", "long_acting_U", "basal_U_h", "glucagon_ug")
_ABOUT: Final = {"glucose_mg_dl": ("out_of_range",), "bolus_U": ("bolus_min", "bolus_type")}
"""Columns that tell more of a value."""


@dataclass
class Account:
    """Rows that were left out, by reason, and notes on what was changed."""

    files: int = 0
    rows: int = 0
    """Number of rows of the files."""
    left_out: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def without(self, frame: pl.DataFrame, gone: pl.Expr, reason: str) -> pl.DataFrame:
        """Rows without some; a row of the file of which none is left is counted as left out."""
        mask = frame.select(gone.fill_null(False)).to_series()
        if not mask.any():
            return frame
        lost, kept = frame.filter(mask).select("file", "row").unique(), frame.filter(~mask)
        lost = lost.join(kept.select("file", "row"), on=["file", "row"], how="anti")
        if lost.height:
            self.left_out[reason] = self.left_out.get(reason, 0) + lost.height
        return kept

    def without_value(self, frame: pl.DataFrame, gone: pl.Series, name: str, reason: str) -> pl.DataFrame:
        """Rows of which some have lost one value; those with no other one are left out, as rows of the reason."""
        if not gone.any():
            return frame
        bare = pl.all_horizontal(pl.col(other).is_null() for other in _VALUES if other != name)
        frame = frame.with_columns(_gone=gone)
        beside = frame.filter(pl.col("_gone") & ~bare).height
        if beside:
            self.notes.append(f"{how_many(beside, 'row')} lost a value and kept another one: {reason}.")
        frame = self.without(frame, pl.col("_gone") & bare, reason)
        names = (name, *_ABOUT.get(name, ()))
        return frame.with_columns(pl.when(~pl.col("_gone")).then(one).alias(one) for one in names).drop("_gone")


_SAME_TIME = timedelta(minutes=1)


@dataclass(frozen=True, kw_only=True)
class BasalEvent:
    """One entry of the log of a pump about its basal rate."""

    row: int
    """Row of the file."""
    time: datetime
    what: Literal["usual", "absolute", "percent", "end", "suspend", "resume"]
    value: float = math.nan
    """Rate [U/h], or percentage of the usual rate."""
    minutes: float = math.inf
    """Duration of a temporary rate."""


def basal_rates(events: Iterable[BasalEvent]) -> list[tuple[int, datetime, float]]:
    """Row of the file, time and basal rate [U/h] of each change; NaN where the rate is not known from there on.

    A temporary rate ends after its duration or with the next one, and then the usual rate holds, which may be unknown.
    """
    rates: list[tuple[int, datetime, float]] = []
    usual, suspended = math.nan, False
    temporary: BasalEvent | None = None

    def rate() -> float:
        if suspended:
            return 0.0
        if temporary is None:
            return usual
        return temporary.value if temporary.what == "absolute" else usual * temporary.value / 100.0

    def end_of(event: BasalEvent) -> datetime:
        return event.time + timedelta(minutes=min(event.minutes, 1e7))

    for event in sorted(events, key=lambda event: event.time):
        if temporary is not None and end_of(temporary) <= event.time:
            ended, temporary = temporary, None
            if event.time - end_of(ended) > _SAME_TIME:
                rates.append((ended.row, end_of(ended), rate()))
        if event.what == "usual":
            usual = event.value
        elif event.what in ("absolute", "percent"):
            temporary = event
        elif event.what == "end":
            temporary = None
        else:
            suspended = event.what == "suspend"
        rates.append((event.row, event.time, rate()))
    if temporary is not None and math.isfinite(temporary.minutes):
        ended, temporary = temporary, None
        rates.append((ended.row, end_of(ended), rate()))
    return rates
