"""Tidy record from what the reader of each file found: numbers, units, bounds, repeated rows, gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.extract import VALUES, Extract
from glucoloop.records.record import HIGHEST_MG_DL, LARGEST_AMOUNTS, LOWEST_MG_DL, SCHEMA, DeviceRecord
from glucoloop.records.times import clock, settled_clock
from glucoloop.refusal import Refusal
from glucoloop.text import how_many, printable
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, S_PER_MIN

NO_VALUE: Final = "rows without glucose, carbohydrate or insulin"
UNREADABLE: Final = "rows with values that are no number or not possible"
NO_TIME: Final = "rows without a readable time"
REPEATED: Final = "rows that repeat another one"
SAME_TIME: Final = "readings at the time of another reading of the same device"

_WORDS: Final = {"glucose": "glucose", "carbs": "carbohydrate", "bolus": "a bolus", "basal": "a basal rate"}
_COLUMNS: Final = {"glucose": "glucose_mg_dl", "carbs": "carbs_g", "bolus": "bolus_U", "basal": "basal_U_h"}
_LOW: Final = "low", "lo", "niedrig", "tief", "bas", "bajo", "basso", "laag", "baixo", "lav", "låg", "<"
_HIGH: Final = "high", "hi", "hoch", "haut", "élevé", "alto", "hoog", "høy", "høj", "hög", ">"
_MIN_GAP_MIN: Final = 15.0


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


def record_of(frames: Sequence[pl.DataFrame], account: Account) -> DeviceRecord:
    """Record of one person from the settled rows of one file or several; Refusal if there is nothing to use."""
    frame = pl.concat(frames)
    if not frame.height:
        seen = ", ".join(f"{reason} ({count})" for reason, count in account.left_out.items())
        raise Refusal(
            f"nothing in it can be used: it has {how_many(account.rows, 'row')}{f', of which {seen}' if seen else ''}; "
            "give a file with readings, meals or insulin"
        )
    if frame["time"].n_unique() < frame.height:
        alike = ["time", "utc_offset_min", "second_pass", *_COLUMNS.values(), "out_of_range", "device", "kind"]
        frame = account.without(frame, ~pl.struct(alike).is_first_distinct(), REPEATED)
        read = pl.col("glucose_mg_dl").is_not_null()
        at = pl.struct("time", "utc_offset_min", "second_pass", "device", "kind", read)
        frame = account.without(frame, read & ~at.is_first_distinct(), SAME_TIME)
    frame = frame.sort("time", "second_pass", maintain_order=True)
    account.notes += [f"Left out: {reason} ({count})." for reason, count in account.left_out.items()]
    account.notes += [*_on_devices(frame), *_on_gaps(frame)]
    devices = {name: printable(name) for name in frame["device"].drop_nulls().unique()}
    return DeviceRecord(
        frame=frame.select(pl.col(name).cast(kind) for name, kind in SCHEMA.items()).with_columns(
            pl.col("device").replace(devices)
        ),
        rows=account.rows,
        left_out={printable(reason): count for reason, count in account.left_out.items()},
        notes=tuple(map(printable, account.notes)),
    )


def settled(extract: Extract, answers: Answers, account: Account) -> pl.DataFrame:
    """Rows of one file with numbers in the units of the record, within bounds, each with its time."""
    account.files += 1
    account.rows += extract.frame["row"].n_unique()
    account.notes += extract.notes
    frame = extract.frame.with_columns(pl.lit(account.files).alias("file"))
    empty = (
        pl.all_horizontal(
            pl.col(name).is_null() | (pl.col(name).cast(pl.String).str.strip_chars() == "") for name in VALUES
        )
        & pl.col("out_of_range").is_null()
    )
    for (kind,), _ in frame.filter(empty).group_by("kind", maintain_order=True):
        frame = account.without(frame, empty & pl.col("kind").eq_missing(pl.lit(kind)), str(kind or NO_VALUE))
    frame = _with_numbers(frame, extract, answers, account)
    nothing = pl.all_horizontal(pl.col(name).is_null() for name in _COLUMNS.values())
    zero = nothing & pl.col("_zero")
    frame = account.without(frame, zero, NO_VALUE)
    frame = account.without(frame, nothing, UNREADABLE)
    frame = account.without(frame, pl.col("time").is_null(), NO_TIME)
    frame, notes = settled_clock(frame, answers)
    account.notes += notes
    return frame.select(
        *("file", "row", "kind", "second_pass", "time", "utc_offset_min", *_COLUMNS.values(), "out_of_range", "device")
    )


def _with_numbers(frame: pl.DataFrame, extract: Extract, answers: Answers, account: Account) -> pl.DataFrame:
    if frame["glucose"].dtype == pl.String:
        word = pl.col("glucose").str.strip_chars(' "').str.to_lowercase()
        low, high = (word.is_in(words) | word.str.starts_with(words[-1]) for words in (_LOW, _HIGH))
        mark = pl.when(low).then(pl.lit("low")).when(high).then(pl.lit("high"))
        frame = frame.with_columns(_word=mark)
        frame = frame.with_columns(
            out_of_range=pl.coalesce("out_of_range", "_word"),
            glucose=pl.when(pl.col("_word").is_null()).then("glucose"),
        )
    marked = pl.col("out_of_range").is_not_null() & pl.col("glucose").is_null()
    frame = frame.with_columns(*(_number(name, frame[name].dtype) for name in VALUES), _marked=marked)
    factor = _factor(frame["_glucose"], extract, answers)
    lowest, highest = extract.limits_mg_dl
    glucose = pl.col("_glucose") * factor
    within = glucose.is_between(LOWEST_MG_DL, HIGHEST_MG_DL)
    limit = pl.when(pl.col("out_of_range") == "low").then(lowest).otherwise(highest)
    columns: dict[str, pl.Expr] = {"glucose_mg_dl": pl.when(pl.col("_marked")).then(limit).when(within).then(glucose)}
    for name, most in LARGEST_AMOUNTS.items():
        value = pl.col(f"_{name}")
        least = value >= 0 if name == "basal" else value > 0
        columns[_COLUMNS[name]] = pl.when((least & (value <= most)) | value.is_nan()).then(value)
    frame = frame.with_columns(**columns)
    zero = pl.any_horizontal(pl.col("_carbs") == 0, pl.col("_bolus") == 0).fill_null(False)
    _tell(frame, factor, (lowest, highest), account)
    return frame.with_columns(_zero=zero)


def _number(name: str, kind: pl.DataType) -> pl.Expr:
    """Number of a cell, with a comma or a point; null for what is none."""
    if kind != pl.String:
        return pl.col(name).cast(pl.Float64).alias(f"_{name}")
    text = pl.col(name).str.strip_chars(' "')
    text = pl.when(text.str.contains(r"^[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?$")).then(text)
    return text.str.replace(",", ".", literal=True).cast(pl.Float64, strict=False).alias(f"_{name}")


def _factor(glucose: pl.Series, extract: Extract, answers: Answers) -> float:
    """Factor of glucose to mg/dl; Refusal where the unit isn't known or the readings look like the other one."""
    given = glucose.drop_nulls().drop_nans()
    if not len(given):
        return 1.0
    unit = answers.glucose_unit or extract.glucose_unit
    if answers.glucose_unit and extract.glucose_unit and answers.glucose_unit != extract.glucose_unit:
        raise Refusal(
            f"it says itself that glucose is in {extract.glucose_unit}, not in {answers.glucose_unit}",
            "leave out glucose_unit (--glucose-unit)",
        )
    factors = dict(zip(UNITS, (1.0, MG_DL_PER_MMOL_L), strict=True))
    shares = {
        name: float((given * factor).is_between(LOWEST_MG_DL, HIGHEST_MG_DL).mean() or 0.0)  # type: ignore[arg-type]
        for name, factor in factors.items()
    }
    if unit is None:
        raise Refusal(
            "it does not say whether glucose is in mg/dl or in mmol/l",
            "give glucose_unit (--glucose-unit), as "
            f"{'mmol/l' if shares['mmol/l'] > shares['mg/dl'] else 'mg/dl'} from the look of the numbers",
        )
    other = UNITS[1 - UNITS.index(unit)]
    if shares[unit] < 0.5 < shares[other]:
        middle = float(given.median() or 0.0)  # type: ignore[arg-type]
        raise Refusal(
            f"its glucose is taken as {unit}, but it looks like {other}: half of the readings are below {middle:g}; "
            f"if it is in {other}, say so where the unit is given"
        )
    return factors[unit]


