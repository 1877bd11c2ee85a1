"""One clock for all files of a person: instants in UTC where they can be known, and the time on the wall beside them.

A file tells times on the wall, or in UTC with or without the offset of the wall. One zone holds for all files: the one
that the user gives, or else the one that a profile or a device tells. Without a zone the offsets that some times tell
hold for the others too. What contradicts itself is asked about.
"""

from __future__ import annotations

import zoneinfo
from collections.abc import Sequence
from datetime import datetime
from typing import Final

import numpy as np
import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.repeated_hour import with_second_pass
from glucoloop.refusal import Refusal
from glucoloop.text import the_first

_UTC: Final = ("UTC", "GMT", "ETC/UTC", "ETC/GMT", "ETC/UCT", "UCT", "ZULU", "ETC/ZULU", "ETC/UNIVERSAL")
"""Zones that programs write where nobody chose one."""
_MOST_AT_ODDS: Final = 0.05
"""Largest share of offsets that may be at odds with the others, as for some hours after a journey."""
_FEW: Final = 12
_ASK: Final = "say the time zone of the person with time_zone (--time-zone)"


def zone_named(name: object) -> str | None:
    """Name of a time zone as it is registered, also for one that Loop writes like ``ETC/GMT+5``; None if it is none."""
    if not isinstance(name, str) or not name:
        return None
    name = f"Etc/{name[4:]}" if name[:4].upper() == "ETC/" else name
    try:
        zoneinfo.ZoneInfo(name)
        pl.select(pl.lit(datetime(2000, 1, 1)).dt.replace_time_zone(name))
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError, pl.exceptions.PolarsError):
        return None
    return name


