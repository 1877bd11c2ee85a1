"""Twin of a person: what was found, how sure it is, how well it predicts, and what the record did not tell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.grid import SAMPLE_MIN, GriddedRecord
from glucoloop.forecasts.method import METHODS, ForecastMethod, scaled
from glucoloop.forecasts.scores import DAY, ForecastErrors, forecast_errors
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population
from glucoloop.patients.table import PeopleTable
from glucoloop.patients.variation import JointVariation, Variation
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.twins.extended import working_mg_dl
from glucoloop.twins.fit import Mode, find_mode
from glucoloop.twins.forecast import TwinPredictor
from glucoloop.twins.prior import Prior
from glucoloop.units import MU_PER_U

Values = npt.NDArray[np.float64]

TWIN: Final = "twin"
"""Name of the person in a table of people."""
HORIZONS_MIN: Final = (30.0, 60.0, 120.0, 240.0)
_MIN_MEALS: Final = 3
_LEANT_ON: Final = 0.2
"""Part of the usual carbohydrate in forecasts from which on it is told."""
_UNIDENTIFIED: Final = 0.9
"""Ratio of the standard deviations after and before, from which on the record has not told a parameter."""
_MIN_MEALS_A_DAY: Final = 2.0
_MIN_ACTIVE: Final = 0.7
_WELL_COVERED_PCT: Final = (75.0, 98.0)
_INTERVAL_SD: Final = 1.6448536269514722
"""Half width of an interval of 90 % in standard deviations."""
_RISE_MG_DL: Final = 60.0
_RISE: Final = 18
"""Samples, 90 min, within which glucose rises by 60 mg/dl or more."""
_BEFORE: Final = 12
"""Samples, 1 h, before a rise in which its carbohydrate may be entered."""


@dataclass(frozen=True)
class HorizonCheck:
    """Forecasts of the days held out at one horizon, beside the mean of the earlier readings."""

    horizon: str
    errors: ForecastErrors
    by_mean_rmse_mg_dl: float
    by_time_of_day_rmse_mg_dl: float

    @property
    def rmse_mg_dl(self) -> float:
        """Root of the mean squared error of the twin."""
        return _rmse(self.errors)

    @property
    def covered_pct(self) -> float:
        """Readings within their intervals of 90 %."""
        return 100.0 * float(self.errors.covered.mean())

    def row(self) -> dict[str, Any]:
        """Plain values of the check."""
        return {
            "horizon": self.horizon,
            "readings": int(self.errors.t_min.size),
            "rmse_mg_dl": self.rmse_mg_dl,
            "by_mean_rmse_mg_dl": self.by_mean_rmse_mg_dl,
            "by_time_of_day_rmse_mg_dl": self.by_time_of_day_rmse_mg_dl,
            "covered_pct": self.covered_pct,
        }


@dataclass(frozen=True, kw_only=True)
class Twin:
    """A person's parameters on a family of patients: posterior, and the check of it."""

    mode: Mode
    record: GriddedRecord
    held_out_days: int
    checks: tuple[HorizonCheck, ...]
    """Checks at each horizon, and of the day from midnight last; none without days held out."""
    day: ForecastErrors
    """Forecasts from midnight of the days held out, or of the last days that were used."""
    usual_share: float
    """Part of the carbohydrate to come that forecasts take from the usual day, although meals are entered."""

    @property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return self.mode.patient.prior

    @property
    def patient(self) -> str:
        """Name of the family."""
        return self.prior.patient

    @property
    def training(self) -> GriddedRecord:
        """Days whose readings were used."""
        return self.record.of_days(0, self.record.days - self.held_out_days)

    @property
    def log_mean(self) -> Values:
        """``(parameters,)`` logarithms of the most likely values."""
        result: Values = self.prior.mean + self.prior.factor @ self.mode.p[: len(self.prior.parameters)]
        return result

    @property
    def log_covariance(self) -> Values:
        """``(parameters, parameters)`` covariance of the logarithms."""
        n = len(self.prior.parameters)
        result: Values = self.prior.factor @ self.mode.covariance[:n, :n] @ self.prior.factor.T
        return result

    @property
    def values(self) -> dict[str, float]:
        """Most likely value of each parameter, and those that were known."""
        result = dict(zip(self.prior.parameters, map(float, np.exp(self.log_mean)), strict=True))
        return {**result, **self.prior.known}

    @property
    def profile(self) -> dict[str, float]:
        """Therapy by the record: mean basal rate, dose of a day, and carbohydrate for a unit of all boluses."""
        record, carbs_g = self.record, float(self.record.carbs_g.sum())
        bolus_U = float((record.user_bolus_U + record.automatic_bolus_U).sum())
        dose = {"total_daily_dose_U": record.total_daily_dose_U}
        if record.basal_U.any():
            dose["basal_mU_min"] = MU_PER_U / SAMPLE_MIN * float(record.basal_U.mean())
        return {**dose, "carb_ratio_g_U": carbs_g / bolus_U} if bolus_U > 0.0 and carbs_g > 0.0 else dose

    @property
    def predicts(self) -> bool | None:
        """Whether it forecasts the day from midnight better than the mean does; None where nothing was held out."""
        if not self.checks:
            return None
        return self.checks[-1].rmse_mg_dl < self.checks[-1].by_mean_rmse_mg_dl

    def person(self) -> Population:
        """The twin as a population of one person, called ``twin``."""
        table = PeopleTable(
            names=(TWIN,),
            values={name: (value,) for name, value in self.values.items()},
            profile={name: (value,) for name, value in self.profile.items()},
        )
        return Population(TWIN, (), "found from a record", self.patient, table)

    def posterior(self) -> Population:
        """People drawn from the posterior, as a population."""
        joint = JointVariation(
            parameters=self.prior.parameters,
            mean=tuple(map(float, np.exp(self.log_mean))),
            covariance=tuple(tuple(map(float, row)) for row in self.log_covariance),
            scale="log",
        )
        known = tuple(
            Variation(parameter=name, distribution="uniform", centre=value, spread_pct=_NEXT_TO_NOTHING_PCT)
            for name, value in self.prior.known.items()
        )
        return Population(f"{TWIN}-posterior", (joint, *known), "who the record could be of", self.patient)

    def rows(self) -> list[dict[str, Any]]:
        """Parameters with intervals of 90 %, of the population before and of the twin after."""
        meanings = patient_entry(self.patient).meanings
        sd = np.sqrt(np.diag(self.log_covariance))
        result = []
        for k, name in enumerate(self.prior.parameters):
            reach, before = np.exp(_INTERVAL_SD * sd[k]), np.exp(_INTERVAL_SD * self.prior.sd[k])
            value, usual = float(np.exp(self.log_mean[k])), float(np.exp(self.prior.mean[k]))
            result.append(
                {
                    "parameter": name,
                    "meaning": meanings.get(name, ""),
                    "value": value,
                    "low": value / reach,
                    "high": value * reach,
                    "population_median": usual,
                    "population_low": usual / before,
                    "population_high": usual * before,
                    "width_of_prior_pct": float(100.0 * sd[k] / self.prior.sd[k]),
                }
            )
        return result

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Parameters of which the record says next to nothing."""
        return tuple(row["parameter"] for row in self.rows() if row["width_of_prior_pct"] > 100.0 * _UNIDENTIFIED)

    def verdict(self) -> str:
        """Sentence on whether the twin is to be relied on."""
        if not self.checks:
            return "No days were held out, so nothing checks this twin; do not rely on it."
        day = self.checks[-1]
        errors = (
            f"on the day from midnight it errs by {day.rmse_mg_dl:.1f} mg/dl, and the mean of the earlier readings by "
            f"{day.by_mean_rmse_mg_dl:.1f} mg/dl"
        )
        if self.predicts:
            return f"The twin predicts the {how_many(self.held_out_days, 'day')} held out: {errors}."
        return f"The twin does not predict this person: {errors}. Do not rely on it."

    def warnings(self) -> Iterator[str]:
        """Sentences on what the record did not tell, and on a twin that should not be trusted."""
        training, plain = self.training, self.on_record()
        a_day = np.count_nonzero(training.carbs_g) / training.days
        if a_day < _MIN_MEALS_A_DAY:
            yield f"There are {a_day:.1f} meals a day in the record; what was not entered stands as unexplained."
        active = float(np.isfinite(training.reading_mg_dl).mean())
        if active < _MIN_ACTIVE:
            yield f"The sensor was active in {100.0 * active:.0f} % of the time; the consensus asks for 70 %."
        yield from record_sentences(plain)
        if self.usual_share > _LEANT_ON:
            yield (
                f"Forecasts take {100.0 * self.usual_share:.0f} % of the carbohydrate to come from the usual day: what "
                "is entered tells too little of it."
            )
        if self.unidentified:
            yield (
                f"The record says next to nothing of {', '.join(self.unidentified)}: the twin has there what the "
                "population has, and the interval is as wide."
            )
        if self.checks:
            covered_pct, (least, most) = self.checks[-1].covered_pct, _WELL_COVERED_PCT
            if not least <= covered_pct <= most:
                yield (
                    f"Of the readings of the days held out {covered_pct:.0f} % lie within the intervals of 90 %, so "
                    f"the intervals are too {'narrow' if covered_pct < least else 'wide'} for this record."
                )

    def on_record(self) -> dict[str, Any]:
        """Plain values of the record."""
        record = self.record
        return {
            "first": f"{record.first:%Y-%m-%d}",
            "days": record.days,
            "fitted_days": self.training.days,
            "meals": int(np.count_nonzero(record.carbs_g)),
            "readings": int(np.isfinite(record.reading_mg_dl).sum()),
            "total_daily_dose_U": record.total_daily_dose_U,
            "automatic_insulin_pct": record.automatic_insulin_pct,
            "rises_without_carbs_pct": rises_without_carbs_pct(record),
        }

    def plain(self) -> dict[str, Any]:
        """Everything but the forecasts, as plain values."""
        mode, prior = self.mode, self.prior
        noises = mode.patient.noises(mode.p)
        return {
            "verdict": self.verdict(),
            "predicts": self.predicts,
            "patient": self.patient,
            "population": prior.population,
            "parameters": self.rows(),
            "known": dict(prior.known),
            "profile": self.profile,
            "filter": {
                "parameters": list(prior.parameters),
                "prior_mean": prior.mean.tolist(),
                "prior_factor": prior.factor.tolist(),
                "coordinates": mode.p.tolist(),
                "covariance": mode.covariance.tolist(),
                "mean_mg_dl": float(np.nanmean(self.training.reading_mg_dl)),
                "steps": mode.patient.steps,
                "site": mode.patient.site,
            },
            "unexplained": {name: float(value) for name, value in noises.items()},
            "fall_mg_dl_U": self.fall_mg_dl_U,
            "usual_carbs_pct": 100.0 * self.usual_share,
            "record": self.on_record(),
            "checks": [check.row() for check in self.checks],
            "unidentified": list(self.unidentified),
        }

    @property
    def fall_mg_dl_U(self) -> float:
        """Largest fall of glucose by 1 U."""
        mean = float(np.nanmean(self.training.reading_mg_dl))
        return self.mode.patient.fall_mg_dl_U(self.mode.p, working_mg_dl(mean))


def find_twin(
    record: GriddedRecord,
    population: Population,
    *,
    known: dict[str, float] | None = None,
    held_out_days: int = 2,
    tell: Callable[[str], None] = lambda text: None,
) -> Twin:
    """Find the twin of a person, and check it.

    Parameters
    ----------
    record : GriddedRecord
        Days of a record.
    population : Population
        People of the family, whose differences are the prior.
    known : dict of str to float, optional
        Parameters that are known of the person, such as ``weight_kg``.
    held_out_days : int
        Last days of the record whose readings are not used, and forecast; 0 for none.
    tell : function
        Function that is called with a text for each step.

    Raises
    ------
    Refusal
        If too few days, meals or doses are left to find a twin, or none can be found.
    """
    first_day = record.days - held_out_days
    if first_day < 1:
        raise Refusal(f"it has {how_many(record.days, 'day')} and {held_out_days} are held out; hold out fewer")
    training = record.of_days(0, first_day)
    ForecastMethod.refuse_few_days(training)
    meals = int(np.count_nonzero(training.carbs_g))
    if meals < _MIN_MEALS:
        raise Refusal(
            f"it has {how_many(meals, 'meal')} in the days that are used; a twin is found from {_MIN_MEALS} meals or "
            "more with their carbohydrate"
        )
    mode = find_mode(population, training, known, tell=tell)
    predictor = TwinPredictor.of(mode, training)
    tell("bands")
    banded = scaled(predictor, training)
    if not held_out_days:
        day = forecast_errors(banded, record, max(first_day - 2, 1), (), future_known=True)[DAY]
        return Twin(mode=mode, record=record, held_out_days=0, checks=(), day=day, usual_share=predictor.usual_share)
    if not record.of_days(first_day, record.days).days_with_readings:
        raise Refusal("the days that are held out have no readings; hold out more days, or none")
    errors, by_mean, by_time_of_day = (
        forecast_errors(method, record, first_day, HORIZONS_MIN, future_known=True)
        for method in (banded, *(METHODS.choose(name).fit(training) for name in ("mean", "time-of-day")))
    )
    checks = tuple(
        HorizonCheck(horizon, of_horizon, _rmse(by_mean[horizon]), _rmse(by_time_of_day[horizon]))
        for horizon, of_horizon in errors.items()
        if of_horizon.t_min.size
    )
    return Twin(
        mode=mode,
        record=record,
        held_out_days=held_out_days,
        checks=checks,
        day=errors[DAY],
        usual_share=predictor.usual_share,
    )


def _rmse(errors: ForecastErrors) -> float:
    return float(np.sqrt(np.mean(errors.error_mg_dl**2)))


def rises_without_carbs_pct(record: GriddedRecord) -> float | None:
    """Percentage of the rises by 60 mg/dl or more in 90 min with no carbohydrate from 1 h before to their end."""
    readings, eaten = record.reading_mg_dl, np.concatenate([[0], np.cumsum(record.carbs_g > 0.0)])
    rises, without, sample = 0, 0, 0
    while sample + _RISE < readings.size:
        rise = readings[sample + _RISE] - readings[sample]
        if not rise >= _RISE_MG_DL:
            sample += 1
            continue
        rises += 1
        without += int(eaten[sample + _RISE + 1] == eaten[max(sample - _BEFORE, 0)])
        sample += _RISE
    return 100.0 * without / rises if rises else None


def record_sentences(record: dict[str, Any]) -> Iterator[str]:
    """Sentences on what a record lacks, of its plain values."""
    without = record["rises_without_carbs_pct"]
    if without is not None:
        yield (
            f"Of the rises of glucose by {_RISE_MG_DL:.0f} mg/dl or more in {SAMPLE_MIN * _RISE:.0f} min, "
            f"{without:.0f} % have no carbohydrate entered near them."
        )
    automatic = record["automatic_insulin_pct"]
    if automatic:
        yield (
            f"Automation dosed {automatic:.0f} % of the insulin. Such doses follow glucose, so the record tells little "
            "of how strongly insulin acts: that stays near the rule over the daily dose."
        )


_NEXT_TO_NOTHING_PCT: Final = 1e-6
"""Spread of a parameter that is known."""