def _tell(frame: pl.DataFrame, factor: float, limits: tuple[float, float], account: Account) -> None:
    """Note what was changed in the values of a file."""
    if factor != 1.0:
        account.notes.append(f"Glucose was brought from mmol/l to mg/dl, times {factor:g}.")
    if any(frame[name].dtype == pl.String and frame[name].str.contains(",", literal=True).any() for name in VALUES):
        account.notes.append("Commas in numbers were read as decimal commas.")
    for mark, limit in zip(("low", "high"), limits, strict=True):
        count = frame.filter(pl.col("_marked") & (pl.col("out_of_range") == mark)).height
        if count:
            account.notes.append(
                f"{how_many(count, 'reading')} {'is' if count == 1 else 'are'} {mark} without a number and "
                f"stand{'s' if count == 1 else ''} at {limit:g} mg/dl."
            )
    for name in VALUES:
        text = frame[name].cast(pl.String).str.strip_chars().fill_null("") != ""
        number = frame[f"_{name}"]
        no_number = int((text & number.is_null()).sum())
        kept = frame[_COLUMNS[name]]
        outside = number.is_not_null() & kept.is_null()
        outside = outside & (number != 0) if name in ("carbs", "bolus") else outside
        if no_number:
            account.notes.append(
                f"{how_many(no_number, 'cell')} of {_WORDS[name]} hold{'s' * (no_number == 1)} no number."
            )
        if outside.any():
            bounds = (
                f"{LOWEST_MG_DL:g} to {HIGHEST_MG_DL:g} mg/dl"
                if name == "glucose"
                else f"0 to {LARGEST_AMOUNTS[name]:g}"
            )
            worst = number.filter(outside)
            ends = f"{float(worst.min() or 0.0):g} to {float(worst.max() or 0.0):g}"  # type: ignore[arg-type]
            account.notes.append(
                f"{how_many(int(outside.sum()), 'value')} of {_WORDS[name]} outside of {bounds} "
                f"(from {ends} in the unit of the file) were not used."
            )


