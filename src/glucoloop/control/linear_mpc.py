"""Linear model predictive control on a step-response model: dynamic matrix control.

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. IV, eq. (15)-(20). What a response does after the
prediction horizon is kept as a small state, the "residual dynamics" of Lee, Morari and Garcia, Automatica 30(4), 1994,
707-717.
"""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any, ClassVar

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.component.pytree_component import DATA, STATIC, wired
from glucoloop.control.decision import decide, delivered_since, is_known, rate_at_start
from glucoloop.control.design_case import DesignCase
from glucoloop.control.horizon import identified_response, suited, unseen
from glucoloop.control.planning import MovePlan, glucose_floor, plan_moves, plans_of_people
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.control.tuning import DEFAULT_FLOOR_WEIGHT, Constraints, FloorGlucose, FloorWeight, MPCTuning
from glucoloop.models.step_response import Realisation, StepResponseModel, extended
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal


@pytree
class _LinearMPCState:
    """State of the controller."""

    free_response: jax.Array
    """(N, ...) glucose deviation at this sample and after, from all moves made before it."""
    disturbance_mg_dl: jax.Array
    """Reading less the model's present value: held over the horizon, and while readings are missing."""
    insulin_mU_min: jax.Array
    """Rate delivered before this sample."""
    residual: jax.Array | None = None
    """(L, ...) state of what comes after N samples; None for a response that is constant there."""