def on_one_clock(frame: pl.DataFrame, zones: Sequence[str], answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Rows with the time on the wall, its offset, and whether they are of a repeated hour's second pass; and notes.

    `zones` are the time zones that files tell. Refusal where they, or offsets, contradict each other.
    """
    notes: list[str] = []
    frame = frame.with_columns(_told="utc_offset_min")
    zone = answers.time_zone or _zone_told(frame, zones, notes)
    if frame["in_utc"].any():
        frame = _in_zone(frame, zone, notes) if zone else _by_offsets(frame, notes)
    frame, more = with_second_pass(frame, zone)
    frame, settled = _wall_offsets(frame, zone)
    return frame.drop("_told"), [*notes, *more, *settled]


def _offset(there: pl.Expr) -> pl.Expr:
    return (there.dt.base_utc_offset() + there.dt.dst_offset()).dt.total_minutes().cast(pl.Int32)


def _offset_in(zone: str) -> pl.Expr:
    """Offset of a zone at times in UTC."""
    return _offset(pl.col("time").dt.replace_time_zone("UTC").dt.convert_time_zone(zone))


def _zone_told(frame: pl.DataFrame, zones: Sequence[str], notes: list[str]) -> str | None:
    """The zone that the files tell; None if they tell none."""
    known = list(dict.fromkeys(filter(None, map(zone_named, zones))))
    told = frame.filter("in_utc", pl.col("_told").is_not_null(), pl.col("time").is_not_null())
    chosen = [zone for zone in known if zone.upper() not in _UTC]
    if not chosen and (told["_told"] != 0).any():
        return None
    chosen = chosen or known[:1]
    if len(chosen) > 1 and frame.height:
        span = frame.select(pl.col("time").drop_nulls().unique())
        offsets = [span.select(_offset_in(zone)).to_series() for zone in chosen]
        if any(not other.equals(offsets[0]) for other in offsets[1:]):
            raise Refusal(f"its files tell different time zones, {the_first(chosen)}", _ASK)
    if not chosen:
        return None
    zone = chosen[0]
    at_odds = told.filter(pl.col("_told") != _offset_in(zone))
    if at_odds.height > max(_FEW, _MOST_AT_ODDS * told.height):
        other = at_odds["_told"].mode()[0]
        raise Refusal(
            f"it tells the time zone {zone}, and {at_odds.height} of its times tell another offset from UTC, as "
            f"{other} min",
            _ASK,
        )
    notes.append(f"{zone} is the time zone that the files tell; it holds for all times.")
    return zone


def _in_zone(frame: pl.DataFrame, zone: str, notes: list[str]) -> pl.DataFrame:
    """Rows whose times in UTC are those on the wall of a zone."""
    notes.append(f"Times in UTC were brought to {zone}.")
    other = frame.filter("in_utc", pl.col("_told") != _offset_in(zone)).height
    if other:
        notes.append(f"{other} times tell another offset from UTC than {zone} has; the zone was taken.")
    there = pl.col("time").dt.replace_time_zone("UTC").dt.convert_time_zone(zone)
    return frame.with_columns(
        time=pl.when("in_utc").then(there.dt.replace_time_zone(None)).otherwise("time"),
        utc_offset_min=pl.when("in_utc").then(_offset(there)).otherwise("utc_offset_min"),
    )


def _by_offsets(frame: pl.DataFrame, notes: list[str]) -> pl.DataFrame:
    """Rows whose times in UTC are those on the wall by the offsets that they, or their neighbours in time, tell."""
    told = pl.col("in_utc") & pl.col("_told").is_not_null() & pl.col("time").is_not_null()
    known = frame.filter(told).select("time", "_told").sort("time")
    if not known.height:
        if frame.filter(~pl.col("in_utc"), pl.col("utc_offset_min").is_null()).height:
            raise Refusal("some of its times are in UTC and others on the clock on the wall", _ASK)
        files = "the file tells" if frame["file"].n_unique() == 1 else "the files tell"
        notes.append(
            f"Times are in UTC, for {files} no other; the time zone of the person brings them to the time on the wall."
        )
        shift: pl.Expr = pl.lit(0, pl.Int32)
        return frame.with_columns(utc_offset_min=pl.when("in_utc").then(shift).otherwise("utc_offset_min"))
    known = _without_odds(known, notes)
    at, offsets = known["time"].to_physical().to_numpy(), known["_told"].to_numpy()
    moments = frame["time"].to_physical().fill_null(0).to_numpy()
    after = np.searchsorted(at, moments).clip(1, max(1, at.size - 1))
    if at.size > 1:
        nearest = np.where(moments - at[after - 1] <= at[after] - moments, after - 1, after)
    else:
        nearest = np.zeros(moments.size, int)
    of_nearest = pl.Series("_nearest", offsets[nearest], dtype=pl.Int32)
    filled = int((frame["in_utc"] & frame["_told"].is_null() & frame["time"].is_not_null()).sum())
    if filled:
        notes.append(
            f"{filled} times are in UTC and tell no offset of the clock on the wall; that of the nearest time that "
            "tells one was taken."
        )
    frame = frame.with_columns(of_nearest)
    constant = known["_told"].n_unique() == 1
    offset = (
        pl.when("in_utc")
        .then("_nearest")
        .when(pl.lit(constant) & pl.col("time").is_not_null())
        .then(pl.coalesce("utc_offset_min", "_nearest"))
        .otherwise("utc_offset_min")
    )
    shift = pl.duration(minutes=pl.when("in_utc").then("_nearest").otherwise(0).cast(pl.Int64), time_unit="us")
    return frame.with_columns(time=pl.col("time") + shift, utc_offset_min=offset).drop("_nearest")


def _without_odds(known: pl.DataFrame, notes: list[str]) -> pl.DataFrame:
    """Offsets of which each hour has one; Refusal where two clocks run beside each other."""
    hour = known.with_columns(hour=pl.col("time").dt.truncate("1h"))
    usual = hour.group_by("hour").agg(usual=pl.col("_told").mode().sort().last(), kinds=pl.col("_told").n_unique())
    hour = hour.join(usual, on="hour", how="left", maintain_order="left")
    odd = hour.filter(pl.col("_told") != pl.col("usual"))
    if odd.height > max(_FEW, _MOST_AT_ODDS * hour.height):
        pair = sorted({*hour.filter(pl.col("kinds") > 1)["_told"].unique()})
        raise Refusal(
            f"its times tell different offsets from UTC at the same time, {the_first([f'{one} min' for one in pair])}",
            _ASK,
        )
    if odd.height:
        notes.append(
            f"{odd.height} times tell another offset from UTC than others of the same hour; "
            "the more common one was taken."
        )
    return hour.select("time", _told="usual")


def _wall_offsets(frame: pl.DataFrame, zone: str | None) -> tuple[pl.DataFrame, list[str]]:
    """Rows on the clock on the wall with the offset that a zone has then."""
    unknown = pl.col("utc_offset_min").is_null() & pl.col("time").is_not_null()
    if zone is None or not frame.select(unknown.any()).item():
        return frame, []
    notes = []
    early, late = (
        pl.col("time").dt.replace_time_zone(zone, ambiguous=which, non_existent="null")
        for which in ("earliest", "latest")
    )
    frame = frame.with_columns(_early=_offset(early), _late=_offset(late))
    repeated = pl.col("_early") != pl.col("_late")
    settled = pl.when("second_pass").then("_late").otherwise("_early")
    two_passes = pl.col("second_pass").any().over(pl.col("time").dt.date()) & pl.col("glucose_mg_dl").is_not_null()
    frame = frame.with_columns(_open=unknown & repeated & ~two_passes, _gone=unknown & pl.col("_early").is_null())
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
