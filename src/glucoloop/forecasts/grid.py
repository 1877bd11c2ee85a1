"""A record on a grid of 5 min from midnight to midnight, as forecasts take it, and its usual day.

Each sample holds what happened within the 5 min that end with it, so that nothing of a sample is later than its time.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from glucoloop._lazy_jax import np
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, S_PER_MIN

if TYPE_CHECKING:
    import numpy.typing as npt
    import polars as pl

    from glucoloop.records import DeviceRecord

    Values = npt.NDArray[np.float64]
    Places = npt.NDArray[np.int64]

SAMPLE_MIN: Final = 5.0
SAMPLES_PER_DAY: Final = round(MIN_PER_DAY / SAMPLE_MIN)
HARMONICS: Final = 4
_WAVE_SD_MG_DL: Final = 20.0
_MIN_READINGS_OF_A_DAY: Final = 24
"""Readings with which a day counts as one: two hours of them, or a day of one an hour."""
_SAME_RATE: Final = 0.05
"""Relative difference from its median at that time of day within which a basal rate is that of a schedule."""
_MAX_OFF_SCHEDULE_PCT: Final = 40.0
"""Part of the time off its schedule that temporary rates of a user can make up; more is of automation."""
_WITH_CARBS_MIN: Final = 30.0
"""Time between carbohydrate and a bolus that belong together."""


@dataclass(frozen=True, kw_only=True)
class GriddedRecord:
    """A record of whole days in samples of 5 min; all arrays are ``(samples,)``."""

    first: dt.datetime
    """Local time of midnight at which the first day begins; the first sample ends 5 min later."""
    reading_mg_dl: Values
    """Last reading of each sample; NaN where there is none."""
    basal_U: Values
    """Basal and long-acting insulin of each sample."""
    user_bolus_U: Values
    """Boluses of the user."""
    automatic_bolus_U: Values
    """Boluses of automation: under automation, those without carbohydrate within 30 min."""
    carbs_g: Values
    basal_off_schedule_pct: float
    """Part of the time in which the basal rate is not its median at that time of day."""
    notes: tuple[str, ...] = ()

    @property
    def automated(self) -> bool:
        """Whether automation doses: by its boluses, or over 40 % of the time off the median rate of the time of day."""
        return self.basal_off_schedule_pct > _MAX_OFF_SCHEDULE_PCT or bool(self.automatic_bolus_U.any())

    @property
    def days(self) -> int:
        """Number of days."""
        return self.reading_mg_dl.size // SAMPLES_PER_DAY

    @property
    def clock(self) -> Places:
        """Time of day of each sample, in samples from midnight."""
        return np.arange(self.reading_mg_dl.size) % SAMPLES_PER_DAY

    @property
    def insulin_U(self) -> Values:
        """All insulin of each sample."""
        result: Values = self.basal_U + self.user_bolus_U + self.automatic_bolus_U
        return result

    @property
    def total_daily_dose_U(self) -> float:
        """Insulin of a day."""
        return float(self.insulin_U.sum()) / self.days

    @property
    def automatic_insulin_pct(self) -> float:
        """Percentage of the insulin that automation dosed: its basal rate and its boluses; 0 without automation."""
        total = float(self.insulin_U.sum())
        if not (self.automated and total > 0.0):
            return 0.0
        return 100.0 * float((self.basal_U + self.automatic_bolus_U).sum()) / total

    @property
    def days_with_readings(self) -> int:
        """Number of days with 24 readings or more."""
        readings = np.isfinite(self.reading_mg_dl).reshape(self.days, -1).sum(axis=1)
        return int((readings >= _MIN_READINGS_OF_A_DAY).sum())

    def of_days(self, begin: int, end: int) -> GriddedRecord:
        """The days from one to before another one, counted from 0."""
        inside = slice(begin * SAMPLES_PER_DAY, end * SAMPLES_PER_DAY)
        return self._with_arrays(lambda values, _: values[inside], first=self.first + dt.timedelta(days=begin))

    def padded(self, samples: int) -> GriddedRecord:
        """The record with some samples after its end, in which there is nothing."""
        more = max(samples, 0)
        return self._with_arrays(lambda values, empty: np.append(values, np.full(more, empty)))

    def _with_arrays(self, change: Callable[[Values, float], Values], **others: Any) -> GriddedRecord:
        """The record with each array changed; the second argument is its value where there is nothing."""
        arrays: dict[str, Any] = {
            name: change(values, np.nan if name == "reading_mg_dl" else 0.0)
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }
        return dataclasses.replace(self, **arrays, **others)


def gridded_record(record: DeviceRecord, *, most_days: int = 28) -> GriddedRecord:
    """Last days of a record on the grid.

    Times are those of the clock on the wall at the end of the record, where the record knows its offsets from UTC. A
    reading beyond the range of the sensor counts as its limit. Where the basal rate is not known, it is its median at
    that time of day. A bolus over a time is given over it, and long-acting insulin over the 24 h from its injection.

    Parameters
    ----------
    record : DeviceRecord
        Record with readings; carbohydrate and insulin may be missing.
    most_days : int
        Number of days at most, the one of the last reading included.

    Raises
    ------
    Refusal
        If there is no reading.
    """
    import polars as pl

    frame = record.frame
    if not frame["utc_offset_min"].null_count():
        offset = int(frame["utc_offset_min"][-1])
        frame = frame.with_columns(time=pl.col("time") + pl.duration(minutes=offset - pl.col("utc_offset_min"))).sort(
            "time"
        )
    readings = frame.filter(pl.col("glucose_mg_dl").is_finite())
    if not readings.height:
        raise Refusal("it has no reading; give a record with those of a sensor")
    begin = _midnight_of(readings["time"][0])
    last = readings["time"][-1] - dt.timedelta(microseconds=1)  # midnight itself is the end of a day
    midnight = max(begin, _midnight_of(last))
    first = max(begin, midnight - dt.timedelta(days=most_days - 1))
    days = (midnight - first).days + 1
    samples = days * SAMPLES_PER_DAY
    notes = list[str]()
    if begin < first:
        notes.append(f"The last {how_many(days, 'day')} were used.")

    glucose = np.full(samples, np.nan)
    at, inside = _samples_of(readings, first, samples)
    glucose[at] = readings["glucose_mg_dl"].to_numpy()[inside]  # the last one of a sample stays

    carbs = _summed(frame, "carbs_g", first, samples)
    glucagon = frame.filter((pl.col("glucagon_ug") > 0.0) & pl.col("time").is_between(first, last))["glucagon_ug"]
    if glucagon.len():
        notes.append(
            f"The record has {how_many(glucagon.len(), 'dose')} of glucagon, {glucagon.sum():.4g} ug in all, which no "
            "forecast and no twin knows: the rise of glucose after them is taken for something else."
        )
    basal, off_schedule_pct = _basal_of(frame, first, days, notes)
    user, automatic = _boluses_of(frame, first, carbs, automated=off_schedule_pct > _MAX_OFF_SCHEDULE_PCT)
    return GriddedRecord(
        first=first,
        reading_mg_dl=glucose,
        basal_U=basal,
        user_bolus_U=user,
        automatic_bolus_U=automatic,
        carbs_g=carbs,
        basal_off_schedule_pct=off_schedule_pct,
        notes=tuple(notes),
    )


def _midnight_of(time: dt.datetime) -> dt.datetime:
    return time.replace(hour=0, minute=0, second=0, microsecond=0)


def _minutes(frame: pl.DataFrame, first: dt.datetime) -> Values:
    result: Values = (frame["time"] - first).dt.total_milliseconds().to_numpy() / (1000.0 * S_PER_MIN)
    return result


def _samples_of(frame: pl.DataFrame, first: dt.datetime, samples: int) -> tuple[Places, npt.NDArray[np.bool_]]:
    """Sample of each row that lies within the days, and which rows do."""
    at = np.ceil(_minutes(frame, first) / SAMPLE_MIN).astype(np.int64) - 1
    at = np.where(at < 0, np.where(at == -1, 0, -1), at)  # midnight itself belongs to the day that it begins
    inside = (at >= 0) & (at < samples)
    return at[inside], inside


def _summed(frame: pl.DataFrame, column: str, first: dt.datetime, samples: int) -> Values:
    """Sum of an amount in each sample."""
    import polars as pl

    rows = frame.filter(pl.col(column) > 0.0)
    at, inside = _samples_of(rows, first, samples)
    result = np.zeros(samples)
    np.add.at(result, at, rows[column].to_numpy()[inside])
    return result


def _boluses_of(frame: pl.DataFrame, first: dt.datetime, carbs_g: Values, *, automated: bool) -> tuple[Values, Values]:
    """Insulin of each sample by boluses of the user and by those of automation [U], each over its time."""
    import polars as pl

    boluses = frame.filter(pl.col("bolus_U") > 0.0)
    begins_min, dose_U = _minutes(boluses, first), boluses["bolus_U"].to_numpy()
    over_min = boluses["bolus_min"].fill_null(0.0).to_numpy()
    types = boluses["bolus_type"].to_list()
    edges = SAMPLE_MIN * np.arange(carbs_g.size + 1)
    at, inside = _samples_of(boluses, first, carbs_g.size)
    near = round(_WITH_CARBS_MIN / SAMPLE_MIN)
    by_user, by_automation = np.zeros((2, carbs_g.size))
    sample_of = np.full(dose_U.size, -1)
    sample_of[inside] = at
    places = sample_of.tolist()
    for begin_min, dose, length_min, sample, of_file in zip(begins_min, dose_U, over_min, places, types, strict=True):
        with_carbs = sample >= 0 and carbs_g[max(sample - near, 0) : sample + near + 1].any()
        automatic = of_file == "automatic" if of_file is not None else automated and not with_carbs
        result = by_automation if automatic else by_user
        if length_min > 0.0:
            result += dose * np.diff(np.clip((edges - begin_min) / length_min, 0.0, 1.0))
        elif sample >= 0:
            result[sample] += dose
    return by_user, by_automation


def _basal_of(frame: pl.DataFrame, first: dt.datetime, days: int, notes: list[str]) -> tuple[Values, float]:
    """Basal and long-acting insulin of each sample [U], and the part of the time with a rate off its schedule [%]."""
    import polars as pl

    edges = SAMPLE_MIN * np.arange(days * SAMPLES_PER_DAY + 1)
    rates = frame.filter(pl.col("basal_U_h").is_not_null()).unique("time", keep="last", maintain_order=True)
    basal, off_schedule_pct = np.zeros(edges.size - 1), 0.0
    if rates["basal_U_h"].is_finite().any():
        at = np.searchsorted(_minutes(rates, first), edges[:-1], side="right") - 1
        rate_U_h = np.where(at >= 0, rates["basal_U_h"].to_numpy()[np.maximum(at, 0)], np.nan).reshape(days, -1)
        of_record = np.isfinite(rate_U_h)
        columns = zip(rate_U_h.T, of_record.T, strict=True)
        usual = np.array([np.median(rates[there]) if there.any() else np.nan for rates, there in columns])
        usual = np.where(np.isfinite(usual), usual, np.nanmedian(rates["basal_U_h"].to_numpy()))
        off = np.abs(rate_U_h - usual) > _SAME_RATE * usual
        if of_record.any():
            off_schedule_pct = 100.0 * float(off[of_record].mean())
        hours = (~of_record).sum() * SAMPLE_MIN / MIN_PER_H
        if hours >= 1.0:
            notes.append(f"The record tells no basal rate for {hours:.0f} h; its median at that time of day was taken.")
        basal = np.where(of_record, rate_U_h, usual).ravel() * SAMPLE_MIN / MIN_PER_H
    doses = frame.filter(pl.col("long_acting_U") > 0.0)
    for begin_min, dose_U in zip(_minutes(doses, first), doses["long_acting_U"], strict=True):
        basal = basal + dose_U * np.diff(np.clip((edges - begin_min) / MIN_PER_DAY, 0.0, 1.0))
    return basal, off_schedule_pct


_WINDOW_MIN = 120.0
"""Time over which means by time of day are smoothed."""


class DosesAndMeals(NamedTuple):
    """Insulin [U] and carbohydrate [g] of each sample, ``(samples,)``."""

    insulin_U: Values
    carbs_g: Values


class UsualDay(NamedTuple):
    """Amounts of each sample of a day, ``(samples of a day,)``: the median basal rate, and means of all others."""

    basal_U: Values
    user_bolus_U: Values
    automatic_bolus_U: Values
    carbs_g: Values

    def future(self, record: GriddedRecord, *, known: bool) -> DosesAndMeals:
        """Inputs of each sample as a forecast made before it takes them.

        The basal rate and automatic boluses are as usual. Meals and boluses of the user are those of the record where
        they are known, and else as usual.
        """
        clock = record.clock
        automatic = (self.basal_U + self.automatic_bolus_U)[clock]
        if known:
            return DosesAndMeals(automatic + record.user_bolus_U, record.carbs_g)
        return DosesAndMeals(automatic + self.user_bolus_U[clock], self.carbs_g[clock])


def usual_day(training: GriddedRecord) -> UsualDay:
    """Usual day of a record."""
    means = (training.user_bolus_U, training.automatic_bolus_U, training.carbs_g)
    return UsualDay(
        np.median(training.basal_U.reshape(training.days, -1), axis=0),
        *(smoothed_day(amounts, training.days, _WINDOW_MIN) for amounts in means),
    )


def smoothed_day(values: Values, days: int, window_min: float) -> Values:
    """Mean by time of day ``(samples of a day,)``, over a centred window that goes around midnight."""
    day = values.reshape(days, -1).mean(axis=0)
    half = min(round(0.5 * window_min / SAMPLE_MIN), (day.size - 1) // 2)
    around = np.concatenate([day[day.size - half :], day, day[:half]])
    result: Values = np.convolve(around, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")
    return result


def harmonics_sd() -> Values:
    """Standard deviation of each harmonic before a record [mg/dl], of those after the first by its order less."""
    return np.repeat(_WAVE_SD_MG_DL / np.arange(1, HARMONICS + 1), 2)


def daily_waves(clock: Places) -> Values:
    """A constant and four harmonics of the time of day, ``(samples, 9)``."""
    phase = 2.0 * np.pi * clock / SAMPLES_PER_DAY
    waves = [wave(order * phase) for order in range(1, HARMONICS + 1) for wave in (np.sin, np.cos)]
    return np.stack([np.ones(clock.size), *waves], axis=-1)


def apart(places: Places, least: int) -> Places:
    """Places in their order, without each that is nearer than `least` to the last one before it that is kept."""
    kept: list[int] = []
    for place in places.tolist():
        if not kept or place >= kept[-1] + least:
            kept.append(place)
    return np.array(kept, np.int64)
