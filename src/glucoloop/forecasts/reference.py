"""Forecasts without a model, which any model has to beat: the last reading, the mean, and the mean by time of day."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from glucoloop._lazy_jax import np
from glucoloop.component.setting import About
from glucoloop.forecasts.method import ForecastMethod, GlucoseForecast, Predictor, last_readings

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values


@dataclass(frozen=True)
class _LastReading:
    mean_mg_dl: float

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        latest = last_readings(record, self.mean_mg_dl)[origins]
        mean = np.repeat(latest[:, None], horizons.size, axis=1)
        return GlucoseForecast(mean, np.ones_like(mean))


class Persistence(ForecastMethod, name="persistence"):
    """Glucose stays what the latest reading says."""

    def predictor(self, training: GriddedRecord) -> Predictor:
        """The latest reading, and the mean of training before the first one."""
        return _LastReading(float(np.nanmean(training.reading_mg_dl)))


@dataclass(frozen=True)
class _DailyCurve:
    glucose_mg_dl: Values
    """Glucose at each sample of a day, ``(samples of a day,)``."""

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        mean = self.glucose_mg_dl[(origins[:, None] + horizons) % self.glucose_mg_dl.size]
        return GlucoseForecast(mean, np.ones_like(mean))


class Mean(ForecastMethod, name="mean"):
    """Glucose is the mean of the readings of training."""

    def predictor(self, training: GriddedRecord) -> Predictor:
        """The same value at all times of day."""
        day = training.reading_mg_dl.size // training.days
        return _DailyCurve(np.full(day, np.nanmean(training.reading_mg_dl)))


class TimeOfDay(ForecastMethod, name="time-of-day"):
    """Glucose is the mean of the readings of training near that time of day."""

    window_min: Annotated[
        float, About("Time around the time of day from which readings are taken.", at_least=5.0, at_most=1440.0)
    ] = 120.0

    def predictor(self, training: GriddedRecord) -> Predictor:
        """The mean within the window, and that of all readings where there is none."""
        from glucoloop.forecasts.grid import smoothed_day

        readings = training.reading_mg_dl
        there = np.isfinite(readings)
        sums = smoothed_day(np.where(there, readings, 0.0), training.days, self.window_min)
        counts = smoothed_day(there.astype(float), training.days, self.window_min)
        some = counts > 1e-9
        overall = np.nanmean(readings)
        return _DailyCurve(np.where(some, sums / np.where(some, counts, 1.0), overall))
