"""Tidy record of a person from the rows of all files: one clock, one sensor, each dose once, in the order of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import polars as pl

from glucoloop.records.account import Account
from glucoloop.records.amounts import COLUMNS, with_numbers
from glucoloop.records.answers import Answers
from glucoloop.records.clock import on_one_clock
from glucoloop.records.doubles import each_dose_once, source_of
from glucoloop.records.extract import VALUES, Extract
from glucoloop.records.record import SCHEMA, DeviceRecord
from glucoloop.records.streams import one_sensor, with_instants
from glucoloop.records.times import clock
from glucoloop.refusal import Refusal
from glucoloop.text import how_many, printable
from glucoloop.units import MIN_PER_H, S_PER_MIN

NO_VALUE: Final = "rows without glucose, carbohydrate or insulin"
UNREADABLE: Final = "rows with values that are no number or not possible"
NO_TIME: Final = "rows without a readable time"
REPEATED: Final = "rows that repeat another one"
SAME_TIME: Final = "readings at the time of another reading of the same device"

_MIN_GAP_MIN: Final = 15.0
_LARGEST_DAILY: Final = {"bolus_U": 600.0, "long_acting_U": 600.0, "carbs_g": 3000.0}
"""Amounts of a day beyond those of any person [U, g]."""
_DAILY_WORDS: Final = {
    "bolus_U": ("bolus", "U of boluses"),
    "long_acting_U": ("long_acting", "U of long-acting insulin"),
    "carbs_g": ("carbs", "g of carbohydrate"),
}


def record_of(frames: Sequence[pl.DataFrame], zones: Sequence[str], answers: Answers, account: Account) -> DeviceRecord:
    """Record of one person from the settled rows of one file or several; Refusal if there is nothing to use."""
    frame = pl.concat(frames)
    if (
        frame["basal_U_h"].is_finite().sum()
        + frame.select(pl.exclude("basal_U_h"))
        .select(pl.any_horizontal(pl.col(name).is_not_null() for name in COLUMNS.values() if name != "basal_U_h").sum())
        .item()
        == 0
    ):
        seen = ", ".join(f"{reason} ({count})" for reason, count in account.left_out.items())
        raise Refusal(
            f"nothing in it can be used: it has {how_many(account.rows, 'row')}{f', of which {seen}' if seen else ''}; "
            "give a file with readings, meals or insulin"
        )
    frame, notes = on_one_clock(frame, zones, answers)
    account.notes += notes
    if frame["time"].n_unique() < frame.height:
        frame = _without_repeats(frame, account)
    frame = each_dose_once(with_instants(frame), account)
    frame = one_sensor(frame, answers.device, account)
    _refuse_impossible_days(frame)
    frame = frame.sort("time", "second_pass", maintain_order=True)
    account.notes += [f"Left out: {reason} ({count})." for reason, count in account.left_out.items()]
    account.notes += _on_gaps(frame)
    devices = {name: printable(name) for name in frame["device"].drop_nulls().unique()}
    return DeviceRecord(
        frame=frame.select(pl.col(name).cast(kind) for name, kind in SCHEMA.items()).with_columns(
            pl.col("device").replace(devices)
        ),
        rows=account.rows,
        left_out={printable(reason): count for reason, count in account.left_out.items()},
        notes=tuple(map(printable, account.notes)),
    )


def settled(extract: Extract, frame: pl.DataFrame, answers: Answers, account: Account) -> pl.DataFrame:
    """Rows of one file, of one person, with numbers in the units of the record, within bounds, each with its time."""
    account.files += 1
    account.rows += frame["row"].n_unique()
    account.notes += extract.notes
    frame = frame.with_columns(pl.lit(account.files).alias("file"))
    empty = pl.all_horizontal(
        pl.col(name).is_null() | (pl.col(name).cast(pl.String).str.strip_chars() == "")
        if frame[name].dtype == pl.String
        else pl.col(name).is_null()
        for name in VALUES
    )
    frame = frame.with_columns(_empty=empty & pl.col("out_of_range").is_null())
    if frame["_empty"].any():
        for (kind,), _ in frame.filter("_empty").group_by("kind", maintain_order=True):
            gone = pl.col("_empty") & pl.col("kind").eq_missing(pl.lit(kind))
            frame = account.without(frame, gone, str(kind or NO_VALUE))
    frame = with_numbers(frame, extract, answers, account)
    nothing = pl.all_horizontal(pl.col(name).is_null() for name in COLUMNS.values())
    zero = nothing & pl.col("_zero")
    frame = account.without(frame, zero, NO_VALUE)
    frame = account.without(frame, nothing, UNREADABLE)
    frame = account.without(frame, pl.col("time").is_null(), NO_TIME)
    return frame.select(
        *("file", "row", "kind", "source", "time", "in_utc", "utc_offset_min", *COLUMNS.values()),
        *("bolus_min", "bolus_type", "out_of_range", "device"),
    )


def _without_repeats(frame: pl.DataFrame, account: Account) -> pl.DataFrame:
    """Rows without those that repeat another one, and without a second reading of a device at the same time."""
    about = ("bolus_min", "bolus_type", "out_of_range", "device", "kind")
    alike = ["time", "utc_offset_min", "second_pass", *COLUMNS.values(), *about]
    frame = account.without(frame, ~pl.struct(alike).is_first_distinct(), REPEATED)
    read = pl.col("glucose_mg_dl").is_not_null()
    at = pl.struct("time", "utc_offset_min", "second_pass", "device", source_of().alias("source"), "kind", read)
    second = frame.select(read & ~at.is_first_distinct()).to_series()
    return account.without_value(frame, second, "glucose_mg_dl", SAME_TIME)


def _refuse_impossible_days(frame: pl.DataFrame) -> None:
    """Refuse amounts of a day that a person of any size cannot mean."""
    for name, largest in _LARGEST_DAILY.items():
        if not frame[name].is_not_null().any():
            continue
        days = frame.group_by(day=pl.col("time").dt.date()).agg(amount=pl.col(name).sum()).filter(pl.col("amount") > 0)
        usual = float(days["amount"].median() or 0.0)  # type: ignore[arg-type]
        if usual > largest:
            key, words = _DAILY_WORDS[name]
            raise Refusal(
                f"it has {usual:.0f} {words} on half of its days, which nobody can mean",
                f"say the unit, as file_units='{key}={'mU' if name != 'carbs_g' else '0.1g'}' (--file-units)",
            )


def _on_gaps(frame: pl.DataFrame) -> list[str]:
    """Note on times without readings that are longer than three steps between readings."""
    read = frame.filter(pl.col("glucose_mg_dl").is_not_null()).sort("at")
    steps = read["at"].diff().dt.total_seconds() / S_PER_MIN
    step = steps.filter(steps > 0).median()
    if step is None:
        return []
    gaps = steps > max(3.0 * float(step), _MIN_GAP_MIN)  # type: ignore[arg-type]
    if not gaps.any():
        return []
    longest = int(steps.arg_max() or 0)
    hours = float(steps.filter(gaps).sum()) / MIN_PER_H
    begin, end = clock(read["time"][longest - 1]), clock(read["time"][longest])
    return [
        f"Readings come every {float(step):g} min; "  # type: ignore[arg-type]
        f"{how_many(int(gaps.sum()), 'gap')} of {hours:.1f} h in all, the longest from {begin} to {end}."
    ]
