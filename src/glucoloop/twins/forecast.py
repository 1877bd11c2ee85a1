"""Forecasts of a twin, and the twin as a method of forecasting beside the others.

Where counts are wrong and meals are not entered, what is usually eaten at a time of day tells of a meal to come beside
what is entered. A forecast takes `k` of the usual carbohydrate and ``1 - k`` of the entered one. As it is nearly linear
in `k`, that is found by least squares from the forecasts with 0 and with 1 of the days of training, with a prior of 0.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final

from glucoloop._lazy_jax import jax, np
from glucoloop.component.setting import About
from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY, UsualDay, apart, usual_day
from glucoloop.forecasts.method import ForecastMethod, GlucoseForecast, Predictor, origins_of
from glucoloop.units import MU_PER_U

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import GriddedRecord, Places, Values
    from glucoloop.twins.extended import Days, ExtendedPatient, Numbers, ProgramKey
    from glucoloop.twins.fit import Mode

_TOGETHER: Final = 256
"""Origins that are forecast at once."""
_LENGTHS: Final = (48, 288, 576)
"""Numbers of samples of which a forecast has one, so that few programs are compiled."""
_MEMORY: Final = 144
"""Samples, 12 h, for which a meal appears."""
_SHARE_HORIZONS: Final = (48, 96, 144, 192, 288)
"""Horizons, 4 to 24 h, from which `k` is found [samples]: over less time the readings tell what was eaten."""
_WARM_UP: Final = 144
"""Samples, 12 h, after which what was before the record no longer counts."""
_STRIDE: Final = 6
"""Minimum number of samples between origins."""
_FORECASTS_PER_DAY: Final = 8.0
"""Number of independent forecasts of a day, over all horizons."""
_SHARE_SD: Final = 0.5
"""Standard deviation of `k` before the record."""
_MEAL_G: Final = 40.0
"""Meal by which the appearance of others is known where the gut is not linear."""


@dataclass(frozen=True)
class TwinPredictor:
    """A person with coordinates as a fitted method of forecasting; implements `Predictor`."""

    patient: ExtendedPatient
    p: Values
    usual: UsualDay
    mean_mg_dl: float
    """Mean of the readings of training."""
    usual_share: float = 0.0
    """Part of the carbohydrate to come that is the usual one although meals are known."""

    @classmethod
    def of(cls, mode: Mode, training: GriddedRecord) -> TwinPredictor:
        """Method of a person who was found from days of training."""
        result = cls(mode.patient, mode.p, usual_day(training), float(np.nanmean(training.reading_mg_dl)))
        return dataclasses.replace(result, usual_share=result.likely_usual_share(training))

    def likely_usual_share(self, training: GriddedRecord) -> float:
        """Most likely `k` for the days of training."""
        origins, horizons = apart(origins_of(training, _WARM_UP), _STRIDE), np.array(_SHARE_HORIZONS)
        entered, usual = (
            dataclasses.replace(self, usual_share=share)
            .forecast(training.padded(_SHARE_HORIZONS[-1]), origins, horizons, future_known=True)
            .mean_mg_dl
            for share in (0.0, 1.0)
        )
        targets = np.minimum(origins[:, None] + horizons, training.reading_mg_dl.size)
        rest = np.append(training.reading_mg_dl, np.nan)[targets] - entered
        there = np.isfinite(rest)
        if not there.any():
            return 0.0
        change, rest = (usual - entered)[there], rest[there]
        weight = _FORECASTS_PER_DAY * training.days / (rest.size * float(np.mean(rest**2)))
        share = weight * float(change @ rest) / (weight * float(change @ change) + _SHARE_SD**-2)
        return float(np.clip(share, 0.0, 1.0))

    def forecast(
        self, record: GriddedRecord, origins: Places, horizons: Places, *, future_known: bool
    ) -> GlucoseForecast:
        """Forecasts by the equations from the filtered state, and variances of the linearised ones."""
        from glucoloop.twins.extended import days_of_record

        days = days_of_record(record, self.mean_mg_dl)
        program = _programs(self.patient.fixed)
        linear, moments, states = program.filtered(self.p, self.patient.numbers, days)
        moments, states = np.asarray(moments), np.asarray(states)
        appearance = np.asarray(days.waves @ linear.level_mg_min)
        back = (linear.return_mg_min, self.mean_mg_dl)
        future = self.usual.future(record, known=future_known)
        insulin = MU_PER_U / SAMPLE_MIN * future.insulin_U
        share, usual_g = self.usual_share if future_known else 1.0, self.usual.carbs_g[record.clock]
        farthest = int(horizons.max(initial=1))
        length = next((length for length in _LENGTHS if length >= farthest), farthest)
        ahead = np.arange(1, length + 1)[:, None]
        mean = np.empty((origins.size, horizons.size))
        for begin in range(0, origins.size, _TOGETHER):
            some = np.resize(origins[begin : begin + _TOGETHER], _TOGETHER)  # the last block is filled up
            at = np.minimum(some + ahead, record.reading_mg_dl.size - 1)
            meals, more = (1.0 - share) * moments[at], np.zeros(at.shape)
            if share:
                more = share * self._unknown_meals_mg_min(record, usual_g, some, length)
            inputs = (
                insulin[at],
                np.moveaxis(meals[..., 0], 1, -1),
                appearance[at] + more,
                SAMPLE_MIN * (at % SAMPLES_PER_DAY),
            )
            glucose = np.asarray(program.ahead(self.p, self.patient.numbers, back, states[some].T, inputs))
            rest = origins.size - begin
            mean[begin : begin + _TOGETHER] = glucose[horizons - 1, : min(rest, _TOGETHER)].T
        return GlucoseForecast(mean, np.broadcast_to(_variance(linear, farthest)[horizons - 1], mean.shape))

    def _unknown_meals_mg_min(self, record: GriddedRecord, usual_g: Values, origins: Places, samples: int) -> Values:
        """Appearance ``(samples, origins)`` of the meals up to each origin, and of the usual ones after it."""
        of_1_g = self.of_1_g_mg_min(_MEMORY + samples)
        usual = np.convolve(usual_g, of_1_g[:_MEMORY])[: usual_g.size]
        other = np.concatenate([np.zeros(_MEMORY), record.carbs_g - usual_g])
        past = other[origins[:, None] + _MEMORY - np.arange(_MEMORY)]  # newest first
        later = of_1_g[np.arange(_MEMORY)[:, None] + np.arange(1, samples + 1)]
        at = np.minimum(origins + np.arange(1, samples + 1)[:, None], usual.size - 1)
        result: Values = usual[at] + (past @ later).T
        return result

    def of_1_g_mg_min(self, samples: int) -> Values:
        """Mean appearance of 1 g of carbohydrate in each sample from that of the meal on."""
        moments = np.asarray(_programs(self.patient.fixed).moments(self.p, self.patient.numbers, samples))
        result: Values = moments[:, :, 0, 0].mean(axis=1) / _MEAL_G
        return result


@dataclass(frozen=True)
class _Programs:
    """Compiled functions of the people of a prior."""

    filtered: Any
    ahead: Any
    moments: Any


@functools.lru_cache(maxsize=8)
def _programs(fixed: ProgramKey) -> _Programs:
    from glucoloop.twins.extended import Days, ExtendedPatient, SampleInputs

    @jax.jit
    def filtered(p: jax.Array, numbers: Numbers, days: Days) -> Any:
        patient = ExtendedPatient.traced(fixed, numbers)
        person = patient.person(p)
        linear = patient.linearised(person, p, days.working_mg_dl)
        moments = patient.moments(person, days)
        return linear, moments, patient.filtered(person, p, linear, days, moments)

    @jax.jit
    def ahead(p: jax.Array, numbers: Numbers, back: Any, states: jax.Array, inputs: tuple[Any, ...]) -> jax.Array:
        patient = ExtendedPatient.traced(fixed, numbers)
        return patient.ahead(patient.person(p), p, back[0], back[1], states, SampleInputs(*inputs))

    @functools.partial(jax.jit, static_argnums=2)
    def moments(p: jax.Array, numbers: Numbers, samples: int) -> jax.Array:
        patient = ExtendedPatient.traced(fixed, numbers)
        empty = np.zeros(samples)
        meal = Days(empty, np.array([0.5 * SAMPLE_MIN]), np.array([_MEAL_G]), empty, empty, 0.0, 0.0)
        return patient.moments(patient.person(p), meal)

    return _Programs(filtered, ahead, moments)


def _variance(linear: Any, samples: int) -> Values:
    """Variance of the reading 1, 2, ... samples after an origin, in units of the noise, ``(samples,)``."""
    A, c, noise = map(np.asarray, (linear.transition, linear.readout, linear.noise))
    variance = float(linear.reading_variance)
    gain, predicted = np.asarray(linear.gain), np.asarray(linear.predicted)
    covariance = predicted - np.outer(gain, c @ predicted)
    result = np.empty(samples)
    for sample in range(samples):
        covariance = A @ covariance @ A.T + noise
        result[sample] = c @ covariance @ c + variance
    return result


class TwinForecast(ForecastMethod, name="twin"):
    """Twin: the equations of a patient in an extended Kalman filter with an unexplained appearance of glucose."""

    patient: Annotated[str, About("Family of patients: `glucoloop list patients`.")] = "hovorka-2004"
    insulin_rule: Annotated[
        float,
        About(
            "Largest fall of glucose by 1 U before the record, times the total daily dose.", above=0.0, at_most=5000.0
        ),
    ] = 1250.0
    insulin_spread: Annotated[
        float, About("Relative standard deviation of that fall before the record.", at_least=0.01, at_most=2.0)
    ] = 0.2

    def predictor(self, training: GriddedRecord) -> Predictor:
        """The twin of the days of training."""
        from glucoloop.patients.catalogue import patient_entry
        from glucoloop.patients.population import population
        from glucoloop.twins.fit import find_mode

        people = population(patient_entry(self.patient).default_population, patient=self.patient)
        mode = find_mode(people, training, rule=self.insulin_rule, spread=self.insulin_spread)
        return TwinPredictor.of(mode, training)
