"""Twin of a person: what was found, how sure it is, and what the record did not tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.joint import JointVariation
from glucoloop.patients.population import Population
from glucoloop.patients.table import PeopleTable
from glucoloop.patients.variation import Variation
from glucoloop.text import how_many
from glucoloop.twins.days import RecordedDays
from glucoloop.twins.noise import Noise
from glucoloop.twins.prior import Prior
from glucoloop.units import MIN_PER_DAY

Values = npt.NDArray[np.float64]

TWIN: Final = "twin"
"""Name of the person in a table of people."""
_UNIDENTIFIED: Final = 0.9
"""Ratio of the standard deviations after and before, from which on the record has not told a parameter."""
_FEW_MEALS_A_DAY: Final = 2.0
_FEW_DAYS: Final = 2.0
_MIN_ACTIVE: Final = 0.7
_WELL_COVERED_PCT: Final = (80.0, 98.0)
_INTERVAL_SD: Final = 1.6448536269514722
"""Half width of an interval of 90 % in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Readings of days that were not used, ``(readings,)``, and their prediction with intervals of 90 %."""

    t_min: Values
    reading_mg_dl: Values
    predicted_mg_dl: Values
    low_mg_dl: Values
    high_mg_dl: Values
    by_population_rmse_mg_dl: float
    """Error of the median of the population, in place of the twin."""
    by_mean_rmse_mg_dl: float
    """Error of the mean of the readings before."""

    @property
    def rmse_mg_dl(self) -> float:
        """Root of the mean squared error of the prediction."""
        return float(np.sqrt(np.mean((self.reading_mg_dl - self.predicted_mg_dl) ** 2)))

    @property
    def covered_pct(self) -> float:
        """Readings within their intervals."""
        return float(100.0 * np.mean((self.reading_mg_dl >= self.low_mg_dl) & (self.reading_mg_dl <= self.high_mg_dl)))


@dataclass(frozen=True, kw_only=True)
class Twin:
    """A person's parameters on a family of patients: posterior, and the check of it."""

    prior: Prior
    log_mean: Values
    """``(parameters,)`` logarithms of the most likely values."""
    log_covariance: Values
    """``(parameters, parameters)`` covariance of the logarithms."""
    noise: Noise
    days: RecordedDays
    fitted_min: tuple[float, float]
    """Time of the record whose readings were used."""
    fit_rmse_mg_dl: float
    agreeing_starts: int
    """Number of starts that ended where the best one did."""
    starts: int
    drawn: Values
    """``(people, coordinates)`` the twin, and people drawn from its posterior, see `twins.trajectory.Simulator`."""
    courses_mg_dl: Values
    """Glucose of these people at the sensor ``(people, samples + 1)`` under the recorded doses."""
    held_out: HeldOut | None = None

    @property
    def patient(self) -> str:
        """Name of the family."""
        return self.prior.patient

    @property
    def fitted_days(self) -> float:
        """Length of the time whose readings were used."""
        return (self.fitted_min[1] - self.fitted_min[0]) / MIN_PER_DAY

    @property
    def fitted_meals(self) -> int:
        """Number of meals in that time."""
        begin, end = self.fitted_min
        return int(np.count_nonzero(self.days.carbs_g[(self.days.meal_min >= begin) & (self.days.meal_min < end)]))

    @property
    def values(self) -> dict[str, float]:
        """Most likely value of each parameter, and those that were known."""
        result = dict(zip(self.prior.parameters, map(float, np.exp(self.log_mean)), strict=True))
        return {**result, **self.prior.known}

    @property
    def profile(self) -> dict[str, float]:
        """Therapy by the record: dose of a day, and carbohydrate for a unit of all boluses."""
        ratio = self.days.carb_ratio_g_U
        dose = {"total_daily_dose_U": self.days.total_daily_dose_U}
        return dose if ratio is None else {**dose, "carb_ratio_g_U": ratio}

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

    def warnings(self) -> Iterator[str]:
        """Sentences on what the record did not tell, and on a twin that should not be trusted."""
        a_day = self.fitted_meals / self.fitted_days
        active = self.days.active_share(*self.fitted_min)
        if self.fitted_days < _FEW_DAYS:
            yield f"The readings used are of {self.fitted_days:.1f} days, which is short: give a week or two."
        if a_day < _FEW_MEALS_A_DAY:
            yield f"There are {a_day:.1f} meals a day in the record; where meals were not entered, the twin is wrong."
        if active < _MIN_ACTIVE:
            yield f"The sensor was active in {100.0 * active:.0f} % of the time; the consensus asks for 70 %."
        if self.unidentified:
            yield (
                f"The record says next to nothing of {', '.join(self.unidentified)}: the twin has there what the "
                "population has, and the interval is as wide."
            )
        if self.agreeing_starts < 2 <= self.starts:
            yield f"Only one of {how_many(self.starts, 'start')} ended at this twin; there may be another one as good."
        held_out = self.held_out
        if held_out is None:
            yield "No days were held out, so nothing checks this twin."
            return
        if held_out.rmse_mg_dl > held_out.by_mean_rmse_mg_dl:
            yield (
                f"On the days held out the twin errs by {held_out.rmse_mg_dl:.0f} mg/dl and the mean of the earlier "
                f"readings by {held_out.by_mean_rmse_mg_dl:.0f} mg/dl: it does not predict this person; "
                "do not rely on it."
            )
        least, most = _WELL_COVERED_PCT
        if not least <= held_out.covered_pct <= most:
            yield (
                f"Of the readings held out {held_out.covered_pct:.0f} % lie within the intervals of 90 %, so the "
                f"intervals are too {'narrow' if held_out.covered_pct < least else 'wide'} for this record."
            )

    def plain(self) -> dict[str, Any]:
        """Everything but the courses, as plain values."""
        held_out, days = self.held_out, self.days
        return {
            "patient": self.patient,
            "population": self.prior.population,
            "parameters": self.rows(),
            "known": dict(self.prior.known),
            "profile": self.profile,
            "posterior": {
                "parameters": list(self.prior.parameters),
                "log_mean": self.log_mean.tolist(),
                "log_covariance": self.log_covariance.tolist(),
                "start": float(self.drawn[0, -1]),
            },
            "noise": vars(self.noise),
            "record": {
                "first": f"{days.first:%Y-%m-%d %H:%M}",
                "fitted_days": self.fitted_days,
                "meals": days.meals,
                "fitted_meals": self.fitted_meals,
                "readings": int(days.reading_min.size),
                "total_daily_dose_U": days.total_daily_dose_U,
            },
            "fit_rmse_mg_dl": self.fit_rmse_mg_dl,
            "starts": self.starts,
            "agreeing_starts": self.agreeing_starts,
            "held_out": None
            if held_out is None
            else {
                "readings": int(held_out.t_min.size),
                "rmse_mg_dl": held_out.rmse_mg_dl,
                "by_population_rmse_mg_dl": held_out.by_population_rmse_mg_dl,
                "by_mean_rmse_mg_dl": held_out.by_mean_rmse_mg_dl,
                "covered_pct": held_out.covered_pct,
            },
            "unidentified": list(self.unidentified),
        }


_NEXT_TO_NOTHING_PCT: Final = 1e-6
"""Spread of a parameter that is known."""
