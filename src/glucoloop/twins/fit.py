"""Search for the twin of a person: the likelihood of forecasts at several horizons, with the prior of the family.

In coordinates ``p`` in which the prior is standard normal, the twin minimises::

    sum over horizons h of (n_h / 2) log(mean e_h(p)² + 1/12)  +  |p|² / 2  +  (log(fall U / rule) / spread)² / 2

where ``e_h`` are the errors of forecasts from origins of the record (`twins.extended`), `fall` is the largest fall of
glucose by 1 U and `U` the insulin of a day. ``n_h`` is the number of independent forecasts, eight a day shared by all
horizons. Fitted to one step alone, a filter explains readings by what is unexplained; the horizons make it find what
meals and insulin do over hours. The doses to come are those of `UsualDay.future`, so that doses of automation, which
follow glucose, do not tell of it.

Forecasts find too little effect of insulin where meals are not entered, so that the fall is held near a rule over the
daily dose. The constants of the family that are its sensitivity to insulin have the medians of the population, all by
one factor, with which the median person falls by the rule.

The cost is minimised by Levenberg's and Marquardt's method with exact Jacobians; the weights of the horizons follow
their errors. Around the minimum the posterior is normal (Laplace).

References
----------
G. Cappon, M. Vettoretti, G. Sparacino, S. Del Favero, A. Facchinetti, "ReplayBG: a digital twin-based methodology to
identify a personalized model from type 1 diabetes data and simulate glucose concentrations to assess alternative
therapies", IEEE Trans. Biomed. Eng. 70(11), 2023, 3227-3238: a posterior of a person given a record.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY, GriddedRecord, apart, usual_day
from glucoloop.forecasts.method import origins_of
from glucoloop.patients.population import Population
from glucoloop.refusal import Refusal
from glucoloop.twins.extended import Days, ExtendedPatient, Numbers, ProgramKey, SampleInputs, days_of_record
from glucoloop.twins.prior import prior_of
from glucoloop.units import MU_PER_U

Values = npt.NDArray[np.float64]

RULE: Final = 1250.0
SPREAD: Final = 0.2
_HORIZONS: Final = np.array([6, 12, 24, 36, 48])
"""Horizons of the likelihood, 30 to 240 min [samples]."""
_FORECASTS_PER_DAY: Final = 8.0
"""Number of independent forecasts of a day, over all horizons."""
_WARM_UP: Final = 144
"""Samples, 12 h, after which what was before the record no longer counts."""
_STRIDE: Final = 6
"""Minimum number of samples between origins."""
_ORIGINS_TOGETHER: Final = 512
"""Origins are filled up to a multiple of this, so that few programs are compiled."""
_ROUNDING_VARIANCE: Final = 1.0 / 12.0
"""Variance of the rounding of readings to whole mg/dl [(mg/dl)²]."""
_MIN_DAILY_DOSE_U: Final = 5.0
"""Daily dose below which the prior of the effect of insulin no longer grows."""
_STEPS: Final = 14
_SETTLED: Final = 0.02
"""Fall of the cost, in units of a logarithm of likelihood, below which a search has ended."""
_DAMPING: Final = 1e-2
_MAX_DAMPING: Final = 1e4
_EASED, _RAISED = 0.2, 8.0
_FARTHEST: Final = 5.0
"""Largest coordinate, in standard deviations of the prior."""
_SCALINGS: Final = 6
_SCALED: Final = (0.35, 3.0)
"""Range of the factor on the sensitivities in one of these scalings."""


class Mode(NamedTuple):
    """Most likely coordinates ``(coordinates,)`` of a person, and their covariance."""

    patient: ExtendedPatient
    p: Values
    covariance: Values


class _Expansion(NamedTuple):
    """Cost at some coordinates, its gradient, and its Hessian by Gauss and Newton."""

    cost: float
    gradient: Values
    hessian: Values


def find_mode(
    population: Population,
    training: GriddedRecord,
    known: dict[str, float] | None = None,
    *,
    rule: float = RULE,
    spread: float = SPREAD,
    tell: Callable[[str], None] = lambda text: None,
) -> Mode:
    """Most likely person of a population for the days of training.

    Parameters
    ----------
    population : Population
        People of the family, whose differences are the prior.
    training : GriddedRecord
        Days of a record.
    known : dict of str to float, optional
        Parameters that are known of the person, such as ``weight_kg``.
    rule, spread : float
        Largest fall of glucose by 1 U times the daily dose [mg/dl] before the record, and the standard deviation of its
        logarithm.
    tell : function
        Function that is called with a text for each step.

    Raises
    ------
    Refusal
        If there is no insulin in the record, or nobody near the population can have it.
    """
    if not training.insulin_U.any():
        raise Refusal("it has no insulin, so it does not tell how insulin acts; give a record with insulin")
    fall_mg_dl_U = rule / max(training.total_daily_dose_U, _MIN_DAILY_DOSE_U)
    patient = ExtendedPatient.of(population, prior_of(population, known))
    days = days_of_record(training, float(np.nanmean(training.reading_mg_dl)))
    patient = _scaled_to(patient, days, fall_mg_dl_U)
    target = _Target(patient, training, days, fall_mg_dl_U, spread)
    p = np.zeros(patient.coordinates)
    here, damping = target.at(p), _DAMPING
    if not np.isfinite(here.cost):
        raise Refusal(
            f"the median person of {population.name} cannot have this record; choose another patient, or look at the "
            "doses of the record"
        )
    for step in range(_STEPS):
        damped = here.hessian + damping * np.diag(np.diag(here.hessian))
        tried = np.clip(p - np.linalg.solve(damped, here.gradient), -_FARTHEST, _FARTHEST)
        there = target.at(tried)
        better, fallen = there.cost < here.cost, here.cost - there.cost
        tell(f"step {step + 1}")
        damping *= _EASED if better else _RAISED
        if better:
            p, here = tried, there
        if (better and fallen < _SETTLED) or damping > _MAX_DAMPING:
            break
    return Mode(patient, p, np.asarray(np.linalg.inv(here.hessian), np.float64))


def _scaled_to(patient: ExtendedPatient, days: Days, fall_mg_dl_U: float) -> ExtendedPatient:
    """The patient whose median person falls by 1 U as given, by one factor on the sensitivities to insulin."""
    for _ in range(_SCALINGS):
        fall = patient.fall_mg_dl_U(np.zeros(patient.coordinates), days.working_mg_dl)
        if not (np.isfinite(fall) and fall > 0.0):
            break
        patient = patient.with_sensitivity(float(np.clip(fall_mg_dl_U / fall, *_SCALED)))
    return patient


class _Target:
    """Cost that is minimised."""

    def __init__(
        self, patient: ExtendedPatient, training: GriddedRecord, days: Days, fall_mg_dl_U: float, spread: float
    ) -> None:
        self._days, self._log_fall, self._spread = days, np.log(fall_mg_dl_U), spread
        origins = apart(origins_of(training, _WARM_UP), _STRIDE)
        last = len(days.reading_mg_dl) - 1
        self._origins = np.append(origins, np.full(-origins.size % _ORIGINS_TOGETHER, last))
        readings = np.append(days.reading_mg_dl, np.nan)
        self._readings = readings[np.minimum(self._origins + _HORIZONS[:, None], last + 1)]
        future = usual_day(training).future(training, known=True).insulin_U
        self._future_mU_min = np.append(future, np.zeros(last + 1 - future.size)) * MU_PER_U / SAMPLE_MIN
        self._count = _FORECASTS_PER_DAY * training.days / _HORIZONS.size
        self._program, self._numbers = _program(patient.fixed), patient.numbers

    def at(self, p: Values) -> _Expansion:
        """Expansion of the cost at coordinates; a cost of infinity for a person who cannot be."""
        (glucose, log_fall), (slopes, fall_slopes) = jax.tree.map(
            np.asarray, self._program(p, self._numbers, self._days, self._future_mU_min, self._origins)
        )
        there = np.isfinite(self._readings)
        if not (np.isfinite(glucose[there]).all() and np.isfinite(log_fall)):
            return _Expansion(np.inf, np.zeros(p.size), np.eye(p.size))
        off = (float(log_fall) - self._log_fall) / self._spread
        cost = 0.5 * float(p @ p + off**2)
        gradient = p + off * fall_slopes / self._spread
        hessian = np.eye(p.size) + np.outer(fall_slopes, fall_slopes) / self._spread**2
        for h in range(_HORIZONS.size):
            error, slope = (glucose[h] - self._readings[h])[there[h]], slopes[h][there[h]]
            if not error.size:
                continue
            square = float(np.mean(error**2)) + _ROUNDING_VARIANCE
            weight = self._count / (square * error.size)
            cost += 0.5 * self._count * np.log(square)
            gradient = gradient + weight * slope.T @ error
            hessian = hessian + weight * slope.T @ slope
        return _Expansion(cost, gradient, hessian)


@functools.lru_cache(maxsize=8)
def _program(fixed: ProgramKey) -> Any:
    """Forecasts ``(horizons, origins)`` and the logarithm of the fall by 1 U, with their changes by coordinates."""

    def forecasts(
        p: jax.Array, numbers: Numbers, days: Days, future_mU_min: jax.Array, origins: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        patient = ExtendedPatient.traced(fixed, numbers)
        person = patient.person(p)
        linear = patient.linearised(person, p, days.working_mg_dl)
        moments = patient.moments(person, days)
        states = patient.filtered(person, p, linear, days, moments)
        appearance_mg_min = days.waves @ linear.level_mg_min

        def inputs_of(later: jax.Array) -> SampleInputs:
            # taken sample by sample: all at once, with their changes, they would be the most of the memory of a fit
            at = jnp.minimum(origins + later, len(days.reading_mg_dl) - 1)
            return SampleInputs(
                insulin_mU_min=future_mU_min[at],
                moments=jnp.moveaxis(moments[at, ..., 0], 0, -1),
                appearance_mg_min=appearance_mg_min[at],
                clock_min=SAMPLE_MIN * (at % SAMPLES_PER_DAY),
            )

        back, later = (linear.return_mg_min, days.mean_mg_dl), jnp.arange(1, _HORIZONS[-1] + 1)
        glucose = patient.ahead(person, p, *back, states[origins].T, later, inputs_of)
        return glucose[_HORIZONS - 1], jnp.log(linear.fall_mg_dl_U)

    @jax.jit
    def expanded(p: jax.Array, *given: Any) -> Any:
        def along(tangent: jax.Array) -> Any:
            return jax.jvp(lambda p: forecasts(p, *given), (p,), (tangent,))

        return jax.vmap(along, out_axes=(None, -1))(jnp.eye(p.size))

    return expanded
