"""Day as it usually is: insulin and carbohydrate by time of day, which stand for those that are not known."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from glucoloop._lazy_jax import np
from glucoloop.forecasts.grid import SAMPLE_MIN

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Values

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