class LinearMPC(MPCTuning, name="mpc"):
    r"""Linear model predictive control on the identified step response.

    The controller minimises, over the moves ``du = (du_0 .. du_(m-1))``::

        Gamma_y^2 || r - (free + d + A du) ||^2 + Gamma_u^2 || du ||^2

    and makes the first move. ``free`` is the response to all moves that the pump has made, `d` the difference between
    the reading and the model now, held over the horizon.

    ============  ==========================================  ========
    variable      meaning                                     size
    ============  ==========================================  ========
    ``S``         step response                               (N,)
    ``A``         dynamic matrix, ``A_ij = S_(i-j+1)``        (p, m)
    ``K``         gain, first row of the solution             (p,)
    ``free``      free response, at the sample and after      (N,)
    ============  ==========================================  ========

    N is the memory of the model, or for a model with a realisation ``p + 1``: what comes after that is then the
    response of L further states.

    The constraint (19) has slack: with a floor above 0, ``w^2 |e|^2`` is added to the objective, where ``e_i >= 0`` is
    what the predicted glucose lacks of the floor at the sample i ahead, and the moves are the exact minimiser within
    the pump's limits, whatever `constraints` says.
    """

    sources = ("parker1999", "lee1994")
    individual: ClassVar = "glucoloop.build.individual:linear_mpc"
    tunable: ClassVar = True
    memory_bound: ClassVar[float] = 1e4
    """Bound on its memory for a guard: glucose is below 1000 mg/dl, what insulin does to it below 10 000 mg/dl, and
    rates are below 10 000 mU/min (600 U/h).
    """

    constraints: Constraints = "clip"
    glucose_floor_mg_dl: FloorGlucose = 0.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT
    _: KW_ONLY
    step_response: jax.Array = wired(DATA, default=None)
    """(N,) S_1 .. S_N, long enough for the prediction horizon."""
    plan: MovePlan = wired(DATA, default=None)
    realisation: Realisation | None = wired(DATA, default=None)
    """The response after N samples; None for one that is constant there."""
    sample_time_min: float = wired(STATIC, default=5.0)

    def designed(self, case: DesignCase) -> LinearMPC:
        """Linear MPC; a known dead time lengthens its horizon, so that it looks as far past it as before."""
        return self.longer(case.dead_time_samples).of_model(case.identified, case.limits)

    def of_model(self, model: StepResponseModel, limits: DoseLimits, *, min_horizon: int = 1) -> LinearMPC:
        """The controller on an identified model.

        A horizon of 0 becomes one that suits the model and is not shorter than `min_horizon`.

        Raises
        ------
        Refusal
            For an unknown way of handling constraints, a floor that is not possible, or a model that is not finite,
            whose gain is not below 0, or whose response at the prediction horizon has less than `horizon.MIN_SHARE` of
            it.
        """
        response, gain = identified_response(model)
        if not is_traced(response) and not np.all(np.isfinite(response)):
            raise Refusal("the step response has a value that is not finite; identify the model again")
        tuning = suited(self, response, gain, usual=min_horizon)
        response = model.step_response
        S, after = _remembered(
            response if is_traced(response) else np.asarray(response, float),
            model.realisation,
            tuning.prediction_horizon,
        )
        floor = glucose_floor(self.glucose_floor_mg_dl, self.floor_weight)
        plan = plan_moves(S, tuning, limits, self.constraints, floor)
        return tuning._with(S, plan, model.sample_time_min, after)

    def of_people(
        self,
        step_response: npt.NDArray[np.float64],
        limits: DoseLimits,
        *,
        sample_time_min: float,
        realisation: Realisation | None = None,
    ) -> LinearMPC:
        """Controllers of many people, who trail, each on the person's own step response ``(M, people)``.

        A realisation after n <= M samples has outputs ``(L, people)``. The rate of a person whose response at the
        horizon has less than `horizon.MIN_SHARE` of its gain is kept.
        """
        gain = step_response[-1]
        if realisation is not None:
            gain = gain + np.asarray(realisation.advanced(step_response.shape[0]).sum)
        S, after = _remembered(step_response, realisation, self.prediction_horizon)
        hidden = unseen(extended(S, None, self.prediction_horizon), gain, self.prediction_horizon)
        floor = glucose_floor(self.glucose_floor_mg_dl, self.floor_weight)
        plan = plans_of_people(S, self, limits, self.constraints, floor, hidden=hidden)
        return self._with(S, plan, sample_time_min, after)

    def _with(self, S: Any, plan: MovePlan, sample_time_min: float, after: Realisation | None) -> LinearMPC:
        controller: LinearMPC = self.made(
            step_response=jnp.asarray(S),
            plan=plan,
            sample_time_min=sample_time_min,
            realisation=jax.tree.map(jnp.asarray, after),
        )
        return controller

    @property
    def gain(self) -> jax.Array:
        """Closed-form gain ``(p,)``: the move for a unit error at each sample ahead."""
        return self.plan.gain

    @property
    def horizons(self) -> tuple[int, int]:
        """Number of planned moves and of predicted samples, as the arrays have them."""
        return self.plan.hessian.shape[0], self.plan.gain.shape[0]

    def settled(self) -> dict[str, Any]:
        """Horizons, in samples; a known dead time is within them."""
        return dict(zip(("move_horizon", "prediction_horizon"), self.horizons, strict=True))

    def padded(self, moves: int, horizon: int) -> LinearMPC:
        """The same controller with room for more moves and more samples, none of which has any weight."""
        longer, after = _remembered(self.step_response, self.realisation, horizon)
        return self.replaced(step_response=longer, realisation=after, plan=self.plan.padded(moves, horizon))

    def init(self, observation: Observation) -> _LinearMPCState:
        """State of a controller at steady state under the delivered rate, with glucose at the first reading."""
        reading, after = observation.glucose_mg_dl, self.realisation
        return _LinearMPCState(
            free_response=jnp.zeros((self.step_response.shape[0], *reading.shape), reading.dtype),
            disturbance_mg_dl=jnp.where(is_known(observation), reading, observation.setpoint_mg_dl),
            insulin_mU_min=rate_at_start(observation, self.plan.limits.min_mU_min),
            residual=None if after is None else jnp.zeros((after.start.shape[0], *reading.shape), reading.dtype),
        )

    def step(self, state: _LinearMPCState, observation: Observation) -> tuple[_LinearMPCState, Decision]:
        """Include the delivered rate and the reading, and decide on one move."""
        state, known = self._observed(state, observation)
        delivered, disturbance, ahead = state.insulin_mU_min, state.disturbance_mg_dl, self._ahead(state)
        error = observation.setpoint_mg_dl - disturbance - ahead
        move, converged = self.plan.first_move(error, delivered, disturbance + ahead)
        return state, decide(delivered + move, delivered, self.plan.limits, known, converged)

    def forecast(self, state: _LinearMPCState, observation: Observation) -> DoseForecast:
        """Forecast of readings by the model, to the prediction horizon, under all planned moves."""
        state, _ = self._observed(state, observation)
        error = observation.setpoint_mg_dl - state.disturbance_mg_dl - self._ahead(state)
        free = state.disturbance_mg_dl + state.free_response[: self.gain.shape[0] + 1]
        return self.plan.forecast(error, state.insulin_mU_min, free, self.step_response, self.sample_time_min)

    def _observed(self, state: _LinearMPCState, observation: Observation) -> tuple[_LinearMPCState, jax.Array]:
        """State with the delivered rate and the reading, and whether there is one."""
        # The pump's word, not our command: what it clipped must not wind up in the prediction.
        delivered = delivered_since(observation, state.insulin_mU_min)
        free, residual = self._after_move(state, delivered - state.insulin_mU_min)
        known = is_known(observation)
        disturbance = jnp.where(known, observation.glucose_mg_dl - free[0], state.disturbance_mg_dl)
        return _LinearMPCState(
            free_response=free, disturbance_mg_dl=disturbance, insulin_mU_min=delivered, residual=residual
        ), known

    def _ahead(self, state: _LinearMPCState) -> jax.Array:
        """Free response ``(p, ...)`` at the samples ahead."""
        return state.free_response[1 : self.gain.shape[0] + 1]

    def _after_move(self, state: _LinearMPCState, move: jax.Array) -> tuple[jax.Array, jax.Array | None]:
        """Free response one sample on, with a move made at the last sample, and what comes after it.

        At the far end it stays at its last value, or goes on with the realisation, which is exact for every move ever
        made.
        """
        last, after, residual = state.free_response[-1:], self.realisation, state.residual
        if after is not None and residual is not None:
            last = last + after.output @ residual
            residual = after.transition @ residual + jnp.multiply.outer(after.start, move)
        shifted = jnp.concatenate([state.free_response[1:], last])
        return shifted + jnp.multiply.outer(self.step_response, move), residual


