"""Prox-linear method: minimise the largest value, or another convex measure, of a nonlinear function of a plan.

The problem is to minimise over the plan v, within linear limits::

    F(v) = sum_j c_j max(0, max_k(+-g_k(v)) - cap_j) + 1/2 sum_k w_k g_k(v)^2 + rho/2 |D v - d|^2

where g is the deviation of glucose from the setpoint on the fine grid. Each step replaces g by its linearisation and
adds ``lambda/2 |dv|^2``, which makes it a strictly convex quadratic program for `qp.solve_qp`; lambda falls when
the linearisation foretold the decrease well, and grows until there is one. At the end an independent linear program
(SciPy's HiGHS) tells how far from stationary the plan is.

This method was chosen by comparison. A sequence of linear programs within a trust region comes as low, but its steps go
to corners, and it needs three times as many. SciPy's SLSQP meets more than a thousand constraints at each step as one
dense system and takes minutes, and the functions of a minimum have kinks, of which `trust-constr` knows nothing.

References
----------
J. V. Burke, M. C. Ferris, A Gauss-Newton method for convex composite optimization, Math. Programming 71, 1995.
A. S. Lewis, S. J. Wright, A proximal method for composite minimization, Math. Programming 158, 2016.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop._kept_programs import kept_jit
from glucoloop.qp import QPSolution, solve_qp

Values = npt.NDArray[np.float64]

_QP_ITERATIONS: Final = 100
_QP_TOLERANCE: Final = 1e-12  # asked for, since the proximal term is small beside the rest; not always reached
_QP_SOUND: Final = 1e-7
_MIN_LAMBDA, _LARGEST_LAMBDA = 1e-8, 1e6
_REACH: Final = 1.0
_MANY_ROWS: Final = 2500
"""Number of rows above which only the constraints that matter are kept; the cost of a program grows with its rows."""
_ROWS_TOGETHER: Final = 512  # numbers of rows are multiples of it, since each number is compiled for
_BROKEN: Final = 1e-8
_FIRST_ROWS: Final = 5
_NEAR_MU_MIN: Final = 1.0


@dataclass(frozen=True)
class Measure:
    """The measure to be minimised; see the head of the file.

    The first entry of a pair is for values below the setpoint.
    """

    cost: tuple[float, float] = (0.0, 0.0)
    cap_mg_dl: tuple[float, float] = (0.0, 0.0)
    joint: bool = False
    """Whether one common maximum of both sides is taken, at the first cost."""
    weight: Values | None = None
    """(points,) weights of squared deviations, multiplied by `below` where glucose is below the setpoint."""
    below: float = 1.0
    moves: float = 0.0
    """Weight rho of the squared moves."""

    def excess(self, g: Values) -> tuple[float, float]:
        """Amount by which glucose is beyond each cap."""
        low = max(0.0, float(-g.min()) - self.cap_mg_dl[0])
        high = max(0.0, float(g.max()) - self.cap_mg_dl[1])
        return (max(low, high), 0.0) if self.joint else (low, high)

    def weights(self, g: Values) -> Values:
        """Weights of the squared deviations."""
        if self.weight is None:
            return np.zeros_like(g)
        weights: Values = self.weight * np.where(g < 0.0, self.below, 1.0)
        return weights

    def value(self, g: Values, moves: Values) -> float:
        """Value of the measure F."""
        largest = float(np.dot(self.cost, self.excess(g)))
        return largest + 0.5 * float(self.weights(g) @ g**2) + 0.5 * self.moves * float(moves @ moves)


@dataclass(frozen=True)
class Limits:
    """Limits ``low <= v <= high`` and ``|D v - d| <= most``; variables that are not free keep their values."""

    low: float
    high: float
    most: float
    D: Values
    """(rows, n) matrix of the moves; rows without a free variable are zero."""
    d: Values
    free: npt.NDArray[np.bool_]
    """(n,) whether each variable is free."""


@dataclass(frozen=True)
class Minimum:
    """Result of a minimisation."""

    v: Values
    g: Values
    value: float
    optimality: float
    """Decrease of F that a linear program predicts if each variable may move by up to 1; 0 for a stationary plan."""
    iterations: int


@kept_jit
def _solve(H: jax.Array, f: jax.Array, G: jax.Array, h: jax.Array) -> QPSolution:
    return solve_qp(H, f, G, h, tolerance=_QP_TOLERANCE, max_iterations=_QP_ITERATIONS)


def minimise(
    deviation: Callable[[Values], Values],
    jacobian: Callable[[Values], Values],
    measure: Measure,
    limits: Limits,
    start: Values,
    *,
    tolerance: float,
    most_iterations: int = 60,
) -> Minimum:
    """Find a local minimum of a measure within linear limits, from a plan ``(n,)`` that keeps them.

    `deviation` and `jacobian` give g ``(points,)`` and its derivative ``(points, n)``. The search ends when a step
    predicts a decrease of F below the tolerance.
    """

    def evaluate(v: Values) -> tuple[Values, float]:
        g = deviation(v)
        return g, measure.value(g, limits.D @ v - limits.d)

    v, damping, iterations = start, 1e-4, 0
    g, value = evaluate(v)
    rows = _Rows()
    while iterations < most_iterations:
        J = jacobian(v) * limits.free
        predicted = decrease = 0.0
        while iterations < most_iterations:
            iterations += 1
            dv = _step(measure, limits, v, g, J, damping, rows)
            if dv is None:
                damping *= 100.0
                continue
            predicted = value - _model(measure, limits, v, g, J, dv)
            g_new, new = evaluate(v + dv)
            if value - new < 0.7 * predicted:
                # What the linearisation did not foresee at the end of the step is reckoned with in another.
                again = _step(measure, limits, v, g_new - J @ dv, J, damping, rows)
                if again is not None:
                    g_again, new_again = evaluate(v + again)
                    if new_again < new:
                        dv, g_new, new = again, g_again, new_again
            decrease = value - new
            if decrease >= 0.1 * predicted or predicted <= tolerance or damping > _LARGEST_LAMBDA:
                break
            damping *= 10.0
        else:
            break
        if decrease > 0.0:
            v, g, value = v + dv, g_new, new
        if predicted <= tolerance or damping > _LARGEST_LAMBDA:
            break
        if decrease > 0.7 * predicted:
            damping = max(damping / 10.0, _MIN_LAMBDA)
    optimality = _predicted_by_lp(measure, limits, v, g, jacobian(v) * limits.free)
    return Minimum(v=v, g=g, value=value, optimality=optimality, iterations=iterations)


def _model(measure: Measure, limits: Limits, v: Values, g: Values, J: Values, dv: Values) -> float:
    linear = g + J @ dv
    moves = limits.D @ (v + dv) - limits.d
    largest = float(np.dot(measure.cost, measure.excess(linear)))
    squares = 0.5 * float(measure.weights(g) @ linear**2)
    return largest + squares + 0.5 * measure.moves * float(moves @ moves)


def _rows(measure: Measure, limits: Limits, v: Values, g: Values, J: Values) -> tuple[Values, Values]:
    """Constraints ``G (dv, s) <= h``: beyond the caps by no more than s, and within the limits."""
    n, points = v.size, g.size
    low, high = np.eye(2)
    if measure.joint:
        high = low
    none, of_d = np.zeros((n, 2)), np.zeros((limits.d.size, 2))
    free_moves = np.diag(limits.free.astype(float))
    G = np.block(
        [
            [-J, np.tile(-low, (points, 1))],
            [J, np.tile(-high, (points, 1))],
            [limits.D * limits.free, of_d],
            [-limits.D * limits.free, of_d],
            [free_moves, none],
            [-free_moves, none],
            [np.zeros((2, n)), -np.eye(2)],
        ]
    )
    moves = limits.D @ v - limits.d
    beyond = [measure.cap_mg_dl[0] + g, measure.cap_mg_dl[1] - g]
    within = [limits.most - moves, limits.most + moves, limits.high - v, v - limits.low]
    # A plan on a limit is off it by rounding.
    h = np.concatenate([*beyond, *(np.maximum(part, 0.0) for part in within), np.zeros(2)])
    return G, np.where(np.any(G != 0.0, axis=1), h, np.inf)


def _cost(measure: Measure) -> Values:
    """Cost of s; a side without a cost gets a small one, so that the program is bounded."""
    return np.maximum(measure.cost, 1e-6)


class _Rows:
    """The constraints that matter, kept from step to step of a large program; all constraints of a small one."""

    def __init__(self) -> None:
        self._active: npt.NDArray[np.bool_] | None = None

    def solve(self, H: Values, f: Values, G: Values, h: Values) -> QPSolution:
        """Minimiser of the program; rows are added until all constraints hold."""
        if h.size <= _MANY_ROWS:
            small: QPSolution = _solve(H, f, G, h)
            return small
        if self._active is None:
            self._active = (np.arange(h.size) % _FIRST_ROWS == 0) | (h < _NEAR_MU_MIN)
        while True:
            rows = np.flatnonzero(self._active & np.isfinite(h))
            room = -(-rows.size // _ROWS_TOGETHER) * _ROWS_TOGETHER
            some, levels = np.zeros((room, f.size)), np.full(room, np.inf)
            some[: rows.size], levels[: rows.size] = G[rows], h[rows]
            solution: QPSolution = _solve(H, f, some, levels)
            broken = G @ np.asarray(solution.x) - h > _BROKEN
            if not np.any(broken & ~self._active):
                return solution
            self._active |= broken


def _step(
    measure: Measure, limits: Limits, v: Values, g: Values, J: Values, damping: float, rows: _Rows
) -> Values | None:
    n = v.size
    G, h = _rows(measure, limits, v, g, J)
    W, D = measure.weights(g), limits.D * limits.free
    H = np.zeros((n + 2, n + 2))
    H[:n, :n] = damping * np.eye(n) + measure.moves * D.T @ D
    gradient = measure.moves * D.T @ (limits.D @ v - limits.d)
    if measure.weight is not None:
        H[:n, :n] += (J.T * W) @ J
        gradient = gradient + J.T @ (W * g)
    solution = rows.solve(H, np.concatenate([gradient, _cost(measure)]), G, h)
    dv = np.asarray(solution.x)[:n]
    if not (np.all(np.isfinite(dv)) and float(solution.residual) < _QP_SOUND):
        return None
    return dv * limits.free


def _predicted_by_lp(measure: Measure, limits: Limits, v: Values, g: Values, J: Values) -> float:
    from scipy.optimize import linprog

    G, h = _rows(measure, limits, v, g, J)
    finite = np.isfinite(h)
    gradient = measure.moves * (limits.D * limits.free).T @ (limits.D @ v - limits.d) + J.T @ (measure.weights(g) * g)
    bounds = [(-_REACH, _REACH) if free else (0.0, 0.0) for free in limits.free] + [(0.0, None)] * 2
    result = linprog(np.concatenate([gradient, _cost(measure)]), G[finite], h[finite], bounds=bounds, method="highs")
    if not result.success:
        return float("inf")
    at = np.concatenate([np.zeros(v.size), measure.excess(g)])
    return max(0.0, float(_cost(measure) @ at[-2:]) - float(result.fun))
