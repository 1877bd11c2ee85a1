"""Method of forecasting: fitted to days of training, it gives mean and variance of readings to come.

A forecast at a sample sees the readings up to this sample and the doses and meals up to it. Of what is to come it knows
either nothing, or the meals and the boluses of the user, but never what automation will dose: under automation doses
follow glucose, and who is told them reads glucose off them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple, Protocol

from glucoloop._lazy_jax import np, scipy
from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.forecasts.grid import apart
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values


ANCHORS: Final = (1, 3, 6, 12, 18, 24, 36, 48, 72, 96, 144, 192, 288)
"""Horizons [samples of 5 min] at which bands are scaled and regressions fitted; between them follows a line."""
STRIDE: Final = 3
"""Samples between the origins of forecasts, 15 min."""
MIN_TRAINING_DAYS: Final = 5
"""Days with readings from which a method is fitted."""
_MIN_ERRORS: Final = 20
"""Errors of training from which a band is scaled."""
_INDEPENDENT_PER_DAY: Final = 3
"""Errors of a day that count as independent, one in eight hours, where the band is widened for their number."""
_NORMAL_90: Final = 1.6448536269514722
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""


class GlucoseForecast(NamedTuple):
    """Mean [mg/dl] and variance [(mg/dl)²] of the readings to come, ``(origins, horizons)``."""

    mean_mg_dl: Values
    variance: Values

    @property
    def half_width_mg_dl(self) -> Values:
        """Half of the width of the band that is to hold 90 % of the readings."""
        result: Values = _NORMAL_90 * np.sqrt(self.variance)
        return result


class Predictor(Protocol):
    """Fitted method: an immutable value."""

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        """Forecasts of the readings some samples (`horizons`, 1 or more) after each sample of `origins`.

        `record` begins with the history of all origins. Of its later samples only the meals and the boluses of the
        user are seen, and these only with `future_known`.
        """


class ForecastMethod(Component):
    """Method of forecasting: a class in a file, entered in `METHODS`.

    A package of your own enters it by an entry point in the group ``glucoloop.forecast_methods``.
    """

    kind: ClassVar = "forecast method"

    def predictor(self, training: GriddedRecord) -> Predictor:
        """The method fitted to the days of training; its variances are right up to a factor for each horizon."""
        raise NotImplementedError

    def fit(self, training: GriddedRecord) -> Predictor:
        """The method fitted to the days of training, with bands scaled by its errors on these days.

        Raises
        ------
        Refusal
            If fewer than five days have readings, or too few readings follow one another.
        """
        self.refuse_few_days(training)
        return scaled(self.predictor(training), training)

    @staticmethod
    def refuse_few_days(training: GriddedRecord) -> None:
        """Refusal where fewer than five days have readings."""
        if training.days_with_readings < MIN_TRAINING_DAYS:
            raise Refusal(
                f"{training.days_with_readings} of its days before those held out have readings, and a forecast is "
                f"fitted on {MIN_TRAINING_DAYS} or more; give a longer record, or hold out fewer days"
            )


@dataclass(frozen=True)
class _Scaled:
    """A fitted method whose band holds 90 % of the readings of the days of training."""

    inner: Predictor
    scales: Values
    """``(2, anchors)`` factors of the standard deviation, with an unknown and with a known future."""

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        """Forecasts of the method, also beyond the end of the record."""
        beyond = int(origins.max(initial=0) + horizons.max(initial=0)) + 1 - record.reading_mg_dl.size
        inner = self.inner.forecast(record.padded(beyond), origins, horizons, future_known=future_known)
        scale = np.interp(horizons, ANCHORS, self.scales[int(future_known)])
        return GlucoseForecast(inner.mean_mg_dl, inner.variance * scale**2)


def scaled(inner: Predictor, training: GriddedRecord) -> Predictor:
    """A fitted method with its band scaled so that it holds 90 % of the readings of the days of training.

    The part is a little larger, as for any interval of prediction from few errors (conformal prediction: V. Vovk,
    A. Gammerman, G. Shafer, Algorithmic Learning in a Random World, Springer, 2005).
    """
    level = min(0.9 * (1.0 + 1.0 / (_INDEPENDENT_PER_DAY * training.days)), 0.99)
    anchors = np.array(ANCHORS)
    scales = []
    for future_known in (False, True):
        origins = origins_of(training, 0)
        targets = origins[:, None] + anchors
        forecast = inner.forecast(training.padded(ANCHORS[-1]), origins, anchors, future_known=future_known)
        reading = np.append(training.reading_mg_dl, np.nan)[np.minimum(targets, training.reading_mg_dl.size)]
        relative = np.abs(reading - forecast.mean_mg_dl) / np.sqrt(forecast.variance)
        there = np.isfinite(relative)
        enough = there.sum(axis=0) >= _MIN_ERRORS
        if not enough.any():
            raise Refusal("hardly any of its readings follow one another within a day; give a record of a sensor")
        of_anchor = [np.quantile(relative[there[:, place], place], level) for place in np.flatnonzero(enough)]
        scales.append(np.interp(anchors, anchors[enough], of_anchor) / _NORMAL_90)
    return _Scaled(inner, np.array(scales))


def origins_of(record: GriddedRecord, first_sample: int) -> Places:
    """Samples with a reading from one on, 15 min or more apart, at which forecasts are made."""
    readable = np.flatnonzero(np.isfinite(record.reading_mg_dl))
    return apart(readable[readable >= first_sample], STRIDE)


def last_readings(record: GriddedRecord, otherwise_mg_dl: float) -> Values:
    """Latest reading at each sample [mg/dl]; another value before the first one."""
    place = np.where(np.isfinite(record.reading_mg_dl), np.arange(record.reading_mg_dl.size), -1)
    place = np.maximum.accumulate(place)
    result: Values = np.where(place >= 0, record.reading_mg_dl[place], otherwise_mg_dl)
    return result


METHODS: Final = Catalogue(
    ForecastMethod,
    {
        "kalman": "glucoloop.forecasts.kalman:Kalman",
        "twin": "glucoloop.twins.forecast:TwinForecast",
        "ridge": "glucoloop.forecasts.ridge:Ridge",
        "loop-like": "glucoloop.forecasts.loop_like:LoopLikeForecast",
        "time-of-day": "glucoloop.forecasts.reference:TimeOfDay",
        "mean": "glucoloop.forecasts.reference:Mean",
        "persistence": "glucoloop.forecasts.reference:Persistence",
    },
    example="ridge, penalty=.01",
)
"""Methods by name, the one that the others are compared with first."""


def effect_of_history(amounts: Values, curve: Values, horizon: int) -> Values:
    """Change of glucose from each sample to `horizon` samples later by the amounts up to that sample, ``(samples,)``.

    `curve` is the effect of one unit 0, 1, 2, ... samples after it, and stays at its last value.
    """
    size = amounts.size
    whole = _extended(curve, size + horizon)
    return _convolved(amounts, whole[horizon : size + horizon] - whole[:size])


def effect_of_future(amounts: Values, curve: Values, horizon: int) -> Values:
    """Effect `horizon` samples after each sample of the amounts in between, ``(samples,)``; 0 beyond the last one."""
    size = amounts.size
    effects = _convolved(amounts, _extended(curve, horizon))
    result = np.zeros(size)
    result[: max(size - horizon, 0)] = effects[horizon:]
    return result


def _extended(curve: Values, size: int) -> Values:
    return np.concatenate([curve, np.full(max(size - curve.size, 0), curve[-1])])[:size]


def _convolved(amounts: Values, kernel: Values) -> Values:
    """Causal convolution; the end of the kernel that stays 0 is left out."""
    there = np.flatnonzero(kernel)
    if not there.size or not amounts.any():
        return np.zeros(amounts.size)
    result: Values = scipy.signal.oaconvolve(amounts, kernel[: there[-1] + 1])[: amounts.size]
    return result
