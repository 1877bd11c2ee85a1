"""Doses under which a person's glycemia risk index is as small as a search finds, of all doses that are possible.

Each sample may have any dose that is not negative, so a bolus too, and the person is known exactly. A plan is made
whenever a meal becomes known, and after 6 h at the latest, for the 12 h that follow; it is carried out until the next.

The index counts the points of the grid in its ranges, so that it has no slope. The search first takes the mean distance
of glucose from 72 to 178 mg/dl, of which that below costs ten times as much, and from there the index itself, with its
steps rounded off over some 2 mg/dl, and then 0.5. Of all plans the one with the smallest index is carried out. A slight
pull towards the setpoint chooses among plans in range.

The plan u is found by the method of Levenberg and Marquardt. Where the price of a point is f(g), its slope f' and its
distance from where the price begins d, each step solves the nonnegative least-squares problem (SciPy's, of Lawson and
Hanson)::

    minimise  sum_k (f'_k J_k du + c_k / 2 (J_k du)^2) + lambda / 2 |du|^2   over u + du >= 0,   with c_k = |f'_k| / d_k

and the derivatives J of the simulation; lambda falls when a step does what was foretold. The c_k of reweighted least
squares take the place of the second derivative, which is 0 or negative far from the range. Ten steps are usual, where
SciPy's L-BFGS-B takes hundreds of simulations and ends at prices that are two to three times as high. The search is a
local one, so what it finds can be reached, and better doses may exist.

References
----------
D. C. Klonoff et al., "A glycemia risk index (GRI) of hypoglycemia and hyperglycemia for continuous glucose monitoring
validated by clinician ratings", J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023.
C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, Prentice-Hall, 1974 (SIAM, 1995), ch. 23.
J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., Springer, 2006, ch. 10.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from glucoloop._lazy_jax import scipy
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, on_host
from glucoloop.bounds.optimal_doses import check_known_after, stages
from glucoloop.bounds.trajectory import trajectory_of
from glucoloop.control.design_case import check_sample_time
from glucoloop.meals import Meal, Scenario
from glucoloop.metrics.formulas import glycemia_risk_index
from glucoloop.patients.protocol import Patient
from glucoloop.refusal import Refusal
from glucoloop.simulation.plant import Exogenous, Plant, SampleGrid
from glucoloop.simulation.user_objects import compiled_by_class

Values = npt.NDArray[np.float64]

_PLANNED_MIN: Final = 720.0
"""Time for which doses are planned at once."""
_PLAN_MIN: Final = 360.0
"""Longest time for which a plan is carried out."""
_LOW_MG_DL, _HIGH_MG_DL = 72.0, 178.0
_DEARER_BELOW: Final = 10.0
_ROUNDED_MG_DL: Final = 5.0
_STEPS: Final = ((-1.0, 54.0, 0.6), (-1.0, 70.0, 2.4), (1.0, 250.0, 0.8), (1.0, 180.0, 0.8))
"""Side, bound and height of each step of the index, in the order in which `glycemia_risk_index` takes times beyond."""
_SEARCHES: Final = ((1.0, 0.0, 2.0), (0.05, 1.0, 2.0), (0.02, 1.0, 0.5))
"""Weights of distance and index in each search, and the width over which a step of the index is rounded off.