def _on_devices(frame: pl.DataFrame) -> list[str]:
    """Notes on glucose from more than one device."""
    read = frame.filter(pl.col("glucose_mg_dl").is_not_null() & pl.col("device").is_not_null())
    each = read.group_by("device").agg(
        pl.len(), pl.col("time").min().alias("first"), pl.col("time").max().alias("last")
    )
    each = each.sort("first")
    if each.height < 2:
        return []
    named = ", ".join(f"{device} ({count})" for device, count in each.select("device", "len").iter_rows())
    overlap = (each["first"].shift(-1) < each["last"].cum_max()).any()
    beside = "; they overlap in time, so choose one by the column device where each minute must count once"
    return [f"Glucose comes from {each.height} devices: {named}{beside if overlap else ''}."]


def _on_gaps(frame: pl.DataFrame) -> list[str]:
    """Note on times without readings that are longer than three steps between readings."""
    read = frame.filter(pl.col("glucose_mg_dl").is_not_null())
    known = not read["utc_offset_min"].is_null().any()
    at = pl.col("time") - pl.duration(minutes=pl.col("utc_offset_min") if known else 0)
    times = read.select("time", at=at).sort("at")
    steps = times["at"].diff().dt.total_seconds() / S_PER_MIN
    step = steps.filter(steps > 0).median()
    if step is None:
        return []
    gaps = steps > max(3.0 * float(step), _MIN_GAP_MIN)  # type: ignore[arg-type]
    if not gaps.any():
        return []
    longest = int(steps.arg_max() or 0)
    hours = float(steps.filter(gaps).sum()) / MIN_PER_H
    begin, end = clock(times["time"][longest - 1]), clock(times["time"][longest])
    return [
        f"Readings come every {float(step):g} min; "  # type: ignore[arg-type]
        f"{how_many(int(gaps.sum()), 'gap')} of {hours:.1f} h in all, the longest from {begin} to {end}."
    ]
