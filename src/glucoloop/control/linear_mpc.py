"""Linear model predictive control on a step-response model: dynamic matrix control.

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. IV, eq. (15)-(20).
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.control.tuning import NOISE_FREE, MPCTuning
from glucoloop.models.step_response import StepResponseModel
from glucoloop.optimize.moves_qp import minimise_moves
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits

CONSTRAINT_HANDLING: Final = ("clip", "qp")
_WORST_CONDITION: Final = 1e13
_SATURATED_MU_MIN: Final = 1e-9


@pytree
class LinearMPCState:
    """What the controller remembers."""

    free_response: jax.Array
    """(M, ...) glucose deviation at this sample and after, from all moves made before it."""
    disturbance_mg_dl: jax.Array
    """Reading less the model's present value: held over the horizon, and while readings are missing."""
    insulin_mU_min: jax.Array
    """Rate delivered before this sample."""


@pytree
class LinearMPC:
    """Linear MPC; see `design_linear_mpc`."""

    step_response: jax.Array
    """(M,) S_1 .. S_M, long enough for the prediction horizon."""
    gain: jax.Array
    """(p,) first row of ``(Gamma_y^2 A'A + Gamma_u^2 I)^-1 Gamma_y^2 A'``."""
    hessian: jax.Array
    """(m, m) ``Gamma_y^2 A'A + Gamma_u^2 I``."""
    gradient: jax.Array
    """(m, p) ``-Gamma_y^2 A'``."""
    limits: DoseLimits
    sample_time_min: float = static()
    constraints: str = static()

    def init(self, observation: Observation) -> LinearMPCState:
        """At rest under what the pump delivers; the first reading is all that is known of glucose."""
        reading = observation.glucose_mg_dl
        known = observation.valid & jnp.isfinite(reading)
        return LinearMPCState(
            free_response=jnp.zeros((self.step_response.shape[0], *reading.shape), reading.dtype),
            disturbance_mg_dl=jnp.where(known, reading, observation.setpoint_mg_dl),
            insulin_mU_min=observation.delivered_mU_min,
        )

    def step(self, state: LinearMPCState, observation: Observation) -> tuple[LinearMPCState, Decision]:
        """Take in what was delivered and read, and decide on one move."""
        # The pump's word, not our command: what it clipped must not wind up in the prediction.
        delivered = jnp.where(
            jnp.isfinite(observation.delivered_mU_min), observation.delivered_mU_min, state.insulin_mU_min
        )
        free = _after_move(state.free_response, self.step_response, delivered - state.insulin_mU_min)
        reading = observation.glucose_mg_dl
        known = observation.valid & jnp.isfinite(reading)
        disturbance = jnp.where(known, reading - free[0], state.disturbance_mg_dl)

        p = self.gain.shape[0]
        error = observation.setpoint_mg_dl - disturbance - free[1 : p + 1]
        if self.constraints == "qp":
            solution = minimise_moves(
                self.hessian,
                self.gradient @ error,
                delivered,
                max_move=self.limits.max_change_mU_min,
                u_min=self.limits.min_mU_min,
                u_max=self.limits.max_mU_min,
            )
            wanted, converged = delivered + solution.moves[0], solution.converged
        else:
            wanted, converged = delivered + self.gain @ error, jnp.ones(reading.shape, bool)

        finite = jnp.isfinite(wanted)
        insulin = self.limits.clip(jnp.where(finite, wanted, delivered), delivered)
        saturated = jnp.abs(insulin - wanted) > _SATURATED_MU_MIN
        status = jnp.select(
            [~finite, ~known, ~converged, saturated],
            [Status.NON_FINITE, Status.READING_MISSING, Status.NOT_CONVERGED, Status.SATURATED],
            Status.OK,
        )
        state = LinearMPCState(free_response=free, disturbance_mg_dl=disturbance, insulin_mU_min=delivered)
        return state, Decision(insulin_mU_min=insulin, status=status)


