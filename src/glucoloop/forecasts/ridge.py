"""Ridge regression on readings, and on the effects of insulin and carbohydrate by several curves.

For each horizon the reading to come is a linear function of the latest readings, of what insulin and carbohydrate do
until then by a quick and a slow curve each, of what is to come of them, and of four harmonics of the time of day.

References
----------
A. E. Hoerl, R. W. Kennard, "Ridge regression: biased estimation for nonorthogonal problems", Technometrics 12(1), 1970.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

from glucoloop._lazy_jax import np
from glucoloop.component.setting import About
from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY, UsualDay, daily_waves, usual_day
from glucoloop.forecasts.method import (
    ANCHORS,
    ForecastMethod,
    GlucoseForecast,
    Predictor,
    effect_of_future,
    effect_of_history,
    last_readings,
    origins_of,
)

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values

_LAGS: Final = (0, 1, 2, 3, 4, 6, 9, 12, 18, 24, 36)
"""Ages of the readings that are used [samples of 5 min]."""
_TIME_CONSTANTS_MIN: Final = {"insulin": (30.0, 70.0), "carbs": (15.0, 40.0)}
_GLUCOSE_MIN: Final = 150.0
"""Time constant with which glucose returns to its level."""


@dataclass(frozen=True)
class _Regressions:
    """Linear function of standardised features for each anchor."""

    usual: UsualDay
    mean_mg_dl: float
    center: Values
    scale: Values
    coefficients: Values
    """``(anchors, features + 1)``, the constant last."""

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        at_anchors = np.empty((origins.size, len(ANCHORS)))
        for place, features in enumerate(
            _features(record, self.usual, self.mean_mg_dl, origins, future_known=future_known)
        ):
            standard = (features - self.center[place]) / self.scale[place]
            at_anchors[:, place] = standard @ self.coefficients[place, :-1] + self.coefficients[place, -1]
        weights = np.array([np.interp(horizons, ANCHORS, unit) for unit in np.eye(len(ANCHORS))])
        mean = at_anchors @ weights
        return GlucoseForecast(mean, np.ones_like(mean))


class Ridge(ForecastMethod, name="ridge"):
    """Ridge regression on readings, insulin, carbohydrate and the time of day, one for each horizon."""

    penalty: Annotated[
        float,
        About(
            "Weight of the squared coefficients of standardised features, for each forecast.", above=0.0, at_most=100.0
        ),
    ] = 0.01

    def predictor(self, training: GriddedRecord) -> Predictor:
        """Coefficients of least squares with a penalty, with the meals and boluses of the user known."""
        usual, mean = usual_day(training), float(np.nanmean(training.reading_mg_dl))
        origins = origins_of(training, 0)
        every = _features(training, usual, mean, origins, future_known=True)
        centers, scales, coefficients = [], [], []
        reading = np.append(training.reading_mg_dl, np.nan)
        for features, anchor in zip(every, ANCHORS, strict=True):
            target = reading[np.minimum(origins + anchor, reading.size - 1)]
            there = np.isfinite(target)
            x, y = features[there], target[there]
            center = x.mean(axis=0) if y.size else np.zeros(features.shape[1])
            scale = x.std(axis=0) if y.size else np.ones(features.shape[1])
            scale = np.where(scale > 1e-9, scale, 1.0)
            level = float(y.mean()) if y.size else mean
            weights = ridge_coefficients((x - center) / scale, y - level, self.penalty * max(y.size, 1))
            centers.append(center)
            scales.append(scale)
            coefficients.append(np.append(weights, level))
        return _Regressions(usual, mean, np.array(centers), np.array(scales), np.array(coefficients))


def ridge_coefficients(features: Values, targets: Values, penalty: float) -> Values:
    """Coefficients ``(features,)`` that minimise ``|y - X b|² + penalty |b|²``, as ``(X'X + penalty I)^-1 X'y``."""
    gram = features.T @ features + penalty * np.eye(features.shape[1])
    return np.asarray(np.linalg.solve(gram, features.T @ targets), np.float64)


def _features(
    record: GriddedRecord, usual: UsualDay, mean_mg_dl: float, origins: Places, *, future_known: bool
) -> Iterator[Values]:
    """Features ``(origins, features)`` at each anchor."""
    latest = last_readings(record, mean_mg_dl)
    readings = np.stack([latest[np.maximum(origins - lag, 0)] for lag in _LAGS], axis=-1)
    future = usual.future(record, known=future_known)
    history = (record.insulin_U - usual.basal_U[record.clock], record.carbs_g)
    to_come = (future.insulin_U - usual.basal_U[record.clock], future.carbs_g)
    for anchor in ANCHORS:
        effects = [
            effect(amounts, curve, anchor)[origins]
            for past, coming, curves in zip(history, to_come, _curves(), strict=True)
            for curve in curves
            for effect, amounts in ((effect_of_history, past), (effect_of_future, coming))
        ]
        waves = daily_waves((origins + anchor) % SAMPLES_PER_DAY)[:, 1:]
        yield np.column_stack([readings, *effects, waves])


def _curves() -> Iterator[list[Values]]:
    """Response of glucose to a unit of insulin and of carbohydrate: two compartments, and a return to the level."""
    t_min = SAMPLE_MIN * np.arange(SAMPLES_PER_DAY)
    decay = np.exp(-t_min / _GLUCOSE_MIN)
    for constants in _TIME_CONSTANTS_MIN.values():
        yield [
            np.convolve(t_min / tau**2 * np.exp(-t_min / tau), decay)[: t_min.size] * SAMPLE_MIN for tau in constants
        ]
