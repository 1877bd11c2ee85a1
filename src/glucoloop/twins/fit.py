"""Search for the twin of a person: maximum a posteriori, uncertainty, and the prediction of days that were held out.

In coordinates in which the prior is standard normal, the twin minimises::

    |W (y - f(z))|^2 + |z|^2

where f is the simulated glucose at the readings y, and W makes their errors independent (`twins.noise`). It is
minimised by Levenberg's and Marquardt's method with the exact Jacobian of the simulation, from the median of the
population and from people drawn from it; noise and twin are then found in turns. Around the minimum the posterior is
normal with covariance ``(I + J' W' W J)^-1`` (Laplace).

References
----------
G. Cappon, M. Vettoretti, G. Sparacino, S. Del Favero, A. Facchinetti, "ReplayBG: a digital twin-based methodology to
identify a personalized model from type 1 diabetes data and simulate glucose concentrations to assess alternative
therapies", IEEE Trans. Biomed. Eng. 70(11), 2023, 3227-3238.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop.patients.population import Population
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.twins.days import FEWEST_READINGS, RecordedDays
from glucoloop.twins.noise import Noise
from glucoloop.twins.prior import prior_of
from glucoloop.twins.trajectory import WARM_UP_MIN, Simulator
from glucoloop.twins.twin import HeldOut, Twin
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

Values = npt.NDArray[np.float64]

STARTS: Final = 4
DRAWS: Final = 200
_FIRST_STEPS: Final = 15
_STEPS: Final = 8
_TURNS: Final = 3
_SETTLED: Final = 1e-4
"""Relative fall of the cost below which a search has ended."""
_DAMPING: Final = 1e-2
_EASED, _RAISED = 0.2, 5.0
_FARTHEST: Final = 5.0
"""Largest coordinate, in standard deviations of the prior."""
_SAME_COST: Final = 2.0
"""Difference of costs up to which two starts have ended at twins as likely."""
_INTERVAL_PCT: Final = (5.0, 50.0, 95.0)


@dataclass(frozen=True)
class _Searched:
    """State of a search: one row for each start."""

    z: Values
    cost: Values
    residual: Values
    jacobian: Values


class _Target:
    """Cost that is minimised, on the readings of some time."""

    def __init__(self, simulator: Simulator, chosen: npt.NDArray[np.bool_]) -> None:
        self._simulator, self._chosen, days = simulator, chosen, simulator.days
        self.t_min, self._readings = days.reading_min[chosen], days.reading_mg_dl[chosen]

    def at(self, z: Values, noise: Noise) -> _Searched:
        days = self._simulator.days
        glucose, jacobian = self._simulator.with_jacobian(z)
        residual = self._readings - days.at_readings(glucose, self._chosen)
        slopes = days.at_readings(np.moveaxis(jacobian, -1, 1), self._chosen)
        return _Searched(z, self._cost(z, residual, noise), residual, np.moveaxis(slopes, 1, -1))

    def again(self, result: _Searched, noise: Noise) -> _Searched:
        """The same place with another noise."""
        return _Searched(result.z, self._cost(result.z, result.residual, noise), result.residual, result.jacobian)

    def cost_of_courses(self, z: Values, trajectories: Values, noise: Noise) -> Values:
        """Cost ``(people,)`` of people whose glucose is known ``(people, samples + 1)``."""
        return self._cost(z, self._readings - self._simulator.days.at_readings(trajectories, self._chosen), noise)

    def _cost(self, z: Values, residual: Values, noise: Noise) -> Values:
        possible = np.asarray(np.isfinite(residual).all(axis=1))
        white = noise.independent(self.t_min, np.where(possible[:, None], residual, 0.0).T)
        cost = (white**2).sum(axis=0) + (z**2).sum(axis=1)
        return np.asarray(np.where(possible, cost, np.inf), np.float64)

    def search(self, result: _Searched, noise: Noise, steps: int, tell: Callable[[str], None]) -> _Searched:
        """Minimise from where a search is."""
        damping = np.full(len(result.z), _DAMPING)
        for step in range(steps):
            tried = self.at(np.stack([self._step(result, k, noise, damping[k]) for k in range(len(result.z))]), noise)
            better = tried.cost < result.cost
            with np.errstate(invalid="ignore"):
                fallen = np.where(better, 1.0 - tried.cost / result.cost, 0.0)
            settled = (better & (fallen < _SETTLED)) | (~better & (damping > 1e4))
            damping = np.where(better, damping * _EASED, damping * _RAISED)
            result = _Searched(
                *(
                    np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                    for new, old in (
                        (tried.z, result.z),
                        (tried.cost, result.cost),
                        (tried.residual, result.residual),
                        (tried.jacobian, result.jacobian),
                    )
                )
            )
            tell(f"step {step + 1}")
            if settled.all():
                break
        return result

    def _step(self, result: _Searched, k: int, noise: Noise, damping: float) -> Values:
        z = result.z[k]
        if not np.isfinite(result.cost[k]):
            return np.asarray(0.5 * z)  # nearer to the median, who can exist
        white = noise.independent(self.t_min, np.column_stack([result.residual[k], result.jacobian[k]]))
        residual, jacobian = white[:, 0], white[:, 1:]
        information = np.eye(z.size) + jacobian.T @ jacobian
        damped = information + damping * np.diag(np.diag(information))
        step: Values = np.linalg.solve(damped, jacobian.T @ residual - z)
        moved: Values = np.clip(z + step, -_FARTHEST, _FARTHEST)
        return moved

    def covariance(self, result: _Searched, k: int, noise: Noise) -> Values:
        """Covariance of the coordinates about a minimum."""
        jacobian = noise.independent(self.t_min, result.jacobian[k])
        information = np.eye(result.z.shape[1]) + jacobian.T @ jacobian
        return np.asarray(np.linalg.inv(information), np.float64)


def find_twin(
    days: RecordedDays,
    population: Population,
    *,
    known: dict[str, float] | None = None,
    held_out_days: int = 2,
    starts: int = STARTS,
    draws: int = DRAWS,
    seed: int = 0,
    tell: Callable[[str], None] = lambda text: None,
) -> Twin:
    """Find the twin of a person.

    Parameters
    ----------
    days : RecordedDays
        Days of the record.
    population : Population
        People of the family, whose differences are the prior.
    known : dict of str to float, optional
        Parameters that are known of the person, such as ``weight_kg``.
    held_out_days : int
        Last days of the record whose readings are not used, and predicted; 0 for none.
    starts : int
        Places from which the search begins.
    draws : int
        People drawn from the posterior, for the bands.
    seed : int
        Seed of the starts and of the draws.
    tell : function
        Function that is called with a text for each step.

    Raises
    ------
    Refusal
        If too few readings are left to find a twin, or none can be found.
    """
    prior = prior_of(population, known)
    simulator = Simulator.of(population, prior, days)
    end_min = days.length_min - held_out_days * MIN_PER_DAY
    used = (days.reading_min >= WARM_UP_MIN) & (days.reading_min < end_min)
    if np.count_nonzero(used) < FEWEST_READINGS:
        left = how_many(int(np.count_nonzero(used)), "reading")
        raise Refusal(
            f"{left} are left without {WARM_UP_MIN / MIN_PER_H:.0f} h at the start and "
            f"{how_many(held_out_days, 'day')} held out, and a twin needs {FEWEST_READINGS}; give a longer record, or "
            "hold out fewer days"
        )
    rng = np.random.default_rng(seed)
    target, noise = _Target(simulator, used), Noise()
    z = np.vstack([np.zeros(simulator.coordinates), rng.standard_normal((starts - 1, simulator.coordinates))])
    result = target.search(target.at(z, noise), noise, _FIRST_STEPS, tell)
    if not np.isfinite(result.cost).any():
        raise Refusal(
            f"nobody near the people of {population.name} can have this record; choose another patient, or look at the "
            "doses of the record"
        )
    for _ in range(_TURNS):
        best = int(np.argmin(result.cost))
        about_prior = result.residual[best] + result.jacobian[best] @ result.z[best]
        noise = noise.learned(target.t_min, about_prior, result.jacobian[best])
        result = target.search(target.again(result, noise), noise, _STEPS, tell)
    best = int(np.argmin(result.cost))
    mode, covariance = result.z[best], target.covariance(result, best, noise)
    factor = np.linalg.cholesky(covariance)
    scores = rng.standard_normal((draws, mode.size))
    drawn = np.vstack([mode, mode + scores @ factor.T])
    trajectories = simulator.glucose_mg_dl(drawn)
    possible = np.isfinite(trajectories).all(axis=1)
    drawn, trajectories = drawn[possible], trajectories[possible]
    held_out = _held_out(days, simulator, trajectories, noise, end_min, rng) if held_out_days else None
    log_mean = prior.mean + prior.factor @ mode[:-1]
    log_covariance = prior.factor @ covariance[:-1, :-1] @ prior.factor.T
    return Twin(
        prior=prior,
        log_mean=log_mean,
        log_covariance=log_covariance,
        noise=noise,
        days=days,
        fitted_min=(WARM_UP_MIN, end_min),
        fit_rmse_mg_dl=float(np.sqrt(np.mean(result.residual[best] ** 2))),
        agreeing_starts=int(np.count_nonzero(result.cost < result.cost[best] + _SAME_COST)),
        starts=starts,
        drawn=drawn,
        courses_mg_dl=trajectories,
        held_out=held_out,
    )


def _held_out(
    days: RecordedDays,
    simulator: Simulator,
    trajectories: Values,
    noise: Noise,
    end_min: float,
    rng: np.random.Generator,
) -> HeldOut:
    """Prediction of the readings from a time on, without any of them."""
    chosen, before = days.reading_min >= end_min, days.reading_min < end_min
    t_min, readings = days.reading_min[chosen], days.reading_mg_dl[chosen]
    if t_min.size < 2:
        raise Refusal("the days that are held out have no readings; hold out more days, or none")
    predicted = days.at_readings(trajectories, chosen)
    errors = noise.drawn(t_min, len(predicted), rng)
    low, _, high = np.percentile(predicted + errors, _INTERVAL_PCT, axis=0)
    median = days.at_readings(simulator.glucose_mg_dl(np.zeros((1, simulator.coordinates))), chosen)[0]
    return HeldOut(
        t_min=t_min,
        reading_mg_dl=readings,
        predicted_mg_dl=predicted[0],
        low_mg_dl=low,
        high_mg_dl=high,
        by_population_rmse_mg_dl=_rmse(readings - median),
        by_mean_rmse_mg_dl=_rmse(readings - days.reading_mg_dl[before].mean()),
    )


def _rmse(error: Values) -> float:
    return float(np.sqrt(np.mean(error**2)))