def _remembered(step_response: Any, realisation: Realisation | None, horizon: int) -> tuple[Any, Realisation | None]:
    """Coefficients that a controller keeps one by one, and the realisation of the response after them.

    A response without a realisation is kept whole. Otherwise the controller keeps the minimum number that the
    prediction horizon and the realisation need.
    """
    if realisation is None:
        return extended(step_response, None, horizon + 1), None
    memory = max(realisation.after, horizon + 1)
    return extended(step_response, realisation, memory)[:memory], realisation.advanced(memory)


@checked
def design_linear_mpc(
    model: StepResponseModel,
    tuning: MPCTuning | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    constraints: str = LinearMPC.constraints,
    glucose_floor_mg_dl: float = LinearMPC.glucose_floor_mg_dl,
    floor_weight: float = LinearMPC.floor_weight,
) -> LinearMPC:
    """`LinearMPC` on an identified step response.

    Parameters
    ----------
    model : StepResponseModel
        Model as identified, or delayed by a dead time that the controller is to know.
    tuning : MPCTuning, optional
        Tuning; by default that of the paper without noise, its horizon longer where the model is slower, so that at
        its end the response has `horizon.DEFAULT_SHARE` of the gain. A horizon of 0 is chosen in the same way.
    limits : DoseLimits
        Limits of the pump, by default those of 1999; give ``gl.usual_limits(patient)`` for another patient.
    constraints : {"clip", "qp"}
        ``"clip"``: the closed form, its rate clipped and then its magnitude, as in the paper. ``"qp"``: the exact
        minimiser within the limits of every planned move.
    glucose_floor_mg_dl : float
        Soft lower bound on predicted glucose; 0: none.
    floor_weight : float
        Weight w on its violation.

    Raises
    ------
    ValueError
        As of `LinearMPC.of_model`.

    Examples
    --------
    >>> from glucoloop.models.step_response import StepResponseModel
    >>> model = StepResponseModel.from_impulse_response([-0.5, -0.4, -0.3, -0.2], sample_time_min=5.0)
    >>> controller = design_linear_mpc(model, MPCTuning(move_horizon=1, prediction_horizon=3))
    >>> [round(float(k), 4) for k in controller.gain]
    [-0.2, -0.36, -0.48]
    """
    settings, min_horizon = LinearMPC().tuned(
        tuning, constraints=constraints, glucose_floor_mg_dl=glucose_floor_mg_dl, floor_weight=floor_weight
    )
    return settings.of_model(model, limits, min_horizon=min_horizon)
