"""Kalman filter with insulin, carbohydrate, what nobody entered, a slow drift and the time of day.

Glucose is the sum of a daily curve (a level and four harmonics), the responses to insulin and carbohydrate, and an
unexplained part that the filter follows::

    I1' = -I1 / tau_I,  I2' = (I1 - I2) / tau_I,  g_I' = I2 / tau_I - g_I / tau_G     each dose is added to I1
    C1' = -C1 / tau_C,  C2' = (C1 - C2) / tau_C,  g_C' = C2 / tau_C - g_C / tau_G     each meal is added to C1
    a1' = -a1 / tau_A + w_1,  a2' = (a1 - a2) / tau_A,  g' = a2 - g / tau_G + w_2     unexplained appearance
    d' = -d / tau_D + w_3                                                            slow drift
    reading = b_0 + sum b_k wave_k(time of day) - S g_I + R g_C + R_u g_U + g + d + v

with ``g_I`` and ``g_C`` in units of the largest response to one unit, so that `S` is the largest fall by 1 U and `R`
the largest rise by 1 g. ``g_U`` is the response to the carbohydrate of the usual day: where counts are wrong or meals
are not entered, a forecast leans on what is usually eaten at that time. Everything but the eight time constants and
noises is linear, so that for each choice of these the rest is found by least squares with a prior. These eight maximise
the predictive likelihood of readings 30, 60, 120, 180 and 240 min ahead with a normal prior on their logarithms; the
number of independent forecasts is taken as eight a day. In the likelihood the doses to come are those of
`UsualDay.future`, so that doses of automation, which follow glucose, do not tell of it.

Beyond some hours a forecast is nearer to the mean of the person than these sums: of what differs from that mean it
keeps a share from four hours on, all of it up to one hour, and on a line in between. The share is found from forecasts
of the days of training with the coefficients of the other days, so that it is small where doses and meals as they were
entered tell little of glucose.

The prior of the eight parameters is the median of the fits to the first eight people, in the order of their files, of
AZT1D (doi:10.17632/gk9m674wcx.1). Insulin is held near a fall by 1 U of 1000 mg/dl over the total daily dose, since
forecasts alone find too little effect of insulin where meals are not entered.

References
----------
A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, Cambridge, 1989, chapters 3 and 4.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

from glucoloop._lazy_jax import np, scipy
from glucoloop.component.setting import About
from glucoloop.forecasts.grid import (
    SAMPLE_MIN,
    SAMPLES_PER_DAY,
    DosesAndMeals,
    UsualDay,
    daily_waves,
    harmonics_sd,
    usual_day,
)
from glucoloop.forecasts.linear_filter import (
    LinearSystem,
    discretised,
    exact_gains,
    filtered,
    recursion,
    steady_gains,
)
from glucoloop.forecasts.method import ForecastMethod, GlucoseForecast, Predictor, origins_of

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values

_HORIZONS_MIN: Final = (30, 60, 120, 180, 240)
_TYPICAL_ERROR_MG_DL: Final = (20.0, 30.0, 38.0, 40.0, 41.0)
"""Errors at these horizons by which the forecasts of least squares are weighted."""
_FORECASTS_PER_DAY: Final = 8.0
"""Number of independent forecasts of a day that the likelihood counts for each horizon."""
_WARM_UP: Final = 144
"""Samples, 12 h, after which what was before the record no longer counts in the likelihood."""
_MIN_DAILY_DOSE_U: Final = 5.0
"""Daily dose below which the prior of the effect of insulin no longer grows."""
_LEVEL_MG_DL: Final = (150.0, 100.0)
_RISE_MG_DL_G: Final = (3.0, 1.5)
"""Largest rise by 1 g of carbohydrate before the record: mean and standard deviation."""
_USUAL_RISE_MG_DL_G: Final = (0.0, 1.5)
"""The same of 1 g that is usual at a time of day, whatever is entered."""
_ROUNDING_VARIANCE: Final = 1.0 / 12.0
"""Variance of the rounding of readings to whole mg/dl [(mg/dl)²], below which no mean square is told apart."""
_FAR_MIN: Final = (240, 480, 720, 960, 1440)
"""Horizons from which the share is found."""
_SHARED_MIN: Final = (60.0, 240.0)
"""Horizons up to which a forecast differs from the mean as far as it does, and from which by the share of it."""
_SHARE: Final = (1.0, 0.5)
"""The share before the record: mean and standard deviation."""
_BLOCKS: Final = 4
"""Blocks of days, each of which is forecast with the coefficients of the others."""
_STEP: Final = 1e-3
"""Step of the finite differences of the logarithms of parameters."""


class _Prior(NamedTuple):
    """Median of a parameter and standard deviation of its logarithm."""

    median: float
    log_sd: float


_PRIORS: Final = {
    "glucose_min": _Prior(120.0, 0.5),
    "insulin_min": _Prior(53.0, 0.3),
    "carbs_min": _Prior(27.0, 0.4),
    "appearance_min": _Prior(8.5, 0.5),
    "glucose_noise": _Prior(0.54, 0.7),
    "drift_sd": _Prior(18.0, 0.7),
    "drift_min": _Prior(850.0, 0.7),
    "reading_sd": _Prior(2.5, 0.5),
}
"""Time constants ``tau_G, tau_I, tau_C, tau_A, tau_D`` [min]; standard deviations of the drift, of `w_2` over a square
root of a minute, and of `v`, in units of that of `w_1` [mg/dl]."""


def _log_prior() -> tuple[Values, Values]:
    """Mean and standard deviation ``(8,)`` of the logarithms of the parameters."""
    return np.log([prior.median for prior in _PRIORS.values()]), np.array([prior.log_sd for prior in _PRIORS.values()])


def unexplained_system(parameters: Values) -> LinearSystem:
    """Unexplained part of glucose, of parameters ``(systems, 8)``: the states ``g, a1, a2, d``."""
    by_name = dict(zip(_PRIORS, parameters.T, strict=True))
    rate, density = np.zeros((2, parameters.shape[0], 4, 4))
    rate[:, 0, 0], rate[:, 0, 2] = -1.0 / by_name["glucose_min"], 1.0
    appearance = 1.0 / by_name["appearance_min"]
    rate[:, 1, 1], rate[:, 2, 1], rate[:, 2, 2] = -appearance, appearance, -appearance
    rate[:, 3, 3] = -1.0 / by_name["drift_min"]
    density[:, 0, 0], density[:, 1, 1] = by_name["glucose_noise"] ** 2, 1.0
    density[:, 3, 3] = 2.0 * by_name["drift_sd"] ** 2 / by_name["drift_min"]
    transition, noise = discretised(rate, density, SAMPLE_MIN)
    return LinearSystem(transition, noise, np.array([1.0, 0.0, 0.0, 1.0]), by_name["reading_sd"] ** 2)


class _Responses(NamedTuple):
    """Responses to insulin and to carbohydrate, for each of several choices of parameters."""

    transition: Values
    """Transitions ``(systems, 2, 3, 3)`` of the states ``I1, I2, g_I`` and ``C1, C2, g_C`` over a sample."""
    first_state: Values
    """Value ``(systems, 2)`` of the first state by one unit, with which the largest response is 1."""

    @classmethod
    def of(cls, parameters: Values) -> _Responses:
        by_name = dict(zip(_PRIORS, parameters.T, strict=True))
        rate = np.zeros((parameters.shape[0], 2, 3, 3))
        for kind, name in enumerate(("insulin_min", "carbs_min")):
            passing = 1.0 / by_name[name]
            rate[:, kind, 0, 0], rate[:, kind, 1, 1] = -passing, -passing
            rate[:, kind, 1, 0], rate[:, kind, 2, 1] = passing, passing
            rate[:, kind, 2, 2] = -1.0 / by_name["glucose_min"]
        transition = scipy.linalg.expm(SAMPLE_MIN * rate)
        state = np.zeros((*transition.shape[:2], 3, 1))
        state[..., 0, 0] = 1.0
        largest = np.zeros(transition.shape[:2])
        for _ in range(SAMPLES_PER_DAY // 2):
            state = transition @ state
            largest = np.maximum(largest, state[..., 2, 0])
        return cls(transition, 1.0 / largest)

    def states(self, inputs: DosesAndMeals) -> Values:
        """States after the doses of each sample, ``(samples, systems, 2, 3)``."""
        amounts = np.stack(inputs, axis=-1)[:, None, :]
        drives = np.zeros((amounts.shape[0], *self.transition.shape[:3], 1))
        drives[..., 0, 0] = amounts * self.first_state
        return recursion(self.transition[None], drives)[1:, ..., 0]


class _Explained(NamedTuple):
    """Regressors of the explained part of the readings: responses to insulin and carbohydrate, and daily curves."""

    responses: _Responses
    states: Values
    """States ``(samples, systems, 2, 3)`` by the doses of the record."""
    future_states: Values
    """States by the doses that a forecast takes."""
    daily: Values
    """Daily waves and the response to the usual carbohydrate, ``(samples, systems, 10)``."""

    @classmethod
    def of(cls, parameters: Values, record: GriddedRecord, usual: UsualDay, *, future_known: bool) -> _Explained:
        responses, waves = _Responses.of(parameters), daily_waves(record.clock)
        history = DosesAndMeals(record.insulin_U, record.carbs_g)
        twice = np.tile(usual.carbs_g, 2)  # the second of two usual days goes on from the first
        curve = responses.states(DosesAndMeals(np.zeros(twice.size), twice))[SAMPLES_PER_DAY:, :, 1, 2][record.clock]
        return cls(
            responses,
            responses.states(history),
            responses.states(usual.future(record, known=future_known)),
            np.concatenate([np.repeat(waves[:, None], curve.shape[1], axis=1), curve[..., None]], axis=-1),
        )

    def at_samples(self) -> Values:
        """Regressors at each sample, ``(samples, systems, 12)``."""
        return np.concatenate([self.states[..., 2], self.daily], axis=-1)

    def ahead(self, origins: Places, horizon: int) -> Values:
        """Regressors a horizon after each origin, ``(origins, systems, 12)``, without later doses of the record."""
        power = np.linalg.matrix_power(self.responses.transition, horizon)[..., 2, :]
        differing = self.states[origins] - self.future_states[origins]
        response = self.future_states[origins + horizon][..., 2] + (power * differing).sum(axis=-1)
        return np.concatenate([response, self.daily[origins + horizon]], axis=-1)


class _LinearPrior(NamedTuple):
    """Mean and standard deviation of the coefficients ``-S, R, b, R_u`` before the record, ``(12,)`` each."""

    mean: Values
    sd: Values


def _linear_prior(daily_U: float, rule: float, spread: float) -> _LinearPrior:
    fall = rule / max(daily_U, _MIN_DAILY_DOSE_U)
    waves_sd = harmonics_sd()
    return _LinearPrior(
        np.array([-fall, _RISE_MG_DL_G[0], _LEVEL_MG_DL[0], *np.zeros(waves_sd.size), _USUAL_RISE_MG_DL_G[0]]),
        np.array([spread * fall, _RISE_MG_DL_G[1], _LEVEL_MG_DL[1], *waves_sd, _USUAL_RISE_MG_DL_G[1]]),
    )


class _Case(NamedTuple):
    """Forecasts over one horizon."""

    horizon: int
    """Number of samples."""
    typical_mg_dl: float
    """Error by which they are weighted."""
    origins: Places

    @classmethod
    def of(cls, training: GriddedRecord, horizon_min: float, typical_mg_dl: float) -> _Case:
        """Forecasts of the days of training that have a reading at their horizon."""
        readable, horizon = np.isfinite(training.reading_mg_dl), round(horizon_min / SAMPLE_MIN)
        origins = origins_of(training, _WARM_UP)
        origins = origins[origins + horizon < readable.size]
        return cls(horizon, typical_mg_dl, origins[readable[origins + horizon]])


class _Likelihood:
    """Negative logarithm of the likelihood of forecasts and of the prior, as a function of the logarithms."""

    def __init__(self, training: GriddedRecord, prior: _LinearPrior) -> None:
        self._training, self._prior = training, prior
        self._log_median, self._log_sd = _log_prior()
        self._usual = usual_day(training)
        self._readable = np.isfinite(training.reading_mg_dl)
        self._readings = np.where(self._readable, training.reading_mg_dl, 0.0)
        cases = map(functools.partial(_Case.of, training), _HORIZONS_MIN, _TYPICAL_ERROR_MG_DL)
        self.cases = [case for case in cases if case.origins.size]

    def errors(self, parameters: Values, cases: Sequence[_Case]) -> list[Values]:
        """Errors of forecasts of the readings, and of each regressor as if it was read, ``(origins, systems, 13)``."""
        system = unexplained_system(parameters)
        explained = _Explained.of(parameters, self._training, self._usual, future_known=True)
        known = explained.at_samples()
        readings = np.broadcast_to(self._readings[:, None, None], (*known.shape[:2], 1))
        gains = np.where(self._readable[:, None, None], steady_gains(system), 0.0)
        states = filtered(system, gains, np.concatenate([readings, known], axis=-1))
        results = []
        for horizon, _, origins in cases:
            power = system.readout @ np.linalg.matrix_power(system.transition, horizon)
            of_filter = np.einsum("ks,oksc->okc", power, states[origins])
            ahead = explained.ahead(origins, horizon)
            results.append(np.concatenate([readings[origins + horizon], ahead], axis=-1) - of_filter)
        return results

    def coefficients(self, errors: Sequence[Values], cases: Sequence[_Case]) -> Values:
        """Most likely coefficients ``(12,)`` for the errors ``(origins, 13)`` of one system."""
        precision = np.diag(self._prior.sd**-2)
        weighted = self._prior.mean * self._prior.sd**-2
        count = _FORECASTS_PER_DAY * self._training.days / len(_HORIZONS_MIN)
        for (_, typical, origins), of_horizon in zip(cases, errors, strict=True):
            weight = count / (origins.size * typical**2)
            precision = precision + weight * of_horizon[:, 1:].T @ of_horizon[:, 1:]
            weighted = weighted + weight * of_horizon[:, 1:].T @ of_horizon[:, 0]
        return np.asarray(np.linalg.solve(precision, weighted), np.float64)

    def value(self, logarithms: Values) -> tuple[float, Values]:
        """Value and gradient, by forward differences of all parameters at once."""
        points = logarithms + _STEP * np.vstack([np.zeros(logarithms.size), np.eye(logarithms.size)])
        errors = self.errors(np.exp(points), self.cases)
        count = _FORECASTS_PER_DAY * self._training.days / len(_HORIZONS_MIN)
        values = np.empty(points.shape[0])
        for place, point in enumerate(points):
            of_system = [of_horizon[:, place] for of_horizon in errors]
            coefficients = self.coefficients(of_system, self.cases)
            squares = [np.mean((e[:, 0] - e[:, 1:] @ coefficients) ** 2) for e in of_system]
            linear = (coefficients - self._prior.mean) / self._prior.sd
            nonlinear = (point - self._log_median) / self._log_sd
            values[place] = 0.5 * (
                count * np.log(np.add(squares, _ROUNDING_VARIANCE)).sum() + linear @ linear + nonlinear @ nonlinear
            )
        return float(values[0]), (values[1:] - values[0]) / _STEP

    def share(self, parameters: Values, errors: Sequence[Values]) -> float:
        """Most likely share, by the forecasts of each block of days with the coefficients of the others.

        `errors` are those of the cases.
        """
        far = [_Case.of(self._training, horizon_min, 1.0) for horizon_min in _FAR_MIN]
        far_errors = [of_horizon[:, 0] for of_horizon in self.errors(parameters[None], far)]
        days, readings = self._training.days, self._training.reading_mg_dl
        block_of = np.repeat(np.arange(days) * _BLOCKS // days, SAMPLES_PER_DAY)
        differing, read = [], []
        for block in range(_BLOCKS):
            others, other_errors = [], []
            for case, of_horizon in zip(self.cases, errors, strict=True):
                there = block_of[case.origins + case.horizon] != block
                if there.any():
                    others.append(case._replace(origins=case.origins[there]))
                    other_errors.append(of_horizon[there])
            coefficients = self.coefficients(other_errors, others)
            mean_mg_dl = np.nanmean(readings[block_of != block])
            for case, of_horizon in zip(far, far_errors, strict=True):
                targets = case.origins + case.horizon
                there = block_of[targets] == block
                error = of_horizon[there, 0] - of_horizon[there, 1:] @ coefficients
                read.append(readings[targets[there]] - mean_mg_dl)
                differing.append(read[-1] - error)
        x, y = np.concatenate(differing), np.concatenate(read)
        mean, sd = _SHARE
        variance = np.mean((y - x) ** 2) if x.size else 1.0
        weight = _FORECASTS_PER_DAY * days / (max(x.size, 1) * max(variance, _ROUNDING_VARIANCE))
        return float(np.clip((weight * (x @ y) + mean / sd**2) / (weight * (x @ x) + 1.0 / sd**2), 0.0, 1.0))

    def maximum(self) -> Values:
        """Most likely parameters ``(8,)``, within three standard deviations of the prior."""
        start, reach = self._log_median, 3.0 * self._log_sd
        result = scipy.optimize.minimize(
            self.value,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(start - reach, start + reach, strict=True)),
            options={"maxiter": 25, "ftol": 1e-5},
        )
        parameters: Values = np.exp(result.x)
        return parameters


@dataclass(frozen=True)
class FittedKalman:
    """The filter with the parameters of a person."""

    parameters: Values
    """Time constants and noises ``(8,)``, in the order of the prior."""
    coefficients: Values
    """Coefficients ``(12,)``: ``-S, R, b_0``, those of the daily waves, and ``R_u``."""
    usual: UsualDay
    mean_mg_dl: float = 0.0
    """Mean of the readings of training."""
    share: float = 1.0
    """Part of what differs from that mean that a forecast keeps over hours."""

    @property
    def fall_mg_dl_U(self) -> float:
        """Largest fall of glucose by 1 U."""
        return -float(self.coefficients[0])

    @property
    def rise_mg_dl_g(self) -> float:
        """Largest rise of glucose by 1 g of carbohydrate."""
        return float(self.coefficients[1])

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        """Forecasts by the exact filter, which has its own variance at each sample."""
        parameters = self.parameters[None]
        system = unexplained_system(parameters)
        explained = _Explained.of(parameters, record, self.usual, future_known=future_known)
        readable = np.isfinite(record.reading_mg_dl)
        rest = np.where(readable, record.reading_mg_dl - explained.at_samples()[:, 0] @ self.coefficients, 0.0)
        [transition], [noise] = system.transition, system.process_noise
        start = scipy.linalg.solve_discrete_lyapunov(transition, noise)
        gains, covariance = exact_gains(system, start, readable)
        states = filtered(system, gains[:, None], rest[:, None, None])[origins, 0, :, 0]
        mean, variance = np.empty((2, origins.size, horizons.size))
        for place, horizon in enumerate(horizons.tolist()):
            row = system.readout @ np.linalg.matrix_power(transition, horizon)
            ahead = explained.ahead(origins, horizon)[:, 0]
            mean[:, place] = ahead @ self.coefficients + states @ row
            # the variance of the noise on the way is what the stationary variance leaves
            on_the_way = system.readout @ start @ system.readout - row @ start @ row
            variance[:, place] = (
                np.einsum("i,oij,j->o", row, covariance[origins], row) + on_the_way + system.reading_variance[0]
            )
        kept = np.interp(SAMPLE_MIN * horizons, _SHARED_MIN, (1.0, self.share))
        return GlucoseForecast(self.mean_mg_dl + kept * (mean - self.mean_mg_dl), variance)


class Kalman(ForecastMethod, name="kalman"):
    """Kalman filter with insulin, carbohydrate, an unexplained appearance of glucose, a drift and the time of day."""

    individual: Annotated[
        bool, About("Whether time constants and noises are fitted to the person; else they are those of the prior.")
    ] = True
    insulin_rule: Annotated[
        float,
        About(
            "Largest fall of glucose by 1 U before the record, times the total daily dose.", above=0.0, at_most=5000.0
        ),
    ] = 1000.0
    insulin_spread: Annotated[
        float, About("Relative standard deviation of that fall before the record.", at_least=0.01, at_most=2.0)
    ] = 0.3

    def predictor(self, training: GriddedRecord) -> Predictor:
        """Filter with the most likely parameters."""
        return self.fitted(training)

    def fitted(self, training: GriddedRecord) -> FittedKalman:
        """Filter with the most likely parameters, and its band not yet scaled."""
        prior = _linear_prior(training.total_daily_dose_U, self.insulin_rule, self.insulin_spread)
        likelihood = _Likelihood(training, prior)
        parameters = likelihood.maximum() if self.individual else np.exp(_log_prior()[0])
        errors = [of_horizon[:, 0] for of_horizon in likelihood.errors(parameters[None], likelihood.cases)]
        return FittedKalman(
            parameters,
            likelihood.coefficients(errors, likelihood.cases),
            usual_day(training),
            float(np.nanmean(training.reading_mg_dl)),
            likelihood.share(parameters, errors),
        )
