"""Optimisation shared by all predictive controllers here: moves that bring glucose to a reference.

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, eq. (15), (16), (20).
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree, static
from glucoloop.arguments import is_traced
from glucoloop.control.protocol import DoseForecast
from glucoloop.control.tuning import MPCTuning
from glucoloop.pumps.limits import DoseLimits
from glucoloop.qp.moves_qp import minimise_moves
from glucoloop.qp.soft_floor import minimise_moves_above_floor
from glucoloop.refusal import Refusal

_WORST_CONDITION: Final = 1e13


def dynamic_matrix(step_response: jax.Array, moves: int, horizon: int) -> jax.Array:
    """Matrix A `(p, m)` with ``A_ij = S_(i-j+1)``: glucose over the horizon from each planned move."""
    lag = jnp.arange(horizon)[:, None] - jnp.arange(moves)[None, :]
    return jnp.where(lag >= 0, step_response[jnp.clip(lag, 0, step_response.shape[0] - 1)], 0.0)


def minimise_within(
    hessian: jax.Array, gradient: jax.Array, delivered_mU_min: jax.Array, limits: DoseLimits
) -> tuple[jax.Array, jax.Array]:
    """Moves ``(m, ...)`` that minimise ``du' H du / 2 + g' du`` within the pump's limits, and whether it is exact."""
    solution = minimise_moves(
        hessian,
        gradient,
        delivered_mU_min,
        max_move=limits.max_change_mU_min,
        u_min=limits.min_mU_min,
        u_max=limits.max_mU_min,
    )
    return solution.moves, solution.converged


@pytree
class GlucoseFloor:
    """Constraint (19) with slack: the violation of a floor by predicted glucose is squared, weighted and added."""

    glucose_mg_dl: jax.Array | float
    weight: jax.Array | float
    """Weight w; one, or (p,) one for each sample ahead."""

    def padded(self, own_horizon: int, horizon: int) -> GlucoseFloor:
        """The same floor for a longer horizon, whose further samples have no weight."""
        weight = jnp.broadcast_to(jnp.asarray(self.weight, float), (own_horizon,))
        return dataclasses.replace(self, weight=jnp.pad(weight, (0, horizon - own_horizon)))


def glucose_floor(glucose_mg_dl: float, weight: float) -> GlucoseFloor | None:
    """A floor under predicted glucose, or None at 0 mg/dl."""
    has_floor = is_traced(glucose_mg_dl) or glucose_mg_dl > 0.0
    return GlucoseFloor(glucose_mg_dl=glucose_mg_dl, weight=weight) if has_floor else None


def minimise_above(
    floor: GlucoseFloor,
    hessian: jax.Array,
    gradient: jax.Array,
    response: jax.Array,
    predicted_mg_dl: jax.Array,
    delivered_mU_min: jax.Array,
    limits: DoseLimits,
) -> tuple[jax.Array, jax.Array]:
    """Minimise as `minimise_within`, with ``w^2 |e|^2 / 2`` added for the violation e of the floor.

    `response` is the dynamic matrix A without weight, and `predicted_mg_dl` the glucose ``(p, ...)`` if the rate stays
    as it is.
    """
    solution = minimise_moves_above_floor(
        hessian,
        gradient,
        response,
        floor.glucose_mg_dl - predicted_mg_dl,
        floor.weight,
        delivered_mU_min,
        max_move=limits.max_change_mU_min,
        u_min=limits.min_mU_min,
        u_max=limits.max_mU_min,
    )
    return solution.moves, solution.converged


