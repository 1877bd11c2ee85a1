"""Days of a record as a simulation takes them: insulin in samples of 5 min, meals, and readings, with their times."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.records import DeviceRecord
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, MU_PER_U, S_PER_MIN

Values = npt.NDArray[np.float64]

SAMPLE_MIN: Final = 5.0
_SAMPLES_PER_DAY: Final = round(MIN_PER_DAY / SAMPLE_MIN)
_LONGEST_GAP_MIN: Final = MIN_PER_DAY
"""Time without readings after which a record begins again: what happened before says nothing of the state after."""
_FEWEST_MEALS: Final = 3
FEWEST_READINGS: Final = 100
_MEALS_TOGETHER: Final = 32
"""Meals are filled up with meals of 0 g to a multiple of this, so that few programs are compiled."""


@dataclass(frozen=True, kw_only=True)
class RecordedDays:
    """A stretch of a record; times in minutes from its first sample."""

    first: dt.datetime
    """Local time of the first sample."""
    days: int
    """Number of days simulated, the last of which may be incomplete."""
    first_mg_dl: float
    """First reading of the stretch."""
    insulin_mU_min: Values
    """``(samples,)`` basal rate and boluses of each sample."""
    meal_min: Values
    carbs_g: Values
    """``(meals,)`` times and carbohydrate of meals; those of 0 g are none."""
    reading_min: Values
    reading_mg_dl: Values
    """Readings ``(readings,)`` at increasing times."""
    bolus_U: float
    """Insulin of all boluses."""
    basal_U: float
    """All basal insulin."""
    length_min: float
    """Time from the first sample to the last reading."""
    notes: tuple[str, ...] = ()

    @property
    def clock_min(self) -> float:
        """Time of day of the first sample, after midnight."""
        return self.first.hour * MIN_PER_H + self.first.minute + self.first.second / S_PER_MIN

    @property
    def meals(self) -> int:
        """Number of meals."""
        return int(np.count_nonzero(self.carbs_g))

    @property
    def total_daily_dose_U(self) -> float:
        """Insulin of a day."""
        return (self.bolus_U + self.basal_U) * MIN_PER_DAY / self.length_min

    @property
    def carb_ratio_g_U(self) -> float | None:
        """Carbohydrate for each unit of all boluses, which holds corrections too; None without boluses."""
        return float(self.carbs_g.sum()) / self.bolus_U if self.bolus_U > 0.0 else None

    def meals_from(self, begin_min: float) -> list[tuple[float, float]]:
        """Time and carbohydrate of each meal from a time on."""
        eaten = (self.carbs_g > 0.0) & (self.meal_min >= begin_min)
        return list(zip(self.meal_min[eaten].tolist(), self.carbs_g[eaten].tolist(), strict=True))

    def active_share(self, begin_min: float, end_min: float) -> float:
        """Share of the samples of a time in which there is a reading."""
        inside = self.reading_min[(self.reading_min >= begin_min) & (self.reading_min < end_min)]
        return np.unique(inside // SAMPLE_MIN).size / max(1.0, (end_min - begin_min) / SAMPLE_MIN)

    def at_readings(self, trajectory: Values, chosen: npt.NDArray[np.bool_]) -> Values:
        """Values ``(..., readings)`` at the times of chosen readings, of a trajectory ``(..., samples + 1)``."""
        place, share = np.divmod(self.reading_min[chosen] / SAMPLE_MIN, 1.0)
        at = place.astype(int)
        with np.errstate(invalid="ignore"):  # a person who cannot be has no finite glucose
            result: Values = (1.0 - share) * trajectory[..., at] + share * trajectory[..., at + 1]
        return result


def recorded_days(record: DeviceRecord, *, most_days: int = 14, basal_U_h: float | None = None) -> RecordedDays:
    """Last days of a record.

    Parameters
    ----------
    record : DeviceRecord
        Record with readings, carbohydrate, boluses and basal rates.
    most_days : int
        Number of days at most; of a longer record the last ones are taken.
    basal_U_h : float, optional
        Basal rate where the record tells none.

    Raises
    ------
    Refusal
        If there are too few readings or meals, no boluses, or no basal rate.
    """
    frame, notes = record.frame, list[str]()
    offset = pl.col("utc_offset_min")
    if not frame["utc_offset_min"].null_count():
        known = int(frame["utc_offset_min"][-1])
        frame = frame.with_columns(time=pl.col("time") + pl.duration(minutes=known - offset)).sort("time")
    usable = pl.col("glucose_mg_dl").is_finite() & pl.col("out_of_range").is_null()
    readings = frame.filter(usable).unique("time", keep="first", maintain_order=True)
    marked = frame.filter(pl.col("out_of_range").is_not_null()).height
    if marked:
        notes.append(f"{how_many(marked, 'reading')} beyond the range of the sensor were not used.")
    if readings.height < FEWEST_READINGS:
        raise Refusal(f"it has {how_many(readings.height, 'reading')}; a twin needs {FEWEST_READINGS} or more")
    readings, first = _last_stretch(readings, most_days, notes)
    last = readings["time"][-1]
    end_min = _minutes(last, first)
    days = max(1, int(np.ceil((end_min + SAMPLE_MIN) / MIN_PER_DAY)))
    edges = SAMPLE_MIN * np.arange(days * _SAMPLES_PER_DAY + 1, dtype=np.float64)
    inside = frame.filter((pl.col("time") >= first) & (pl.col("time") <= last))
    meals = inside.filter(pl.col("carbs_g") > 0.0)
    boluses = inside.filter(pl.col("bolus_U") > 0.0)
    if meals.height < _FEWEST_MEALS:
        raise Refusal(
            f"it has {how_many(meals.height, 'meal')} from {first:%Y-%m-%d} to {last:%Y-%m-%d}; a twin is found from "
            f"{_FEWEST_MEALS} meals or more with their carbohydrate"
        )
    pens = frame.filter(pl.col("long_acting_U") > 0.0, pl.col("time") <= last)
    if basal_U_h is None and pens.height and not frame["basal_U_h"].is_finite().any():
        basal = _pens_mU(pens, first, edges, notes)
    else:
        basal = _basal_mU(frame, first, edges, basal_U_h, end_min, notes)
        if (named := pens.filter(pl.col("time") >= first)).height:
            notes.append(
                f"{how_many(named.height, 'dose')} of long-acting insulin, {named['long_acting_U'].sum():g} U, did not "
                "count beside the basal rate."
            )
    if not boluses.height and not np.ptp(basal):
        raise Refusal(
            "it has neither boluses nor a basal rate that changes, so it does not tell how insulin acts; give a record "
            "with insulin"
        )
    extended = pl.col("bolus_min").fill_null(0.0) > 0.0
    at_once = boluses.filter(~extended)
    bolus_mU = np.zeros(edges.size - 1)
    at = (_all_minutes(at_once, first) // SAMPLE_MIN).astype(int)
    np.add.at(bolus_mU, at, MU_PER_U * at_once["bolus_U"].to_numpy())
    spread = frame.filter(pl.col("bolus_U") > 0.0, extended, pl.col("time") <= last)
    spread_mU = _spread_mU(_all_minutes(spread, first), spread["bolus_min"], spread["bolus_U"], edges)
    counted = edges[:-1] < end_min
    empty = -meals.height % _MEALS_TOGETHER
    return RecordedDays(
        first=first,
        days=days,
        first_mg_dl=float(readings["glucose_mg_dl"].head(3).median()),  # type: ignore[arg-type]
        insulin_mU_min=(basal + bolus_mU + spread_mU) / SAMPLE_MIN,
        meal_min=np.append(_all_minutes(meals, first), np.zeros(empty)),
        carbs_g=np.append(meals["carbs_g"].to_numpy(), np.zeros(empty)),
        reading_min=_all_minutes(readings, first),
        reading_mg_dl=readings["glucose_mg_dl"].to_numpy(),
        bolus_U=float(at_once["bolus_U"].sum()) + float(spread_mU.sum()) / MU_PER_U,
        basal_U=float(basal[counted].sum() / MU_PER_U),
        length_min=end_min,
        notes=tuple(notes),
    )


def _last_stretch(readings: pl.DataFrame, most_days: int, notes: list[str]) -> tuple[pl.DataFrame, dt.datetime]:
    """Readings after the last long gap and within the last days, and the time of the first sample."""
    steps_min = readings["time"].diff().dt.total_seconds().to_numpy() / S_PER_MIN
    gaps = np.flatnonzero(steps_min > _LONGEST_GAP_MIN)
    if gaps.size:
        readings = readings[int(gaps[-1]) :]
        notes.append(
            f"Only what follows {readings['time'][0]:%Y-%m-%d %H:%M} was used: there are no readings for "
            f"{steps_min[gaps[-1]] / MIN_PER_H:.0f} h before it."
        )
    begin = readings["time"][-1] - dt.timedelta(days=most_days)
    if readings["time"][0] < begin:
        readings = readings.filter(pl.col("time") >= begin)
        notes.append(f"The last {how_many(most_days, 'day')} were used.")
    if readings.height < FEWEST_READINGS:
        raise Refusal(
            f"it has {how_many(readings.height, 'reading')} without a gap of {_LONGEST_GAP_MIN / MIN_PER_H:.0f} h; a "
            f"twin needs {FEWEST_READINGS} or more"
        )
    first = readings["time"][0]
    return readings, first.replace(second=0, microsecond=0)


def _spread_mU(begin_min: Values, span_min: pl.Series, doses_U: pl.Series, edges: Values) -> Values:
    """Insulin of each sample [mU] of doses that are each given evenly over a time."""
    result: Values = np.zeros(edges.size - 1)
    for begin, span, dose in zip(begin_min, span_min, doses_U, strict=True):
        result += MU_PER_U * dose * np.diff(np.clip((edges - begin) / span, 0.0, 1.0))
    return result


def _pens_mU(pens: pl.DataFrame, first: dt.datetime, edges: Values, notes: list[str]) -> Values:
    """Long-acting insulin of each sample [mU], each dose given evenly over the 24 h after it."""
    begins, doses = _all_minutes(pens, first), pens["long_acting_U"]
    recent = begins > -MIN_PER_DAY
    notes.append(
        f"{how_many(int(np.count_nonzero(recent)), 'dose')} of long-acting insulin stand for the basal rate, each as "
        "an even rate over the 24 h after it."
    )
    if begins[0] > 0.0:  # the day before the first one had the same
        day = begins - begins[0] < MIN_PER_DAY
        doses = pl.concat([doses.filter(pl.Series(day)), doses])
        begins = np.append(begins[day] - MIN_PER_DAY, begins)
    return _spread_mU(begins, pl.repeat(MIN_PER_DAY, doses.len(), eager=True), doses, edges)


def _basal_mU(
    frame: pl.DataFrame, first: dt.datetime, edges: Values, instead_U_h: float | None, end_min: float, notes: list[str]
) -> Values:
    """Basal insulin of each sample [mU]."""
    rates = frame.filter(pl.col("basal_U_h").is_not_null()).unique("time", keep="last", maintain_order=True)
    rates = rates.filter(pl.col("time") < first + dt.timedelta(minutes=end_min))
    rate, begins = rates["basal_U_h"].to_numpy(), _all_minutes(rates, first)
    if not np.isfinite(rate).any() and instead_U_h is None:
        raise Refusal(
            "it tells no basal rate; give it with --basal, like --basal 0.8, or spread a daily dose of long-acting "
            "insulin over 24 h"
        )
    before = np.searchsorted(begins, 0.0, side="right") - 1
    within = slice(max(before, 0), None)
    rate, begins = rate[within], np.maximum(begins[within], 0.0)
    if not rate.size or begins[0] > 0.0:
        rate, begins = np.insert(rate, 0, np.nan), np.insert(begins, 0, 0.0)
    ends = np.append(begins[1:], edges[-1])
    length = np.clip(np.minimum(ends, end_min) - begins, 0.0, None)
    unknown = ~np.isfinite(rate)
    if unknown.any():
        known = ~unknown & (length > 0.0)
        if instead_U_h is None:
            instead_U_h = (
                float(np.average(rate[known], weights=length[known]))
                if known.any()
                else float(rates["basal_U_h"].drop_nans()[-1])
            )
        rate = np.where(unknown, instead_U_h, rate)
        hours = length[unknown].sum() / MIN_PER_H
        if hours >= 1.0:
            notes.append(f"The record tells no basal rate for {hours:.0f} h; {instead_U_h:.2f} U/h were taken.")
    elif instead_U_h is not None:
        notes.append("The basal rate that was given has no effect: the record tells one at all times.")
    given = np.append(0.0, np.cumsum(rate * (ends - begins))) * MU_PER_U / MIN_PER_H
    basal: Values = np.diff(np.interp(edges, np.append(begins, edges[-1]), given))
    return basal


def _minutes(time: dt.datetime, first: dt.datetime) -> float:
    return (time - first).total_seconds() / S_PER_MIN


def _all_minutes(frame: pl.DataFrame, first: dt.datetime) -> Values:
    minutes: Values = (frame["time"] - first).dt.total_milliseconds().to_numpy() / (1000.0 * S_PER_MIN)
    return minutes
