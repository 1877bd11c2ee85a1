"""Tidy record of a person from the rows of all files: one clock, one sensor, each dose once, in the order of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import polars as pl

from glucoloop.records.answers import MIXED_RATES, UNITS, Answers, unit_factor
from glucoloop.records.clock import on_one_clock
from glucoloop.records.extract import VALUES, Account, Extract
from glucoloop.records.record import HIGHEST_MG_DL, LARGEST_AMOUNTS, LOWEST_MG_DL, SCHEMA, DeviceRecord
from glucoloop.records.streams import each_dose_once, one_sensor, source_of, with_instants
from glucoloop.records.times import FAR_DAYS, clock, far_from_others
from glucoloop.refusal import Refusal
from glucoloop.text import how_many, printable, the_first
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_DAY, MIN_PER_H, S_PER_MIN

NO_VALUE: Final = "rows without glucose, carbohydrate, insulin or glucagon"
UNREADABLE: Final = "rows with values that are no number or not possible"
NO_TIME: Final = "rows without a readable time"
REPEATED: Final = "rows that repeat another one"
SAME_TIME: Final = "readings at the time of another reading of the same device"
FAR: Final = "rows that lie a quarter of a year from all others, as by a wrong clock or year"

_MIN_GAP_MIN: Final = 15.0
_LARGEST_DAILY: Final = {"bolus_U": 600.0, "long_acting_U": 600.0, "carbs_g": 3000.0, "glucagon_ug": 10000.0}
"""Amounts of a day beyond those of any person [U, g, ug]."""
_SMALLER: Final = {"carbs": "0.1g", "glucagon": "ng"}
_LARGEST_BASAL_U_DAY: Final = 300.0
"""Basal insulin of a day beyond that of any person, by the reservoir of a pump."""
_DAILY_WORDS: Final = {
    "bolus_U": ("bolus", "U of boluses"),
    "long_acting_U": ("long_acting", "U of long-acting insulin"),
    "carbs_g": ("carbs", "g of carbohydrate"),
    "glucagon_ug": ("glucagon", "ug of glucagon"),
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
    frame = _without_far_times(frame, account)
    if frame["time"].n_unique() < frame.height:
        frame = _without_repeats(frame, account)
    frame = each_dose_once(with_instants(frame), account)
    frame = one_sensor(frame, answers.device, account)
    _refuse_impossible_days(frame)
    _refuse_impossible_rates(frame)
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
    frame = _with_numbers(frame, extract, answers, account)
    nothing = pl.all_horizontal(pl.col(name).is_null() for name in COLUMNS.values())
    zero = nothing & pl.col("_zero")
    frame = account.without(frame, zero, NO_VALUE)
    frame = account.without(frame, nothing, UNREADABLE)
    frame = account.without(frame, pl.col("time").is_null(), NO_TIME)
    return frame.select(
        *("file", "row", "kind", "source", "time", "in_utc", "utc_offset_min", *COLUMNS.values()),
        *("bolus_min", "bolus_type", "out_of_range", "device"),
    )


def _without_far_times(frame: pl.DataFrame, account: Account) -> pl.DataFrame:
    """Rows without a few that lie a quarter of a year from all others, as of a wrong clock or a mistyped year."""
    far = far_from_others(frame["time"])
    if not far.any():
        return frame
    moments = the_first([clock(time) for time in frame["time"].filter(far).unique().sort()], 3)
    account.notes.append(f"Times over {FAR_DAYS} days from all others are of no use: {moments}.")
    return account.without(frame, pl.lit(far), FAR)


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
                f"say the unit, as file_units='{key}={_SMALLER.get(key, 'mU')}' (--file-units)",
            )


def _refuse_impossible_rates(frame: pl.DataFrame) -> None:
    """Refuse basal rates that are in the mean beyond what a pump can give to a person."""
    rates = frame.filter(pl.col("basal_U_h").is_not_null()).sort("at", maintain_order=True)
    hours = pl.col("at").diff().shift(-1).dt.total_seconds() / (S_PER_MIN * MIN_PER_H)
    known = rates.select(hours=hours, rate="basal_U_h").drop_nulls().filter(pl.col("rate").is_finite())
    span_h = float(known["hours"].sum())
    if span_h < MIN_PER_DAY / MIN_PER_H:
        return
    of_day = float((known["hours"] * known["rate"]).sum()) / span_h * MIN_PER_DAY / MIN_PER_H
    if of_day > _LARGEST_BASAL_U_DAY:
        raise Refusal(
            f"its basal rates make {of_day:.0f} U a day in the mean, and a person gets at most "
            f"{_LARGEST_BASAL_U_DAY:g} U",
            "say the unit, as file_units='basal=mU/h' or file_units='basal=U/day' (--file-units)",
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


COLUMNS: Final = {
    "glucose": "glucose_mg_dl",
    "carbs": "carbs_g",
    "bolus": "bolus_U",
    "long_acting": "long_acting_U",
    "basal": "basal_U_h",
    "glucagon": "glucagon_ug",
}
_WORDS: Final = {
    "glucose": "glucose",
    "carbs": "carbohydrate",
    "bolus": "a bolus",
    "long_acting": "long-acting insulin",
    "basal": "a basal rate",
    "glucagon": "glucagon",
}
_GIVEN: Final = ("carbs", "bolus", "long_acting", "glucagon")
"""Amounts, of which 0 is none."""
_UNIT_OF: Final = {"carbs": "g", "bolus": "U", "long_acting": "U", "basal": "U/h", "glucagon": "ug"}
_IN_CELLS: Final = {
    "mg/dl": "mg/dl",
    "mmol/l": "mmol/l",
    "g": "g|grams?|gramm",
    "U": "i?u|u?i|ie|e|units?",
    "ug": "[u\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}]g|mcg",
    "mg": "mg",
    "U/h": "(i?u|u?i|ie|e|units?) ?(/|per) ?(h|hr|hour)",
}
"""Words for each unit behind a number in a cell."""
_LOW: Final = (
    *("low", "lo", "niedrig", "tief", "bas", "basse", "faible", "bajo", "baja", "basso", "bassa", "laag", "baixo"),
    *("baixa", "lav", "lavt", "låg", "lågt", "niski", "niska", "niskie", "nízká", "nízka", "matala", "alacsony", "<"),
)
_HIGH: Final = (
    *("high", "hi", "hoch", "haut", "haute", "élevé", "élevée", "alto", "alta", "hoog", "høy", "høyt", "høj", "højt"),
    *("hög", "högt", "wysoki", "wysoka", "wysokie", "vysoká", "vysoka", "korkea", "magas", ">"),
)
_ASK_UNIT: Final = "say the unit, as file_units='{name}={example}' (--file-units)"
_EXAMPLES: Final = {"carbs": "10g", "bolus": "mU", "long_acting": "mU", "basal": MIXED_RATES, "glucagon": "ng"}
_IN_MU: Final = (
    f"; if these are in mU/h, file_units='basal={MIXED_RATES}' (--file-units 'basal={MIXED_RATES}') reads them so"
)
_FEW: Final = 3
_HALF: Final = 0.5


def _with_numbers(frame: pl.DataFrame, extract: Extract, answers: Answers, account: Account) -> pl.DataFrame:
    """Rows with the columns of the record in its units; NaN for a basal rate that cannot be used.

    ``_zero`` marks rows with an amount of 0, which is none.
    """
    if frame["glucose"].dtype == pl.String:
        frame = _with_words(frame)
    marked = pl.col("out_of_range").is_not_null() & pl.col("glucose").is_null()
    told = {**_UNIT_OF, **extract.units, **answers.file_units}
    told["glucose"] = answers.glucose_unit or extract.glucose_unit or ""
    of_cells = _unit_of_cells(frame["glucose"])
    if of_cells is not None:
        extract = replace(extract, glucose_unit=of_cells)
        told["glucose"] = of_cells
    frame = _with_units_of_cells(frame, told["glucose"], account)
    numbers = [_numbers(frame[name], _IN_CELLS.get(told[name])).alias(f"_{name}") for name in VALUES]
    frame = frame.with_columns(*numbers, _marked=marked)
    glucose_factor = _glucose_factor(frame["_glucose"], extract, answers)
    lowest, highest = extract.limits_mg_dl
    glucose = pl.col("_glucose") * glucose_factor
    within = glucose.is_between(LOWEST_MG_DL, HIGHEST_MG_DL)
    limit = pl.when(pl.col("out_of_range") == "low").then(lowest).otherwise(highest)
    columns: dict[str, pl.Expr] = {"glucose_mg_dl": pl.when(pl.col("_marked")).then(limit).when(within).then(glucose)}
    largest: dict[str, float] = {}
    for name in VALUES[1:]:
        unit = answers.file_units.get(name) or extract.units.get(name, _UNIT_OF[name])
        if name == "basal" and unit.replace(" ", "") == MIXED_RATES:
            frame = _in_one_unit(frame, account)
        factor = unit_factor(name, unit)
        largest[name] = extract.largest_basal_U_h if name == "basal" else LARGEST_AMOUNTS[name]
        value = pl.col(f"_{name}") * factor
        least = value >= 0 if name == "basal" else value > 0
        possible: pl.Expr = pl.when((least & (value <= largest[name])) | value.is_nan()).then(value)
        if name == "basal":
            there = frame["basal"].is_not_null() & (frame["basal"].cast(pl.String).str.strip_chars() != "")
            unknown = pl.lit(there) & possible.is_null()
            possible = pl.when(unknown).then(float("nan")).otherwise(possible)
        columns[COLUMNS[name]] = possible
    frame = frame.with_columns(**columns)
    frame = frame.with_columns(
        bolus_min=pl.when(
            pl.col("bolus_U").is_not_null() & pl.col("bolus_min").is_between(0.0, MIN_PER_DAY, closed="right")
        ).then(pl.col("bolus_min").cast(pl.Float64)),
        bolus_type=pl.when(pl.col("bolus_U").is_not_null()).then("bolus_type"),
    )
    zero = pl.any_horizontal(pl.col(f"_{name}") == 0 for name in _GIVEN).fill_null(False)
    _tell(frame, glucose_factor, (lowest, highest), largest, account)
    return frame.with_columns(_zero=zero)


def _units_in(glucose: pl.Series) -> pl.Series:
    """Unit behind the number of each cell; null where there is none."""
    return glucose.str.to_lowercase().str.extract(rf"\d\s*({'|'.join(UNITS)})\s*$")


def _unit_of_cells(glucose: pl.Series) -> str | None:
    """Unit that all cells of glucose have behind their number; None if they have none, or both."""
    if glucose.dtype != pl.String or glucose.null_count() == len(glucose):
        return None
    kinds = _units_in(glucose.drop_nulls()).unique().to_list()
    return kinds[0] if len(kinds) == 1 else None


def _with_units_of_cells(frame: pl.DataFrame, unit: str, account: Account) -> pl.DataFrame:
    """Rows in which glucose whose cell has the other unit is in that of the file."""
    if frame["glucose"].dtype != pl.String or not unit:
        return frame
    other = UNITS[1 - UNITS.index(unit)]
    foreign = (_units_in(frame["glucose"]) == other).fill_null(False)
    if not foreign.any():
        return frame
    factor = MG_DL_PER_MMOL_L if unit == UNITS[0] else 1.0 / MG_DL_PER_MMOL_L
    number = _numbers(frame["glucose"], other) * factor
    account.notes.append(f"{how_many(int(foreign.sum()), 'cell')} of glucose in {other}, as the cell says.")
    return frame.with_columns(
        glucose=pl.when(pl.lit(foreign)).then(pl.lit(number).cast(pl.String)).otherwise("glucose")
    )


def _with_words(frame: pl.DataFrame) -> pl.DataFrame:
    """Rows in which words for low and high glucose are marks, not readings."""
    no_number = frame["glucose"].is_not_null() & frame["glucose"].cast(pl.Float64, strict=False).is_null()
    if not no_number.any():
        return frame
    word = pl.col("glucose").str.strip_chars(' "').str.to_lowercase()
    low, high = (word.is_in(words) | word.str.starts_with(words[-1]) for words in (_LOW, _HIGH))
    frame = frame.with_columns(_word=pl.when(low).then(pl.lit("low")).when(high).then(pl.lit("high")))
    return frame.with_columns(
        out_of_range=pl.coalesce("out_of_range", "_word"), glucose=pl.when(pl.col("_word").is_null()).then("glucose")
    )


def _numbers(cells: pl.Series, unit: str | None) -> pl.Series:
    """Numbers of cells, with a comma or a point, and with their unit behind them; null for what is none."""
    if cells.dtype != pl.String:
        return cells.cast(pl.Float64)
    if cells.null_count() == len(cells):
        return cells.cast(pl.Float64)
    plain = cells.cast(pl.Float64, strict=False)
    if plain.null_count() == cells.null_count() and plain.drop_nulls().is_finite().all():
        return plain
    text = pl.col(cells.name).str.strip_chars(' "')
    if unit is not None:
        text = text.str.replace(rf"(?i)^([^a-z]*\d) ?({unit})$", "$1")
    text = pl.when(text.str.contains(r"^[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?$")).then(text)
    return cells.to_frame().select(text.str.replace(",", ".", literal=True).cast(pl.Float64, strict=False)).to_series()


def _glucose_factor(glucose: pl.Series, extract: Extract, answers: Answers) -> float:
    """Factor of glucose to mg/dl; Refusal where the unit isn't known or the readings look like the other one."""
    readings = glucose.drop_nulls().drop_nans()
    if not len(readings):
        return 1.0
    unit = answers.glucose_unit or extract.glucose_unit
    if answers.glucose_unit and extract.glucose_unit and answers.glucose_unit != extract.glucose_unit:
        raise Refusal(
            f"it says itself that glucose is in {extract.glucose_unit}, not in {answers.glucose_unit}",
            "leave out glucose_unit (--glucose-unit)",
        )
    factors = dict(zip(UNITS, (1.0, MG_DL_PER_MMOL_L), strict=True))
    shares = {
        name: float((readings * factor).is_between(LOWEST_MG_DL, HIGHEST_MG_DL).mean() or 0.0)  # type: ignore[arg-type]
        for name, factor in factors.items()
    }
    if unit is None:
        raise Refusal(
            "it does not say whether glucose is in mg/dl or in mmol/l",
            "give glucose_unit (--glucose-unit), as "
            f"{'mmol/l' if shares['mmol/l'] > shares['mg/dl'] else 'mg/dl'} from the look of the numbers",
        )
    other = UNITS[1 - UNITS.index(unit)]
    if shares[unit] < _HALF < shares[other]:
        middle = float(readings.median() or 0.0)  # type: ignore[arg-type]
        raise Refusal(
            f"its glucose is taken as {unit}, but it looks like {other}: half of the readings are below {middle:g}; "
            f"if it is in {other}, say so where the unit is given"
        )
    return factors[unit]