def forecast_of_moves(
    moves: jax.Array,
    response: jax.Array,
    free_mg_dl: jax.Array,
    delivered_mU_min: jax.Array,
    limits: DoseLimits,
    sample_time_min: float,
) -> DoseForecast:
    """Forecast under planned moves ``(m, ...)``, whose rates the pump's limits cut one by one as they do the first.

    `response` is the dynamic matrix ``(p, m)``, and `free_mg_dl` the glucose ``(p + 1, ...)`` if the rate stays as it
    is, from now on.
    """
    rates: list[jax.Array] = []
    for planned in delivered_mU_min + jnp.cumsum(moves, axis=0):
        rates.append(limits.clip(planned, rates[-1] if rates else delivered_mU_min))
    allowed = jnp.diff(jnp.stack([delivered_mU_min, *rates]), axis=0)
    points = free_mg_dl.shape[0]
    return DoseForecast(
        ahead_min=sample_time_min * jnp.arange(points),
        glucose_mg_dl=free_mg_dl.at[1:].add(response @ allowed),
        insulin_mU_min=jnp.stack(rates + rates[-1:] * (points - len(rates))),
    )


@pytree
class MovePlan:
    """Precomputed solution for the moves ``du`` that minimise ``Gamma_y^2 |error - A du|^2 + Gamma_u^2 |du|^2``."""

    gain: jax.Array
    """(p,) first row of ``(Gamma_y^2 A'A + Gamma_u^2 I)^-1 Gamma_y^2 A'``."""
    hessian: jax.Array
    """(m, m) Hessian ``Gamma_y^2 A'A + Gamma_u^2 I``."""
    gradient: jax.Array
    """(m, p) gradient ``-Gamma_y^2 A'``."""
    limits: DoseLimits
    floor: GlucoseFloor | None = None
    response: jax.Array | None = None
    """(p, m) dynamic matrix A, only if there is a floor."""
    constraints: str = static()

    def first_move(
        self, error_mg_dl: jax.Array, delivered_mU_min: jax.Array, predicted_mg_dl: jax.Array | None = None
    ) -> tuple[jax.Array, jax.Array]:
        """First planned move, and whether it is the minimiser that was asked for.

        The error ``(p, ...)`` is the reference less the free response, which a plan with a floor needs as glucose
        itself too.
        """
        minimiser = self._minimiser(error_mg_dl, delivered_mU_min, predicted_mg_dl)
        if minimiser is not None:
            return minimiser[0][0], minimiser[1]
        return self.gain @ error_mg_dl, jnp.ones(jnp.shape(delivered_mU_min), bool)

    def forecast(
        self,
        error_mg_dl: jax.Array,
        delivered_mU_min: jax.Array,
        free_mg_dl: jax.Array,
        step_response: jax.Array,
        sample_time_min: float,
    ) -> DoseForecast:
        """Forecast under all planned moves; `free_mg_dl` is ``(p + 1, ...)``, as for `forecast_of_moves`."""
        minimiser = self._minimiser(error_mg_dl, delivered_mU_min, free_mg_dl[1:])
        moves = jnp.linalg.solve(self.hessian, -self.gradient @ error_mg_dl) if minimiser is None else minimiser[0]
        response = dynamic_matrix(step_response, *self.gradient.shape)
        return forecast_of_moves(moves, response, free_mg_dl, delivered_mU_min, self.limits, sample_time_min)

    def _minimiser(
        self, error_mg_dl: jax.Array, delivered_mU_min: jax.Array, predicted_mg_dl: jax.Array | None
    ) -> tuple[jax.Array, jax.Array] | None:
        """Moves within the limits, and whether they are exact; None where the closed form is asked for."""
        if self.floor is not None and self.response is not None and predicted_mg_dl is not None:
            gradient = self.gradient @ error_mg_dl
            return minimise_above(
                self.floor, self.hessian, gradient, self.response, predicted_mg_dl, delivered_mU_min, self.limits
            )
        if self.constraints == "qp":
            return minimise_within(self.hessian, self.gradient @ error_mg_dl, delivered_mU_min, self.limits)
        return None

    def padded(self, moves: int, horizon: int) -> MovePlan:
        """The same plan with room for more moves and more samples, none of which has any weight."""
        own_moves, own_horizon = self.gradient.shape
        more_moves, more_samples = moves - own_moves, horizon - own_horizon
        idle = np.diag(np.repeat([0.0, 1.0], [own_moves, more_moves]))
        return dataclasses.replace(
            self,
            gain=jnp.pad(self.gain, (0, more_samples)),
            # An idle move has curvature but no slope and no part in the others' cost: the best it can do is nothing.
            hessian=jnp.pad(self.hessian, (0, more_moves)) + idle,
            gradient=jnp.pad(self.gradient, ((0, more_moves), (0, more_samples))),
            floor=None if self.floor is None else self.floor.padded(own_horizon, horizon),
            response=None if self.response is None else jnp.pad(self.response, ((0, more_samples), (0, more_moves))),
        )


