"""Errors of forecasts on days that were held out: for each horizon, and for whole days from midnight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY
from glucoloop.forecasts.method import Predictor, origins_of
from glucoloop.units import MIN_PER_DAY

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values

DAY: Final = "day"
"""Name of the horizon of all readings of a day, forecast at the midnight with which it begins."""


class ForecastErrors(NamedTuple):
    """Forecasts beside the readings that came; all arrays are ``(forecasts,)``."""

    t_min: Values
    """Time of the reading, from the midnight with which the days held out begin."""
    forecast_mg_dl: Values
    reading_mg_dl: Values
    half_width_mg_dl: Values

    @property
    def day(self) -> Places:
        """Day of each reading, from the first one held out."""
        return ((self.t_min - 0.5 * SAMPLE_MIN) // MIN_PER_DAY).astype(np.int64)

    @property
    def error_mg_dl(self) -> Values:
        """Forecast less reading."""
        result: Values = self.forecast_mg_dl - self.reading_mg_dl
        return result

    @property
    def covered(self) -> npt.NDArray[np.bool_]:
        """Whether each reading lies within the band."""
        result: npt.NDArray[np.bool_] = np.abs(self.error_mg_dl) <= self.half_width_mg_dl
        return result


def forecast_errors(
    predictor: Predictor, record: GriddedRecord, first_day: int, horizons_min: Sequence[float], *, future_known: bool
) -> dict[str, ForecastErrors]:
    """Errors of a fitted method on the days of a record from `first_day` on, by the text of the horizon.

    A forecast is made every 15 min at which there is a reading, and judged where there is one at its horizon. With
    `DAY` all readings of a day are forecast from the last sample before its midnight.
    """
    horizons = np.array([round(horizon_min / SAMPLE_MIN) for horizon_min in horizons_min], dtype=np.int64)
    origins = origins_of(record, first_day * SAMPLES_PER_DAY)
    forecast = predictor.forecast(record, origins, horizons, future_known=future_known)
    results = {
        f"{horizon_min:g} min": _judged(
            record, first_day, origins + horizon, forecast.mean_mg_dl[:, place], forecast.half_width_mg_dl[:, place]
        )
        for place, (horizon_min, horizon) in enumerate(zip(horizons_min, horizons, strict=True))
    }
    midnights = SAMPLES_PER_DAY * np.arange(first_day, record.days) - 1
    of_day = np.arange(1, SAMPLES_PER_DAY + 1)
    forecast = predictor.forecast(record, midnights, of_day, future_known=future_known)
    targets = (midnights[:, None] + of_day).ravel()
    results[DAY] = _judged(record, first_day, targets, forecast.mean_mg_dl.ravel(), forecast.half_width_mg_dl.ravel())
    return results


def _judged(
    record: GriddedRecord, first_day: int, targets: Places, mean_mg_dl: Values, half_width_mg_dl: Values
) -> ForecastErrors:
    """Forecasts of samples that have a reading."""
    reading = np.append(record.reading_mg_dl, np.nan)[np.minimum(targets, record.reading_mg_dl.size)]
    there = np.isfinite(reading)
    t_min = SAMPLE_MIN * (targets[there] + 1.0) - MIN_PER_DAY * first_day
    return ForecastErrors(t_min, mean_mg_dl[there], reading[there], half_width_mg_dl[there])