def _in_one_unit(frame: pl.DataFrame, account: Account) -> pl.DataFrame:
    """Rows with basal rates in U/h, of which stretches are in mU/h.

    A rate above what any pump gives is in mU/h, and one below 1 is in U/h, since no pump gives as few mU/h; others are
    as the nearest of these in time.
    """
    rate = pl.col("_basal")
    sure = pl.when(rate > LARGEST_AMOUNTS["basal"]).then(1e-3).when((rate > 0) & (rate < 1)).then(1.0)
    ordered = frame.with_row_index("_place").sort("time", maintain_order=True).with_columns(_sure=sure)
    at = pl.when(pl.col("_sure").is_not_null()).then("time")
    ordered = ordered.with_columns(
        _back=at.forward_fill(),
        _on=at.backward_fill(),
        _before=pl.col("_sure").forward_fill(),
        _after=pl.col("_sure").backward_fill(),
    )
    nearer = (pl.col("time") - pl.col("_back")) <= (pl.col("_on") - pl.col("time"))
    factor = pl.when(nearer.fill_null(pl.col("_after").is_null())).then("_before").otherwise("_after").fill_null(1.0)
    ordered = ordered.with_columns(_factor=factor).sort("_place")
    small = int((ordered["_factor"] != 1.0).filter(ordered["_basal"] > 0).sum())
    if small:
        account.notes.append(
            f"{how_many(small, 'basal rate')} in mU/h {'was' if small == 1 else 'were'} brought to U/h."
        )
    return ordered.with_columns(_basal=pl.col("_basal") * pl.col("_factor")).drop(
        "_place", "_sure", "_back", "_on", "_before", "_after", "_factor"
    )