def _after_move(free_response: jax.Array, step_response: jax.Array, move: jax.Array) -> jax.Array:
    """Free response one sample on, with a move made at the last sample; it stays at its last value at the far end."""
    shifted = jnp.concatenate([free_response[1:], free_response[-1:]])
    return shifted + jnp.multiply.outer(step_response, move)


def dynamic_matrix(step_response: jax.Array, moves: int, horizon: int) -> jax.Array:
    """Matrix A `(p, m)` with ``A_ij = S_(i-j+1)``: glucose over the horizon from each planned move."""
    lag = jnp.arange(horizon)[:, None] - jnp.arange(moves)[None, :]
    return jnp.where(lag >= 0, step_response[jnp.clip(lag, 0, step_response.shape[0] - 1)], 0.0)


def design_linear_mpc(
    model: StepResponseModel,
    tuning: MPCTuning = NOISE_FREE,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    constraints: str = "clip",
) -> LinearMPC:
    r"""Linear MPC on an identified step response.

    The controller minimises, over the moves ``du = (du_0 .. du_(m-1))``,

        Gamma_y^2 || r - (free + d + A du) ||^2 + Gamma_u^2 || du ||^2

    and makes the first move. ``free`` is the response to all moves that the pump has made, `d` the difference between
    the reading and the model now, held over the horizon.

    ============  ==========================================  ========
    variable      meaning                                     size
    ============  ==========================================  ========
    ``S``         step response                               (M,)
    ``A``         dynamic matrix, ``A_ij = S_(i-j+1)``        (p, m)
    ``K``         gain, first row of the solution             (p,)
    ``free``      free response, at the sample and after      (M,)
    ============  ==========================================  ========

    Parameters
    ----------
    model : StepResponseModel
        As identified, or delayed to tell the controller of a dead time.
    tuning : MPCTuning
    limits : DoseLimits
        Of the pump.
    constraints : {"clip", "qp"}
        ``"clip"``: the closed form, its rate clipped and then its magnitude, as in the paper. ``"qp"``: the exact
        minimiser within the limits of every planned move.

    Raises
    ------
    ValueError
        For an unknown way of handling constraints, a model that is not finite, or one that does not answer within the
        prediction horizon, so that the moves are undetermined.

    Examples
    --------
    >>> from glucoloop.models.step_response import StepResponseModel
    >>> model = StepResponseModel.from_impulse_response([-0.5, -0.4, -0.3, -0.2], sample_time_min=5.0)
    >>> controller = design_linear_mpc(model, MPCTuning(move_horizon=1, prediction_horizon=3))
    >>> [round(float(k), 4) for k in controller.gain]
    [-0.2041, -0.3673, -0.4898]
    """
    if constraints not in CONSTRAINT_HANDLING:
        raise ValueError(
            f"unknown constraint handling {constraints!r}; the known ones are: {', '.join(CONSTRAINT_HANDLING)}"
        )
    S = np.asarray(model.step_response, float)
    if not np.all(np.isfinite(S)):
        raise ValueError("the step response has a value that is not finite; identify the model again")
    p, m = tuning.prediction_horizon, tuning.move_horizon
    missing = p + 1 - S.size
    if missing > 0:
        S = np.concatenate([S, np.full(missing, S[-1])])
    A = np.asarray(dynamic_matrix(jnp.asarray(S), m, p))
    hessian = tuning.output_weight**2 * A.T @ A + tuning.move_weight**2 * np.eye(m)
    if not np.linalg.cond(hessian) < _WORST_CONDITION:
        raise ValueError(
            f"the model's response over {p} samples does not determine {m} moves; "
            "lengthen the prediction horizon, shorten the move horizon, or give a move weight above 0"
        )
    gradient = -(tuning.output_weight**2) * A.T
    return LinearMPC(
        step_response=jnp.asarray(S),
        gain=jnp.asarray(-np.linalg.solve(hessian, gradient)[0]),
        hessian=jnp.asarray(hessian),
        gradient=jnp.asarray(gradient),
        limits=limits,
        sample_time_min=model.sample_time_min,
        constraints=constraints,
    )
