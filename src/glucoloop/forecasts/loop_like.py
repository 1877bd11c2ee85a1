"""Forecast by two numbers and fixed curves, as programs that dose insulin make it.

The forecast is the latest reading, less the fall by insulin beyond the usual basal rate, plus the rise by
carbohydrate, within what a sensor can read. The curves are those of LoopKit for rapid insulin of adults and for
carbohydrate that is absorbed within three hours (`therapy.INSULINS`, `control.loop_like`). Sensitivity and carbohydrate
ratio are those of the rules of 1700 and 450, over the total daily dose, or fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

from glucoloop._lazy_jax import np
from glucoloop.component.setting import About
from glucoloop.forecasts.grid import SAMPLE_MIN, UsualDay, usual_day
from glucoloop.forecasts.method import (
    ForecastMethod,
    GlucoseForecast,
    Predictor,
    effect_of_future,
    effect_of_history,
    last_readings,
    origins_of,
)
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values

_CORRECTION_RULE: Final = 1700.0
_CARB_RULE: Final = 450.0
_FITTED_MIN: Final = (30, 60, 120, 180, 240)
_MIN_DAILY_DOSE_U: Final = 1.0
_LIMITS_MG_DL: Final = (39.0, 401.0)
"""Ends of a forecast, beyond which no sensor reads; those to which oref0 limits its predictions."""


@dataclass(frozen=True)
class _TwoNumbers:
    sensitivity_mg_dl_U: float
    rise_mg_dl_g: float
    usual: UsualDay
    mean_mg_dl: float

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        effects = _effects(record, self.usual, origins, horizons, future_known=future_known)
        rise = np.array([-self.sensitivity_mg_dl_U, self.rise_mg_dl_g])
        mean = last_readings(record, self.mean_mg_dl)[origins][:, None] + effects @ rise
        return GlucoseForecast(np.clip(mean, *_LIMITS_MG_DL), np.ones_like(mean))


def _effects(
    record: GriddedRecord, usual: UsualDay, origins: Places, horizons: Places, *, future_known: bool
) -> Values:
    """Insulin that acts [U] and carbohydrate that is absorbed [g] until each horizon, ``(origins, horizons, 2)``."""
    from glucoloop.control.loop_like import on_board_curves

    basal_U = usual.basal_U[record.clock]
    history = (record.insulin_U - basal_U, record.carbs_g)
    unknown = np.zeros(basal_U.size)
    future = (record.user_bolus_U, record.carbs_g) if future_known else (unknown, unknown)
    result = np.empty((origins.size, horizons.size, 2))
    for kind, left in enumerate(on_board_curves(SAMPLE_MIN)):
        curve = 1.0 - left
        for place, horizon in enumerate(horizons.tolist()):
            of_all = effect_of_history(history[kind], curve, horizon) + effect_of_future(future[kind], curve, horizon)
            result[:, place, kind] = of_all[origins]
    return result


class LoopLikeForecast(ForecastMethod, name="loop-like"):
    """Sum of the effects of insulin and carbohydrate, by fixed curves and two numbers."""

    fitted: Annotated[
        bool, About("Whether the two numbers are fitted to the record; else they follow the rules of 1700 and 450.")
    ] = False

    def predictor(self, training: GriddedRecord) -> Predictor:
        """Two numbers by the rules, or by least squares over horizons of 30 to 240 min; Refusal without insulin."""
        daily_U = training.total_daily_dose_U
        if daily_U < _MIN_DAILY_DOSE_U:
            raise Refusal(
                f"it has {daily_U:.1f} U of insulin a day, and loop-like forecasts from insulin; give a record with "
                "insulin, or leave the method out"
            )
        usual, mean = usual_day(training), float(np.nanmean(training.reading_mg_dl))
        sensitivity = _CORRECTION_RULE / daily_U
        by_rules = _TwoNumbers(sensitivity, sensitivity * daily_U / _CARB_RULE, usual, mean)
        if not self.fitted:
            return by_rules
        horizons = np.array([round(horizon / SAMPLE_MIN) for horizon in _FITTED_MIN])
        origins = origins_of(training, 0)
        origins = origins[origins + horizons[-1] < training.reading_mg_dl.size]
        effects = _effects(training, usual, origins, horizons, future_known=True)
        change = training.reading_mg_dl[origins[:, None] + horizons] - training.reading_mg_dl[origins][:, None]
        there = np.isfinite(change)
        (fall, rise), *_ = np.linalg.lstsq(effects[there], change[there], rcond=None)
        return _TwoNumbers(-float(fall), float(rise), usual, mean)
