"""Times of a file: the order of day and month, time zones, and the hour that a clock repeats in autumn."""

from __future__ import annotations

from datetime import datetime
from typing import Final

import polars as pl

from glucoloop.records.answers import DAY_FIRST, MONTH_FIRST, Answers
from glucoloop.refusal import Refusal

TIME: Final = pl.Datetime("us")
_PATTERN: Final = (
    r"(?i)^\s*(?<a>\d{1,4})[-./ ](?<b>\d{1,2}|[a-z]{3})[-./ ](?<c>\d{1,4})"
    r"[t ,]+(?<h>\d{1,2}):(?<m>\d{2})(?::(?<s>\d{2})(?:[.,](?<f>\d{1,9}))?)?"
    r"\s*(?<half>[ap])?\.?m?\.?\s*(?<zone>z|[-+]\d{2}:?\d{2})?\s*$"
)
_WRITTEN: Final = ("%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S", "%Y/%m/%d %H:%M:%S")
_MONTHS: Final = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
YEARS: Final = (1970, 2199)
"""First and last year of a time."""
_MAX_STEPS_BACK: Final = 12
"""Number of steps back in time up to which the rows of a file are in the order of time."""


def times_of(texts: pl.Series, answers: Answers, *, usual: str | None = None) -> tuple[pl.DataFrame, list[str]]:
    """Local time and offset of each text, null where it is no time, and notes.

    Times may be in any common order and with or without an offset from UTC. `usual` is the order of day and month that
    the program that wrote the file always has. Refusal if day and month could be either.
    """
    for written in _WRITTEN:
        whole = texts.str.to_datetime(written, time_unit="us", strict=False)
        if whole.null_count() == texts.null_count():  # as most files have them, and many times faster
            return whole.to_frame("time").with_columns(utc_offset_min=pl.lit(None, pl.Int32)), []
    parts = _parts(texts)
    order, notes = _order(parts, texts, answers.dates, usual)
    day_first = pl.col("year_first") | pl.col("named") | (order == DAY_FIRST)
    short = pl.when(pl.col("c") < 100).then(2000).otherwise(0)
    parts = parts.with_columns(
        year=pl.when("year_first").then("a").otherwise(pl.col("c") + short),
        month=pl.when(day_first).then("b").otherwise("a"),
        day=pl.when("year_first").then("c").when(day_first).then("a").otherwise("b"),
    )
    bounds = {
        "year": YEARS,
        "month": (1, 12),
        "day": (1, 31),
        "hour": (0, 23),
        "minute": (0, 59),
        "second": (0, 59),
    }
    possible = pl.all_horizontal(pl.col(name).is_between(*ends) for name, ends in bounds.items())
    first_day = pl.datetime(pl.when(possible).then("year"), pl.when(possible).then("month"), 1, time_unit="us")
    date = first_day + pl.duration(days=pl.col("day") - 1)
    since = pl.duration(hours="hour", minutes="minute", seconds="second", microseconds="micro", time_unit="us")
    # The thirtieth of February is no day: it must not become one of March.
    time = pl.when(date.dt.month() == pl.col("month").cast(pl.Int8)).then(date + since)
    return parts.select(time=time.cast(TIME), utc_offset_min="offset"), notes


def _parts(texts: pl.Series) -> pl.DataFrame:
    """Numbers of which each text is made; ``a``, ``b`` and ``c`` are those of its date, in the order of the text."""
    result = texts.str.extract_groups(_PATTERN).struct.unnest()
    result = result.with_columns(pl.col("b", "half", "zone").str.to_lowercase())

    def number(name: str) -> pl.Expr:
        return pl.col(name).cast(pl.Int32, strict=False)

    month = pl.col("b").replace_strict(_MONTHS, range(1, 13), default=None, return_dtype=pl.Int32)
    half = pl.when(pl.col("half") == "p").then(12).otherwise(0)
    digits = pl.col("zone").str.replace_all("[^0-9]", "")
    minutes = digits.str.slice(0, 2).cast(pl.Int32, strict=False) * 60 + digits.str.slice(2, 2).cast(
        pl.Int32, strict=False
    )
    return result.select(
        a=number("a"),
        b=pl.coalesce(number("b"), month),
        c=number("c"),
        named=month.is_not_null(),
        year_first=(pl.col("a").str.len_chars() == 4).fill_null(True),
        hour=pl.when(pl.col("half").is_null()).then(number("h")).otherwise(number("h") % 12 + half),
        minute=number("m"),
        second=number("s").fill_null(0),
        micro=pl.col("f").str.pad_end(6, "0").str.slice(0, 6).cast(pl.Int32, strict=False).fill_null(0),
        offset=pl.when(pl.col("zone") == "z")
        .then(0)
        .when(pl.col("zone").str.starts_with("-"))
        .then(-minutes)
        .otherwise(minutes),
    )


def _order(parts: pl.DataFrame, texts: pl.Series, given: str | None, usual: str | None) -> tuple[str, list[str]]:
    """Order of day and month where the year is last, from what is given, or from dates that fit one order only."""
    last = parts.filter(~pl.col("year_first") & ~pl.col("named"))
    if given is not None or usual is not None or not last.height:
        return given or usual or DAY_FIRST, []
    day = last.filter((pl.col("a") > 12) & (pl.col("b") <= 12)).height
    month = last.filter((pl.col("b") > 12) & (pl.col("a") <= 12)).height
    if day and month:
        raise Refusal(
            f"{day} of its dates have the day first and {month} the month first",
            "divide the file",
            "say which is meant with dates=day-first or dates=month-first (--dates), which leaves out the others",
        )
    if day or month:
        return (DAY_FIRST if day else MONTH_FIRST), []
    if texts.drop_nulls().head(1).str.contains(r"^\s*\d{1,2}\.\d{1,2}\.").any():
        return DAY_FIRST, ["Dates with points have the day first."]
    if last.select((pl.col("a") == pl.col("b")).all()).item():
        return DAY_FIRST, []
    raise Refusal(
        "its dates fit both orders, for no day is above 12",
        "say which is meant with dates=day-first or dates=month-first (--dates)",
    )


