"""Linear model predictive control on a step-response model: dynamic matrix control.

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. IV, eq. (15)-(20).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked, is_traced
from glucoloop.control.decision import decide, delivered_since, is_known, rate_at_start
from glucoloop.control.design_case import DesignCase
from glucoloop.control.planning import MovePlan, glucose_floor, plan_moves, plans_of_people
from glucoloop.control.protocol import Decision, Observation
from glucoloop.control.settings import DEFAULT_FLOOR_WEIGHT, LinearMPCSettings, MPCTuning
from glucoloop.control.tuning import NOISE_FREE, check_gain
from glucoloop.models.step_response import StepResponseModel, extended
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits


@pytree
class LinearMPCState:
    """State of the controller."""

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
    plan: MovePlan
    sample_time_min: float = static()
    tail_pole: jax.Array | None = None
    """p, ratio of the increments of the step response after S_M; None for a response that is constant there."""

    @property
    def gain(self) -> jax.Array:
        """Closed-form gain ``(p,)``: the move for a unit error at each sample ahead."""
        return self.plan.gain

    @property
    def horizons(self) -> tuple[int, int]:
        """Number of planned moves and of predicted samples, as the arrays have them."""
        return self.plan.hessian.shape[0], self.plan.gain.shape[0]

    def padded(self, moves: int, horizon: int) -> LinearMPC:
        """The same controller with room for more moves and more samples, none of which has any weight."""
        longer = extended(self.step_response, self.tail_pole, horizon + 1)
        return dataclasses.replace(self, step_response=longer, plan=self.plan.padded(moves, horizon))

    def init(self, observation: Observation) -> LinearMPCState:
        """State of a controller at rest under the delivered rate, with glucose at the first reading."""
        reading = observation.glucose_mg_dl
        return LinearMPCState(
            free_response=jnp.zeros((self.step_response.shape[0], *reading.shape), reading.dtype),
            disturbance_mg_dl=jnp.where(is_known(observation), reading, observation.setpoint_mg_dl),
            insulin_mU_min=rate_at_start(observation, self.plan.limits.min_mU_min),
        )

    def step(self, state: LinearMPCState, observation: Observation) -> tuple[LinearMPCState, Decision]:
        """Include the delivered rate and the reading, and decide on one move."""
        # The pump's word, not our command: what it clipped must not wind up in the prediction.
        delivered = delivered_since(observation, state.insulin_mU_min)
        free = _after_move(state.free_response, self.step_response, delivered - state.insulin_mU_min, self.tail_pole)
        known = is_known(observation)
        disturbance = jnp.where(known, observation.glucose_mg_dl - free[0], state.disturbance_mg_dl)

        ahead = free[1 : self.gain.shape[0] + 1]
        error = observation.setpoint_mg_dl - disturbance - ahead
        move, converged = self.plan.first_move(error, delivered, disturbance + ahead)
        state = LinearMPCState(free_response=free, disturbance_mg_dl=disturbance, insulin_mU_min=delivered)
        return state, decide(delivered + move, delivered, self.plan.limits, known, converged)


def _after_move(
    free_response: jax.Array, step_response: jax.Array, move: jax.Array, tail_pole: jax.Array | None
) -> jax.Array:
    """Free response one sample on, with a move made at the last sample.

    At the far end it stays at its last value, or goes on with the tail. The tail is exact for every move ever made,
    since the increments of each answer fall by the same ratio from there on.
    """
    last = free_response[-1:]
    if tail_pole is not None:
        last = last + tail_pole * (last - free_response[-2:-1])
    shifted = jnp.concatenate([free_response[1:], last])
    return shifted + jnp.multiply.outer(step_response, move)


@checked
def design_linear_mpc(
    model: StepResponseModel,
    tuning: MPCTuning = NOISE_FREE,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    constraints: str = "clip",
    glucose_floor_mg_dl: float = 0.0,
    floor_weight: float = DEFAULT_FLOOR_WEIGHT,
) -> LinearMPC:
    r"""Linear MPC on an identified step response.

    The controller minimises, over the moves ``du = (du_0 .. du_(m-1))``::

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
        Model as identified, or delayed by a dead time that the controller is to know.
    tuning : MPCTuning
    limits : DoseLimits
        Limits of the pump.
    constraints : {"clip", "qp"}
        ``"clip"``: the closed form, its rate clipped and then its magnitude, as in the paper. ``"qp"``: the exact
        minimiser within the limits of every planned move.
    glucose_floor_mg_dl : float
        The constraint (19) with slack. Above 0, ``w^2 |e|^2`` is added to the objective, where ``e_i >= 0`` is what the
        predicted glucose lacks of the floor at the sample i ahead, and the moves are the exact minimiser within the
        pump's limits, whatever `constraints` says. 0: no floor.
    floor_weight : float
        w.

    Raises
    ------
    ValueError
        For an unknown way of handling constraints, a floor that is not possible, or a model that is not finite, whose
        gain is not below 0, or that does not answer within the prediction horizon, so that the moves are undetermined.

    Examples
    --------
    >>> from glucoloop.models.step_response import StepResponseModel
    >>> model = StepResponseModel.from_impulse_response([-0.5, -0.4, -0.3, -0.2], sample_time_min=5.0)
    >>> controller = design_linear_mpc(model, MPCTuning(move_horizon=1, prediction_horizon=3))
    >>> [round(float(k), 4) for k in controller.gain]
    [-0.2, -0.36, -0.48]
    """
    response = model.step_response
    S = extended(
        response if is_traced(response) else np.asarray(response, float), model.tail_pole, tuning.prediction_horizon + 1
    )
    plan = plan_moves(S, tuning, limits, constraints, glucose_floor(glucose_floor_mg_dl, floor_weight))
    check_gain(model.gain)
    return LinearMPC(
        step_response=jnp.asarray(S), plan=plan, sample_time_min=model.sample_time_min, tail_pole=model.tail_pole
    )


def linear_mpc_of_people(
    step_response: npt.NDArray[np.float64],
    tuning: MPCTuning,
    limits: DoseLimits,
    *,
    sample_time_min: float,
    tail_pole: npt.NDArray[np.float64] | None = None,
    constraints: str = "clip",
    glucose_floor_mg_dl: float = 0.0,
    floor_weight: float = DEFAULT_FLOOR_WEIGHT,
) -> LinearMPC:
    """Controllers of many people, who trail, each on the person's own step response.

    Parameters
    ----------
    step_response : (M, people) array
    tail_pole : (people,) array, optional
        Ratio of the increments after M samples, 0 for a person whose response ends there; None if everybody's does.
    tuning, limits, constraints, glucose_floor_mg_dl, floor_weight
        As for `design_linear_mpc`.
    sample_time_min : float
    """
    S = extended(step_response, tail_pole, tuning.prediction_horizon + 1)
    return LinearMPC(
        step_response=jnp.asarray(S),
        plan=plans_of_people(S, tuning, limits, constraints, glucose_floor(glucose_floor_mg_dl, floor_weight)),
        sample_time_min=sample_time_min,
        tail_pole=None if tail_pole is None else jnp.asarray(tail_pole),
    )


def design(case: DesignCase, settings: LinearMPCSettings) -> LinearMPC:
    """Linear MPC; a known dead time lengthens its horizon, so that it looks as far past it as before."""
    return design_linear_mpc(case.identified, settings.longer(case.dead_time_samples), case.limits, **settings.moves)