By that width a step is moved into the range too.
"""
_PULL: Final = 2e-4
"""Price of a squared mg/dl from the setpoint: 30 mg/dl for all the time count as 0.2 of the index."""
_MAX_STEPS: Final = 60
_MIN_GAIN: Final = 1e-3
_MIN_LAMBDA, _FIRST_LAMBDA, _LARGEST_LAMBDA = 1e-6, 1e-2, 1e6
"""Weights of the size of a step, in multiples of the mean square of the derivatives with respect to a dose."""
_WELL, _BADLY = 0.7, 0.3
"""Shares of the gain that was foretold, above which lambda falls, and below which it grows."""


@dataclass(frozen=True)
class LeastRiskDoses:
    """The best doses found and the glucose under them; NumPy arrays of one person."""

    t_min: Values
    """(samples,) times of the doses."""
    insulin_mU_min: Values
    """(samples,) rates from each sample to the next, boluses included."""
    fine_t_min: Values
    """(points,) a grid of one minute, from 0 to the horizon."""
    glucose_mg_dl: Values
    """(points,) glucose on the fine grid."""
    known_after_min: float
    gri: float
    """Glycemia risk index of the points of the fine grid, from 0 to 100; infinite where glucose is not finite."""
    steps: int
    """Number of steps of all searches."""


@checked
@on_host("a search that ends by its own progress cannot be traced")
def least_risk_doses(
    patient: Patient,
    scenario: Scenario | None = None,
    *,
    known_after_min: float = 0.0,
    sample_time_min: float = 5.0,
    start_mU_min: ArrayLike | None = None,
) -> LeastRiskDoses:
    """Doses that keep the glycemia risk index of a patient as small as a local search finds.

    Parameters
    ----------
    patient : Patient
        One person, who is known exactly, with exercise and rhythms.
    scenario : Scenario, optional
        The 50 g oral glucose test by default. The patient starts at steady state. Announcements do not matter.
    known_after_min : float
        Time at which each meal and its size become known, counted from its start, as in `optimal_doses`: 0, or
        `IN_ADVANCE` for all meals from the start of the run.
    start_mU_min : (samples,) array, optional
        Doses from which the search begins, and than which what it finds is never worse; the rate at steady state by
        default.

    Returns
    -------
    LeastRiskDoses
        Doses that are possible, not the best in the strict sense. Where meals become known one after the other, they
        are good for what is known at each moment: a controller that bets on a meal to come could do better.

    Raises
    ------
    ValueError
        For a sample time or horizon out of bounds, a warm-up, doses to start from of another number, or a patient who
        cannot rest at the initial glucose.

    Examples
    --------
    >>> import glucoloop as gl
    >>> from glucoloop.bounds import IN_ADVANCE, least_risk_doses
    >>> day = gl.Scenario([gl.Meal(80.0, 60.0)], 480.0)
    >>> found = least_risk_doses(gl.patient("hovorka-2004"), day, known_after_min=IN_ADVANCE)
    >>> found.gri
    0.0
    """
    scenario = Scenario() if scenario is None else scenario
    check_sample_time(sample_time_min)
    check_known_after(known_after_min)
    fasting = trajectory_of(patient, scenario, sample_time_min, [()])
    samples, rest_mU_min = fasting.samples, fasting.resting_mU_min or 1.0
    plans = _known_meals(stages(scenario, fasting, known_after_min), fasting.grid)
    run = trajectory_of(patient, scenario, sample_time_min, [*plans.values(), scenario.meals])
    planned = min(samples, math.ceil(_PLANNED_MIN / sample_time_min))
    start = None if start_mU_min is None else _start(start_mU_min, samples)
    doses = np.concatenate([np.ones(samples) if start is None else start / rest_mU_min, np.ones(planned)])
    state, steps = jnp.asarray(run.state), 0
    glucose = [np.asarray(run.plant.patient.glucose_mg_dl(state))]
    for member, (first, then) in enumerate(zip(plans, [*plans, samples][1:], strict=True)):
        now = slice(first, first + planned)
        ahead = _Ahead(
            plant=run.plant,
            exogenous=_during(run.exogenous(member), now),
            state=state,
            setpoint_mg_dl=run.setpoint_mg_dl,
            rest_mU_min=rest_mU_min,
        )
        doses[now], number = _least(ahead, doses[now], min(planned, samples - first))
        truly = replace(ahead, exogenous=_during(run.exogenous(len(plans)), now))
        states, inside = _followed(truly, doses[now])
        glucose.append(np.asarray(inside)[: then - first].ravel())
        state, steps = states[then - first - 1], steps + number
    result, insulin = np.concatenate(glucose), rest_mU_min * doses[:samples]
    if start is not None:
        start_mg_dl = run.of_members(len(plans)).glucose_mg_dl(start[:, None])[:, 0]
        if _index(start_mg_dl) < _index(result):
            result, insulin = start_mg_dl, start
    return LeastRiskDoses(
        t_min=fasting.grid.t_min,
        insulin_mU_min=insulin,
        fine_t_min=fasting.grid.fine_t_min,
        glucose_mg_dl=result,
        known_after_min=known_after_min,
        gri=_index(result),
        steps=steps,
    )


def _start(start_mU_min: ArrayLike, samples: int) -> Values:
    """Doses to start from; Refusal of another number of them, or of a dose that is none."""
    start = np.asarray(start_mU_min, float)
    if start.shape != (samples,):
        raise Refusal(f"doses to start from have the shape {start.shape}; give one for each of the {samples} samples")
    if not (np.isfinite(start) & (start >= 0.0)).all():
        raise Refusal("a dose to start from is negative or no number; give finite doses of 0 mU/min or more")
    return start


def _known_meals(announcements: list[tuple[tuple[Meal, ...], int]], grid: SampleGrid) -> dict[int, tuple[Meal, ...]]:
    """Meals that are known to each plan, by the first of its samples."""
    news = {0: (), **{first: meals for meals, first in announcements if first < grid.samples}}
    longest = math.ceil(_PLAN_MIN / grid.sample_time_min)
    plans: dict[int, tuple[Meal, ...]] = {}
    for first, then in zip(news, [*news, grid.samples][1:], strict=True):
        plans |= dict.fromkeys(range(first, then, longest), news[first])
    return plans


def _during(exogenous: Exogenous, now: slice) -> Exogenous:
    """Inputs of some samples; after the end of the run they stay as they were."""

    def during(values: Any) -> Values:
        values = np.asarray(values)[now]
        beyond = [(0, now.stop - now.start - len(values)), *[(0, 0)] * (values.ndim - 1)]
        return np.pad(values, beyond, mode="edge")

    result: Exogenous = jax.tree.map(during, exogenous)
    return result


@pytree
class _Ahead:
    """The time for which doses are planned, from the state at its beginning."""

    plant: Plant
    exogenous: Exogenous
    state: jax.Array
    setpoint_mg_dl: float
    rest_mU_min: float


@compiled_by_class
def _followed(ahead: _Ahead, doses: jax.Array) -> tuple[jax.Array, jax.Array]:
    """State after each sample, and glucose inside it, ``(samples, points)``, under multiples of the basal rate."""

    def one(x: jax.Array, entry: tuple[jax.Array, Exogenous]) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        after, inside = ahead.plant.advance(x, *entry)
        return after, (after, inside[:, 0])

    along = (ahead.rest_mU_min * doses[:, None], ahead.exogenous)
    result: tuple[jax.Array, jax.Array] = jax.lax.scan(one, ahead.state, along)[1]
    return result


@compiled_by_class
def _linearised(ahead: _Ahead, doses: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Derivative of glucose with respect to each dose, ``(points, samples)``, and glucose."""

    def glucose(doses: jax.Array) -> tuple[jax.Array, jax.Array]:
        inside = _followed(ahead, doses)[1].ravel()
        return inside, inside

    result: tuple[jax.Array, jax.Array] = jax.jacfwd(glucose, has_aux=True)(doses)
    return result


