"""A method of forecasting from outside: the latest reading goes back to the mean of the record.

glucoloop forecast export.csv --method 'your_own_forecast:Returning, time_constant_min=90' --method persistence
"""

import datetime as dt
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from glucoloop.plugin import About, ForecastMethod, GlucoseForecast, GriddedRecord, last_readings

SAMPLE_MIN = 5.0


class Returning(ForecastMethod):
    """The latest reading, which returns to the mean of the days of training with a time constant."""

    time_constant_min: Annotated[float, About("Time constant of the return.", above=0.0, at_most=10_000.0)] = 120.0

    def predictor(self, training: GriddedRecord) -> "ReturnToMean":
        """The fitted method; its band is scaled by its errors on the same days."""
        return ReturnToMean(float(np.nanmean(training.reading_mg_dl)), self.time_constant_min)


@dataclass(frozen=True)
class ReturnToMean:
    """Fitted method."""

    mean_mg_dl: float
    time_constant_min: float

    def forecast(
        self, record: GriddedRecord, origins: np.ndarray, horizons: np.ndarray, *, future_known: bool
    ) -> GlucoseForecast:
        """Mean and variance at each horizon after each origin; the scale of the variance does not matter."""
        latest = last_readings(record, self.mean_mg_dl)[origins]
        left = np.exp(-SAMPLE_MIN * horizons / self.time_constant_min)
        mean = self.mean_mg_dl + (latest - self.mean_mg_dl)[:, None] * left
        return GlucoseForecast(mean, np.broadcast_to(1.0 - 0.9 * left, mean.shape))


def main() -> None:
    """Print forecasts of a reading of 200 mg/dl where the mean is 150 mg/dl."""
    nothing = np.zeros(2)
    record = GriddedRecord(
        first=dt.datetime(2026, 3, 2),
        reading_mg_dl=np.array([100.0, 200.0]),
        basal_U=nothing,
        user_bolus_U=nothing,
        automatic_bolus_U=nothing,
        carbs_g=nothing,
        basal_off_schedule_pct=0.0,
    )
    forecast = Returning().predictor(record).forecast(record, np.array([1]), np.array([6, 24]), future_known=False)
    print("forecast in mg/dl: " + ", ".join(f"{value:.1f}" for value in forecast.mean_mg_dl[0]))


if __name__ == "__main__":
    main()