def clock(time: object) -> str:
    """Text of a local time, in minutes."""
    return f"{time:%Y-%m-%d %H:%M}" if isinstance(time, datetime) else "an unknown time"


def from_utc(instants: pl.Series, offsets: pl.Series | None, answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Local time of instants in UTC: in the zone that is asked for, or by the offsets [min] that the file has."""
    frame = pl.DataFrame({"instant": instants.cast(TIME)})
    frame = frame.select(pl.when(pl.col("instant").dt.year().is_between(*YEARS)).then("instant"))
    if answers.time_zone is not None:
        there = pl.col("instant").dt.replace_time_zone("UTC").dt.convert_time_zone(answers.time_zone)
        offset = (there.dt.base_utc_offset() + there.dt.dst_offset()).dt.total_minutes().cast(pl.Int32)
        table = frame.select(time=there.dt.replace_time_zone(None), utc_offset_min=offset)
        return table, [f"Times in UTC were brought to {answers.time_zone}."]
    known = pl.Series([None] * len(instants), dtype=pl.Int32) if offsets is None else offsets.cast(pl.Int32)
    notes = []
    if not (known.fill_null(0) != 0).any():
        notes.append(
            "Times are in UTC, for the file tells no other; the time zone of the person brings them to the time on the "
            "wall."
        )
    shift = pl.duration(minutes=pl.lit(known.fill_null(0)).cast(pl.Int64), time_unit="us")
    return frame.select(time=pl.col("instant") + shift, utc_offset_min=pl.lit(known.fill_null(0))), notes


def settled_clock(frame: pl.DataFrame, answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Rows with the offset of their time, and whether they are of the second pass of an hour that the clock repeats.

    The rows are in the order of the file. A second pass is seen from the clock's going back within a file whose rows
    are otherwise in the order of time, or in the reverse one.
    """
    frame, result = _with_second_pass(frame)
    notes = []
    if result:
        first = clock(frame.filter("second_pass")["time"].min())
        count = frame["second_pass"].sum()
        notes.append(
            f"The clock went back in {result} place{'s' if result > 1 else ''}, first at {first}: "
            f"{count} readings of a repeated hour are kept beside those of the first pass."
        )
    unknown = pl.col("utc_offset_min").is_null() & pl.col("time").is_not_null()
    if answers.time_zone is None or not frame.select(unknown.any()).item():
        return frame, notes
    zone = answers.time_zone
    early, late = (
        pl.col("time").dt.replace_time_zone(zone, ambiguous=which, non_existent="null")
        for which in ("earliest", "latest")
    )

    def offset(there: pl.Expr) -> pl.Expr:
        return (there.dt.base_utc_offset() + there.dt.dst_offset()).dt.total_minutes().cast(pl.Int32)

    frame = frame.with_columns(_early=offset(early), _late=offset(late))
    repeated = pl.col("_early") != pl.col("_late")
    settled = pl.when("second_pass").then("_late").otherwise("_early")
    with_zone = pl.col("second_pass").any().over(pl.col("time").dt.date()) & pl.col("glucose_mg_dl").is_not_null()
    frame = frame.with_columns(_open=unknown & repeated & ~with_zone, _gone=unknown & pl.col("_early").is_null())
    open_rows, gone = int(frame["_open"].fill_null(False).sum()), int(frame["_gone"].fill_null(False).sum())
    frame = frame.with_columns(
        utc_offset_min=pl.when(pl.col("_open")).then(None).when(unknown).then(settled).otherwise("utc_offset_min")
    )
    if open_rows:
        notes.append(
            f"{open_rows} rows lie in an hour that {zone} has twice, and nothing says in which of the two: their "
            "offset from UTC is left unknown."
        )
    if gone:
        notes.append(f"{gone} rows lie in an hour that {zone} skips; their offset from UTC is left unknown.")
    return frame.drop("_early", "_late", "_open", "_gone"), notes


def _with_second_pass(frame: pl.DataFrame) -> tuple[pl.DataFrame, int]:
    """Rows marked as of a second pass, and the number of places where the clock goes back."""
    frame = frame.with_columns(second_pass=pl.lit(False))
    read = pl.col("glucose_mg_dl").is_not_null() & pl.col("time").is_not_null() & pl.col("utc_offset_min").is_null()
    marked: list[pl.DataFrame] = []
    for rows in frame.with_row_index("_at").filter(read).partition_by("device", "kind"):
        steps = rows["time"].diff().dt.total_minutes()
        if (steps < 0).sum() > (steps > 0).sum():
            rows = rows.reverse()
            steps = rows["time"].diff().dt.total_minutes()
        if (steps < 0).sum() > _MAX_STEPS_BACK:
            continue
        back = ((steps <= -30) & (steps >= -90)).arg_true()
        for place in back:
            before = rows["time"][place - 1]
            after = rows.slice(place).filter(pl.col("time").cum_max() <= before)
            copies = after.join(rows.slice(0, place), on=["time", "glucose_mg_dl"], how="semi").height
            if 2 * copies > after.height:  # a part of the file that is there twice
                continue
            marked.append(after.select("_at", place=pl.lit(len(marked))))
    if not marked:
        return frame, 0
    second = pl.concat(marked)["_at"]
    at = pl.int_range(pl.len(), dtype=pl.UInt32)
    return frame.with_columns(second_pass=at.is_in(second.implode())), len(marked)