def _tell(
    frame: pl.DataFrame,
    factor: float,
    limits: tuple[float, float],
    largest: Mapping[str, float],
    account: Account,
) -> None:
    """Note what was changed in the values of a file; Refusal where most amounts are none that a person can mean."""
    if factor != 1.0:
        account.notes.append(f"Glucose was brought from mmol/l to mg/dl, times {factor:g}.")
    texts = [name for name in VALUES if frame[name].dtype == pl.String and frame[name].null_count() < frame.height]
    if any(frame[name].str.contains(",", literal=True).any() for name in texts):
        account.notes.append("Commas in numbers were read as decimal commas.")
    for mark, limit in zip(("low", "high"), limits, strict=True):
        count = frame.filter(pl.col("_marked") & (pl.col("out_of_range") == mark)).height
        if count:
            account.notes.append(
                f"{how_many(count, 'reading')} {'is' if count == 1 else 'are'} {mark} without a number and "
                f"stand{'s' if count == 1 else ''} at {limit:g} mg/dl."
            )
    for name in VALUES:
        if frame[name].null_count() == frame.height:
            continue
        number = frame[f"_{name}"]
        text = frame[name].is_not_null() & number.is_null()
        if text.any():
            text = text & (frame[name].cast(pl.String).str.strip_chars() != "")
        no_number = int(text.sum())
        kept = frame[COLUMNS[name]]
        outside = number.is_finite().fill_null(False) & (kept.is_null() | kept.is_nan().fill_null(False))
        outside = outside & (number != 0) if name in _GIVEN else outside
        unknown = "; the basal rate is not known from there on" if name == "basal" else ""
        if no_number:
            account.notes.append(
                f"{how_many(no_number, 'cell')} of {_WORDS[name]} hold{'s' * (no_number == 1)} no number{unknown}."
            )
        if not outside.any():
            continue
        bounds = f"{LOWEST_MG_DL:g} to {HIGHEST_MG_DL:g} mg/dl" if name == "glucose" else f"0 to {largest[name]:g}"
        worst = number.filter(outside)
        ends = f"{float(worst.min() or 0.0):g} to {float(worst.max() or 0.0):g}"  # type: ignore[arg-type]
        ask = _ASK_UNIT.format(name=name, example=_EXAMPLES.get(name, ""))
        count = int(outside.sum())
        if name != "glucose" and count >= _FEW and count > _HALF * int((number > 0).sum()):
            raise Refusal(
                f"{count} of its values of {_WORDS[name]} are outside of {bounds} {_UNIT_OF[name]} (from {ends}), "
                "which nobody can mean",
                ask,
            )
        account.notes.append(
            f"{how_many(count, 'value')} of {_WORDS[name]} outside of {bounds} (from {ends} in the unit of the file) "
            f"{'was' if count == 1 else 'were'} not used{unknown}{_IN_MU if name == 'basal' else ''}."
        )