def plan_moves(
    step_response: jax.typing.ArrayLike,
    tuning: MPCTuning,
    limits: DoseLimits,
    constraints: str,
    floor: GlucoseFloor | None = None,
) -> MovePlan:
    """Precompute the moves for any error, from a step response of the prediction horizon or longer.

    A response that is not finite, or does not determine the moves within the horizon, is refused.
    """
    traced = is_traced(step_response, tuning.output_weight, tuning.move_weight)
    S: Any = step_response if traced else np.asarray(step_response, float)
    if not traced and not np.all(np.isfinite(S)):
        raise Refusal("the step response has a value that is not finite; identify the model again")
    plan = plans_of_people(S[:, None], tuning, limits, constraints, floor)
    if not traced and not np.linalg.cond(np.asarray(plan.hessian)[..., 0]) < _WORST_CONDITION:
        raise Refusal(
            f"the model's response over {tuning.prediction_horizon} samples does not determine {tuning.move_horizon} "
            "moves; lengthen the prediction horizon, shorten the move horizon, or give a move weight above 0"
        )
    varying = ("gain", "hessian", "gradient", *(() if floor is None else ("response",)))
    single = {name: getattr(plan, name)[..., 0] for name in varying}
    return dataclasses.replace(plan, **single)


def plans_of_people(
    step_response: jax.typing.ArrayLike,
    tuning: MPCTuning,
    limits: DoseLimits,
    constraints: str,
    floor: GlucoseFloor | None = None,
    *,
    hidden: jax.typing.ArrayLike = False,
) -> MovePlan:
    """Plans of many people, who trail; arguments are those of `plan_moves`.

    The plan of a person whose response does not determine the moves, or is `hidden`, is not finite, so that the rate is
    kept.
    """
    # NumPy compiles nothing; what JAX differentiates or maps has to be its own.
    xp: Any = jnp if is_traced(step_response, tuning.output_weight, tuning.move_weight) else np
    S = xp.asarray(step_response, float)
    p, m = tuning.prediction_horizon, tuning.move_horizon
    # as `dynamic_matrix`
    A = xp.stack([xp.concatenate([xp.zeros((move, *S.shape[1:])), S[: p - move]]) for move in range(m)], axis=1)
    identity = np.eye(m)[..., None]
    hessian = tuning.output_weight**2 * xp.einsum("ij...,ik...->jk...", A, A) + tuning.move_weight**2 * identity
    gradient = -(tuning.output_weight**2) * A.swapaxes(0, 1)
    people_first = hessian.transpose(2, 0, 1)
    with np.errstate(invalid="ignore"):
        determinant = xp.linalg.det(people_first)
    determined = xp.isfinite(determinant) & (determinant != 0.0) & ~xp.asarray(hidden)
    solvable = xp.where(determined[:, None, None], people_first, np.eye(m))
    gain = -xp.linalg.solve(solvable, gradient.transpose(2, 0, 1))[:, 0].T
    put: Any = jnp.asarray if xp is jnp else jax.device_put  # which compiles nothing either
    return MovePlan(
        gain=put(xp.where(determined, gain, np.nan)),
        hessian=put(hessian),
        gradient=put(xp.where(hidden, np.nan, gradient)),
        limits=limits,
        floor=floor,
        response=None if floor is None else jnp.asarray(A),
        constraints=constraints,
    )
