"""Times of a file from its texts: the order of day and month, and offsets from UTC."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Final

import polars as pl

from glucoloop.records.answers import DAY_FIRST, MONTH_FIRST, YEAR_FIRST, Answers
from glucoloop.refusal import Refusal
from glucoloop.text import how_many

TIME: Final = pl.Datetime("us")
_PATTERN: Final = (
    r"(?i)^\s*(?<a>\d{1,4})[-./ ](?<b>\d{1,2}|[a-z]{3})[-./ ](?<c>\d{1,4})"
    r"[t ,]+(?<h>\d{1,2}):(?<m>\d{2})(?::(?<s>\d{2})(?:[.,](?<f>\d{1,9}))?)?"
    r"\s*(?<half>[ap])?\.?m?\.?\s*(?<zone>z|(?:utc|gmt)?[-+]\d{1,2}(?::?\d{2})?|utc|gmt)?\s*$"
)
_DATE: Final = r"^\s*(\d{4}[-./]\d{1,2}[-./]\d{1,2}|\d{1,2}[-./]\d{1,2}[-./]\d{4})\s*$"
_WRITTEN: Final = ("%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S", "%Y/%m/%d %H:%M:%S")
_MONTHS: Final = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_OTHERWISE: Final = (
    (r"^\s*(\d{4})(\d\d)(\d\d)[t ]?(\d\d):?(\d\d):?(\d\d)$", "$1-$2-$3 $4:$5:$6"),  # 20240313080500
    (r"^\s*(\d{4})(\d\d)(\d\d)[t ]?(\d\d):?(\d\d)$", "$1-$2-$3 $4:$5"),
    (r"^\s*(\d{4}-\d\d-\d\d)[t ](\d\d)(\d\d)(\d\d)$", "$1 $2:$3:$4"),
    (r"^\s*(\d{4})[年년] ?(\d{1,2})[月월] ?(\d{1,2})[日일] ?", "$1-$2-$3 "),
    (r"^\s*(\d+)\. *(\d+)\. *(\d+)\.?", "$1.$2.$3"),  # 13. 3. 2024 and 2024. 03. 13.
    (r"\s*uhr\s*$", ""),
    (r"([t ,])(\d{1,2})[.h](\d{2})[.m](\d{2})s?$", "$1$2:$3:$4"),  # 8.05.00 and 8h05m00
    (r"([t ,])(\d{1,2})[.h](\d{2})$", "$1$2:$3"),
    (rf"^\s*((?:{'|'.join(_MONTHS)})[a-z]*)\.? +(\d{{1,2}}),? +(\d{{4}})", "$2 $1 $3"),  # March 13, 2024
    (r"^[^\W\d]{2,12}\.?,? +(\d)", "$1"),  # a day of the week before the date
    (r"(\d[-./ ])([a-z]{3})[a-z]*\.?([-./ ])", "$1$2$3"),  # a month in full
)
"""Ways to write a time, each with one that the pattern has; they are tried where the pattern does not fit."""
_HALF_DAY: Final = 12
"""Hours of a clock that needs AM and PM."""
FAR_DAYS: Final = 90
_MOST_FAR, _FEW_FAR = 0.01, 12
"""Distance from all others, share of all, and number if of several days, of times of a wrong clock or year."""
YEARS: Final = (1000, 9998)
"""First and last year of a time: a study shifts its dates by as much as it likes."""


def times_of(texts: pl.Series, answers: Answers, *, usual: str | None = None) -> tuple[pl.DataFrame, list[str]]:
    """Time of each text, null where it is no time, whether it is in UTC, its offset from UTC, and notes.

    Times may be in any common order. One with an offset is brought to UTC; an offset of 0 says no more than that, since
    programs write it whatever the clock on the wall shows. `usual` is the order of day and month that the program that
    wrote the file always has. Refusal if day and month could be either.
    """
    for written in _WRITTEN:
        whole = texts.str.to_datetime(written, time_unit="us", strict=False)
        sound = whole.drop_nulls().dt.year().is_between(*YEARS).all()
        if sound and whole.null_count() == texts.null_count():  # as most files have them, and many times faster
            _refuse_half_a_clock(whole)
            return whole.to_frame("time").with_columns(in_utc=pl.lit(False), utc_offset_min=pl.lit(None, pl.Int32)), []
    texts, midnights = _with_midnights(texts)
    parts = _parts(texts)
    dated = parts.filter(pl.col("a").is_not_null())
    if 2 * dated.filter("year_first").height > dated.height:
        # Among years of four digits one of fewer is damage, not a day.
        parts = parts.with_columns(a=pl.when("year_first").then("a"), year_first=pl.lit(True))
    parts, years = _with_short_years(parts, texts, answers.dates or usual)
    order, notes = _order(parts, texts, answers.dates, usual)
    notes = [*years, *notes]
    if midnights:
        notes.append(
            f"{how_many(midnights, 'time')} without a clock among others with one: read as midnight, as programs that "
            "write tables leave it out."
        )
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
    result = parts.select(time=time.cast(TIME), utc_offset_min="offset")
    _refuse_half_a_clock(result["time"])
    in_utc = pl.col("utc_offset_min").is_not_null()
    return result.select(
        time=pl.col("time") - pl.duration(minutes=pl.col("utc_offset_min").fill_null(0), time_unit="us"),
        in_utc=in_utc,
        utc_offset_min=pl.when(pl.col("utc_offset_min") != 0).then("utc_offset_min"),
    ), notes


def _refuse_half_a_clock(times: pl.Series) -> None:
    """Refuse times of a clock of 12 hours without AM and PM: no hour is 0 or above 12, and 1 follows on 12 in a day."""
    times = times.drop_nulls()
    hours = times.dt.hour()
    if hours.n_unique() != _HALF_DAY or hours.min() != 1 or hours.max() != _HALF_DAY:
        return
    dates, before = times.dt.date(), hours.shift()
    same_day = dates == dates.shift()
    forward = (same_day & (before == _HALF_DAY) & (hours == 1)).sum() if dates[0] <= dates[-1] else 0
    backward = (same_day & (before == 1) & (hours == _HALF_DAY)).sum() if dates[0] >= dates[-1] else 0
    if max(forward, backward) >= 2:
        raise Refusal(
            "its times are of a clock of 12 hours without AM or PM: none is before 01:00 or after 12:59, and in a day "
            "01:00 comes after 12:59; export it with a clock of 24 hours, or with AM and PM"
        )


def _parts(texts: pl.Series) -> pl.DataFrame:
    """Numbers of which each text is made; ``a``, ``b`` and ``c`` are those of its date, in the order of the text."""
    result = _fields(texts)
    result = result.with_columns(pl.col("b", "half", "zone").str.to_lowercase())

    def number(name: str) -> pl.Expr:
        return pl.col(name).cast(pl.Int32, strict=False)

    month = pl.col("b").replace_strict(_MONTHS, range(1, 13), default=None, return_dtype=pl.Int32)
    half = pl.when(pl.col("half") == "p").then(12).otherwise(0)
    zone = pl.col("zone").str.extract_groups(r"([-+])(\d{1,2}?):?(\d{2})?$")
    hours, beside = (zone.struct.field(place).cast(pl.Int32, strict=False) for place in ("2", "3"))
    minutes = 60 * hours + beside.fill_null(0)
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
        offset=pl.when(pl.col("zone").is_in(["z", "utc", "gmt"]))
        .then(0)
        .when(zone.struct.field("1") == "-")
        .then(-minutes)
        .otherwise(minutes),
    )


def _with_midnights(texts: pl.Series) -> tuple[pl.Series, int]:
    """Texts in which a date alone has the clock of midnight, where most others have one; and how many these are."""
    bare = texts.str.contains(_DATE).fill_null(False)
    count = int(bare.sum())
    if not count or 2 * texts.str.contains(_PATTERN).sum() <= texts.len() - texts.null_count():
        return texts, 0
    return pl.select(pl.when(pl.lit(bare)).then(pl.lit(texts) + " 00:00").otherwise(pl.lit(texts))).to_series(), count


def _fields(texts: pl.Series) -> pl.DataFrame:
    """Groups of the pattern in each text, or in what other ways of writing a time make of it."""
    result = texts.str.extract_groups(_PATTERN).struct.unnest()
    other = result["a"].is_null() & texts.is_not_null()
    if not other.any():
        return result
    again = texts.filter(other).str.to_lowercase()
    for written, plain in _OTHERWISE:
        again = again.str.replace(written, plain)
    return texts.clone().scatter(other.arg_true(), again).str.extract_groups(_PATTERN).struct.unnest()


def _with_short_years(parts: pl.DataFrame, texts: pl.Series, given: str | None) -> tuple[pl.DataFrame, list[str]]:
    """Numbers of dates in which a year of two digits that stands first is a whole one, and a note.

    It stands where all dates lie closest together, as rows of a record do. Refusal where nothing tells it.
    """
    short = ~pl.col("year_first") & ~pl.col("named") & (pl.col("c") < 100)
    dates = parts.filter(short).select("a", "b", "c").unique()
    if not dates.height or 2 * parts.filter(short).height <= parts.filter(pl.col("a").is_not_null()).height:
        return parts, []
    spans = {
        YEAR_FIRST: _span_days(dates, "a", "b", "c"),
        DAY_FIRST: _span_days(dates, "c", "b", "a"),
        MONTH_FIRST: _span_days(dates, "c", "a", "b"),
    }
    others = [span for order, span in spans.items() if order != YEAR_FIRST and span is not None]
    first = spans[YEAR_FIRST]
    if given is None and first is not None and min(others, default=math.inf) == first:
        if texts.drop_nulls().head(1).str.contains(r"^\s*\d{1,2}-").any():
            raise Refusal(
                "its dates have a year of two digits, which could be the first or the last number",
                "say which with dates=year-first, dates=day-first or dates=month-first (--dates)",
            )
        return parts, []
    chosen = given == YEAR_FIRST or (given is None and first is not None and first < min(others, default=math.inf))
    if not chosen:
        return parts, []
    whole = pl.when(short).then(pl.col("a") + 2000).otherwise("a")
    parts = parts.with_columns(a=whole, year_first=pl.col("year_first") | short)
    return parts, ["Dates begin with a year of two digits."]


def _span_days(dates: pl.DataFrame, year: str, month: str, day: str) -> int | None:
    """Days from the first date to the last one in an order; None where a date is none in it."""
    sound = pl.col(month).is_between(1, 12) & pl.col(day).is_between(1, 31)
    if not dates.select(sound.all()).item():
        return None
    days = pl.datetime(pl.col(year) + 2000, month, 1) + pl.duration(days=pl.col(day) - 1)
    return int(dates.select((days.max() - days.min()).dt.total_days()).item())


def _order(parts: pl.DataFrame, texts: pl.Series, given: str | None, usual: str | None) -> tuple[str, list[str]]:
    """Order of day and month where the year is last, from what is given, or from dates that fit one order only."""
    last = parts.filter(~pl.col("year_first") & ~pl.col("named"))
    if given == YEAR_FIRST and last.height:
        raise Refusal(f"dates is {YEAR_FIRST!r}, and its dates have the year last", "say day-first or month-first")
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


def from_utc(instants: pl.Series, offsets: pl.Series | None = None) -> pl.DataFrame:
    """Times of instants in UTC, with the offset [min] of the clock on the wall, null where the file does not tell it.

    They are brought to the wall when all files of a person are read, by `clock.on_one_clock`.
    """
    frame = pl.DataFrame({"time": instants.cast(TIME)})
    offset = pl.lit(None, pl.Int32) if offsets is None else pl.lit(offsets.cast(pl.Int32))
    return frame.select(
        time=pl.when(pl.col("time").dt.year().is_between(*YEARS)).then("time"),
        in_utc=pl.lit(True),
        utc_offset_min=offset,
    )


def far_from_others(times: pl.Series) -> pl.Series:
    """Whether each time is one of a few, or of a single day, that lie a quarter of a year from all others."""
    frame = times.to_frame("time").with_row_index("place").sort("time", nulls_last=True)
    frame = frame.with_columns(part=(pl.col("time").diff().dt.total_days() >= FAR_DAYS).fill_null(False).cum_sum())
    span = pl.col("time").max().over("part") - pl.col("time").min().over("part")
    count = pl.len().over("part")
    few = (count <= _MOST_FAR * frame.height) & ((span <= pl.duration(days=1)) | (count <= _FEW_FAR))
    far = frame.with_columns(far=few & pl.col("time").is_not_null())
    return far.sort("place")["far"].fill_null(False)
