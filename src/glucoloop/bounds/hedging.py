"""Two-scenario minimax bound: how closely glucose can be kept when sensor noise hides whether a meal is under way.

There are two worlds: either no meal begins or the meal begins; or, later, the meal ends or it goes on and is a fifth
larger. Until the readings tell the worlds apart the doses must be the same in both; from then on the true world is
taken as known. The doses sought are those that make the largest deviation of the worse world as small as possible,
which is a scenario program. Hedging, which means acting on what is only likely, is allowed.

Readings are those of white noise of the standard deviation s. Worlds whose readings differ by d_k are told apart by the
best test, if both are as likely, with the error ::

    Q(d'/2),   d'^2 = sum_k (d_k / s)^2,   Q the upper tail of the normal distribution

In which sense this is a bound is L. Le Cam's two-point argument: see `hedged_doses`.

References
----------
L. Le Cam, Convergence of Estimates under Dimensionality Restrictions, Annals of Statistics 1(1), 1973.
A. B. Tsybakov, Introduction to Nonparametric Estimation, Springer, 2009, ch. 2 (two hypotheses).
D. M. Green, J. A. Swets, Signal Detection Theory and Psychophysics, Wiley, 1966 (d').
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop.bounds.optimal_doses import DosePlan, OptimalDoses, check_samples, collected, first_free_sample
from glucoloop.bounds.trajectory import RunModel, trajectory_of
from glucoloop.control.design_case import check_sample_time
from glucoloop.meals import Meal, Scenario
from glucoloop.patients.protocol import Patient
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal

Values = npt.NDArray[np.float64]

_DISTINGUISHED_ERRORS: Final = (0.25, 0.05)
"""Errors of the test at which worlds count as told apart. At the first some controllers know the world, at the second
nearly all do.
"""
LARGER: Final = 1.2
"""Size of the alternative meal relative to the true one. A larger meal lasts longer, so its readings differ only after
the true meal has ended. With a much larger factor the limits of the pump, not the noise, would decide the result.
"""
_FOLLOWED_MIN: Final = 120.0
"""Time that is followed after the worlds are told apart; by then the largest deviation is long past."""


@dataclass(frozen=True)
class HedgedDoses:
    """The best doses for two worlds that are told apart at one moment; both are followed for two hours from then on."""

    question: str
    """The fact that is known late: whether the meal ``begins``, or whether it ``ends``."""
    error: float
    """Error of the best test at the moment at which the worlds count as told apart."""
    distinguished_after_min: float
    """Time from the start of the meal until the worlds are told apart; infinite if that is not within the run."""
    deviation_mg_dl: float
    """Minimum value that was found for the largest deviation from the setpoint in the worse world."""
    meal: OptimalDoses
    """Doses and glucose in the world of the true meal."""
    other: OptimalDoses
    """Doses and glucose in the other world: no meal, or the larger one."""

    @property
    def converged(self) -> bool:
        """Whether the plan is stationary."""
        return self.meal.converged


def hedged_doses(
    patient: Patient,
    scenario: Scenario,
    noise_variance: float,
    pump_limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    errors: Sequence[float] = _DISTINGUISHED_ERRORS,
    dead_time_min: float = 0.0,
    sample_time_min: float = 5.0,
) -> Iterator[HedgedDoses]:
    """The best doses for a patient whose readings have noise and whose meal is not announced.

    For each error the first result is about whether the meal begins, the second about whether it ends. Doses before the
    start of the meal are basal.

    Parameters
    ----------
    patient : Patient
        One person, who rests at the setpoint until the meal.
    scenario : Scenario
        A scenario with exactly one meal.
    noise_variance : float
        Variance of the white noise on the readings, (mg/dl)^2. Bounds of the noise are left out.
    errors : sequence of float
        Each above 0 and below 0.5.
    dead_time_min : float
        Delay of the readings, rounded to samples.

    Returns
    -------
    iterator of HedgedDoses
        Results, computed one after the other. For the two worlds there is this bound (Le Cam): doses are one function
        of the readings in both, so that a controller that stays below ``deviation_mg_dl`` has told by its doses which
        world it is. It fails in the one or the other with probabilities that sum up to at least twice ``error``: no
        controller is below it in both with a certainty of more than ``1 - error``. It is an estimate all the same: the
        differences of readings are taken under basal doses, and the minimum is a local one.

    Raises
    ------
    ValueError
        For a scenario without just one meal or off the setpoint, no noise, or a number out of bounds.
    """
    check_sample_time(sample_time_min)
    check_samples(scenario.horizon_min, sample_time_min)
    _check_hedging(scenario, noise_variance, errors)
    if not 0.0 <= dead_time_min < math.inf:
        raise Refusal(f"a dead time of {dead_time_min:g} min is not possible; give a finite value, 0 or more")
    meal = scenario.meals[0]
    larger = Meal(LARGER * meal.carbs_g, meal.t_min)
    worlds = trajectory_of(patient, scenario, sample_time_min, [[meal], [], [larger]])
    if not worlds.at_rest:
        raise Refusal(
            "the patient does not rest at the setpoint, so that insulin changes before the meal is known; "
            "leave out the other setpoint or initial glucose"
        )
    basal = np.clip(worlds.resting_mU_min, float(pump_limits.min_mU_min), float(pump_limits.max_mU_min))
    late = round(dead_time_min / sample_time_min)
    readings = worlds.glucose_mg_dl(np.full((worlds.samples, 3), basal))[: -1 : worlds.grid.inside_min.size]

    def both_questions() -> Iterator[HedgedDoses]:
        for question, number in (("begins", 1), ("ends", 2)):
            difference = readings[:, 0] - readings[:, number]
            apart = [min(_first_distinct(difference, noise_variance, error) + late, worlds.samples) for error in errors]
            # One length for all errors, so that what is compiled serves them all.
            followed = min(max(apart) + math.ceil(_FOLLOWED_MIN / sample_time_min), worlds.samples)
            both = worlds.of_members(0, number, samples=followed)
            for error, sample in zip(errors, apart, strict=True):
                yield _hedged(both, scenario, pump_limits, question, error, sample, float(basal))

    return both_questions()


def _check_hedging(scenario: Scenario, noise_variance: float, errors: Sequence[float]) -> None:
    """Refuse a scenario, a noise or errors for which hedging cannot be computed."""
    if len(scenario.meals) != 1:
        raise Refusal(
            f"the bound under sensor noise is for one meal, and the scenario has {len(scenario.meals)}; give one"
        )
    if not 0.0 < noise_variance < math.inf:
        raise Refusal(
            f"readings with a noise variance of {noise_variance:g} tell a meal at once, or never; "
            "give a finite value above 0"
        )
    for error in errors:
        if not 0.0 < error < 0.5:
            raise Refusal(f"an error of {error:g} is not possible; give more than 0, below 0.5")


def _first_distinct(difference_mg_dl: Values, noise_variance: float, error: float) -> int:
    """First sample of differing readings ``(samples,)`` at which the best test of two worlds comes down to an error.

    The error is the probability of the wrong answer where both worlds are as likely. It is the number of samples if
    none does.
    """
    needed = -2.0 * NormalDist().inv_cdf(error)
    return int(np.searchsorted(np.cumsum(difference_mg_dl**2) / noise_variance, needed**2))


def _hedged(
    both: RunModel, scenario: Scenario, limits: DoseLimits, question: str, error: float, apart: int, basal: float
) -> HedgedDoses:
    meal = scenario.meals[0]
    plan = DosePlan.of_course(both, limits, first_free_sample(both.grid.t_min, meal.t_min), apart)
    minimum = plan.least(np.full(both.samples, basal), "deviation")
    calm = plan.calm(minimum, "deviation")
    distinguished_after_min = both.grid.t_min[apart] - meal.t_min if apart < both.samples else math.inf
    in_worlds = [
        collected(
            both.of_members(member),
            scenario,
            plan.doses(calm.v)[:, member],
            minimum,
            minimum.iterations + calm.iterations,
            float(distinguished_after_min),
            "deviation",
        )
        for member in range(2)
    ]
    return HedgedDoses(
        question=question,
        error=error,
        distinguished_after_min=float(distinguished_after_min),
        deviation_mg_dl=minimum.value,
        meal=in_worlds[0],
        other=in_worlds[1],
    )