def _least(ahead: _Ahead, start: Values, counted: int) -> tuple[Values, int]:
    """Doses with the minimum index in the first samples, those to start from included, and the number of steps."""

    def index(doses: Values) -> float:
        return _index(np.asarray(_followed(ahead, doses)[1])[:counted])

    tried, steps = [start], 0
    for weights in _SEARCHES:
        if steps and index(tried[-1]) == 0.0:
            break  # there is nothing less
        doses, number = _search(ahead, tried[-1], counted, weights)
        tried.append(doses)
        steps += number
    # of equals the last, which the pull has brought near the setpoint
    return min(reversed(tried), key=index), steps


def _search(ahead: _Ahead, doses: Values, counted: int, weights: tuple[float, float, float]) -> tuple[Values, int]:
    """Doses with the minimum mean price of the points in the first samples, and the number of steps."""
    from scipy.optimize import nnls  # a fifth of a second, and only for these bounds

    damping, free = _FIRST_LAMBDA, np.eye(doses.size)
    for step in itertools.count(1):
        J, glucose = (np.asarray(part) for part in _linearised(ahead, doses))
        points = counted * (glucose.size // doses.size)
        price, slope, curvature = _price(glucose[:points], ahead.setpoint_mg_dl, weights)
        if not (np.isfinite(J).all() and np.isfinite(price).all()):
            return doses, step
        root = np.sqrt(curvature / points)
        A, wanted = root[:, None] * J[:points], -root * slope / curvature
        # einsum, since the threads of a BLAS wait for each other longer than such small products take
        now, scale = np.einsum("ij,j->i", A, doses), math.sqrt(np.einsum("ij,ij->", A, A) / doses.size)
        gain, trial = 0.0, doses
        while not gain > 0.0 and damping < _LARGEST_LAMBDA:
            dead_time_min = math.sqrt(damping) * scale
            rows, values = np.vstack([A, dead_time_min * free]), np.concatenate([now + wanted, dead_time_min * doses])
            trial = nnls(rows, values, maxiter=30 * doses.size)[0]
            inside = np.asarray(_followed(ahead, trial)[1]).ravel()[:points]
            gain = float(np.mean(price - _price(inside, ahead.setpoint_mg_dl, weights)[0]))
            moved = np.einsum("ij,j->i", A, trial) - now
            share = gain / max(float(np.sum(moved * (wanted - moved / 2.0))), 1e-12)
            damping *= 0.2 if share > _WELL else 1.0 if share > _BADLY else 5.0
            damping = max(_MIN_LAMBDA, damping)
        if gain > 0.0:
            doses = trial
        if not gain >= _MIN_GAIN or step == _MAX_STEPS:
            break
    return doses, step


def _price(
    glucose: Values, setpoint_mg_dl: float, weights: tuple[float, float, float]
) -> tuple[Values, Values, Values]:
    """Price of each point, its slope, and its curvature, which is above 0."""
    by_distance, by_index, width = weights
    above, below = np.maximum(glucose - _HIGH_MG_DL, 0.0), np.maximum(_LOW_MG_DL - glucose, 0.0)
    dearer = np.where(below > 0.0, _DEARER_BELOW, 1.0)
    beyond = dearer * (above - below)
    rounded = np.hypot(beyond, _ROUNDED_MG_DL)
    far = glucose - setpoint_mg_dl
    price = by_distance * (rounded - _ROUNDED_MG_DL) + _PULL * far**2
    slope = by_distance * dearer * beyond / rounded + 2.0 * _PULL * far
    curvature = by_distance * np.where(beyond == 0.0, 0.0, dearer**2 / rounded) + 2.0 * _PULL
    for side, bound, height in _STEPS:
        into = side * (glucose - bound) / width + 1.0
        share = scipy.special.expit(into)
        steep = by_index * 100.0 * height * share * (1.0 - share) / width
        price += by_index * 100.0 * height * share
        slope += side * steep
        curvature += steep / (width * np.maximum(into + 3.0, 1.0))
    return price, slope, curvature


def _index(glucose_mg_dl: Values) -> float:
    """Glycemia risk index of points; infinite where glucose is not finite."""
    if not np.isfinite(glucose_mg_dl).all():
        return math.inf
    beyond = (100.0 * float(np.mean(side * (glucose_mg_dl - bound) > 0.0)) for side, bound, _ in _STEPS)
    return float(glycemia_risk_index(np, *beyond))
