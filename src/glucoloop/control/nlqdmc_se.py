"""Nonlinear quadratic dynamic matrix control with state estimation (NLQDMC/SE).

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. VI; G. Gattu, E. Zafiriou, "Nonlinear quadratic
dynamic matrix control with state estimation", Ind. Eng. Chem. Res. 31, 1992.
"""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any, ClassVar, NamedTuple

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, on_host
from glucoloop.component.pytree_component import DATA, STATIC, wired
from glucoloop.component.setting import default_by_noise
from glucoloop.control.decision import decide, delivered_since, is_known, is_of_a_person, rate_at_start
from glucoloop.control.design_case import DesignCase
from glucoloop.control.horizon import response_at_rest, suited
from glucoloop.control.planning import (
    GlucoseFloor,
    dynamic_matrix,
    forecast_of_moves,
    glucose_floor,
    minimise_above,
    minimise_within,
)
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.control.tuning import (
    DEFAULT_FLOOR_WEIGHT,
    FilterTuning,
    FloorGlucose,
    FloorWeight,
    PredictionHorizon,
    ReferenceFilter,
    StateTuning,
)
from glucoloop.estimation import steady_state_gain
from glucoloop.estimation.noise_level import CORRELATION, SensorError, learned, no_error
from glucoloop.estimation.riccati import is_covariance, next_covariance, triangle, whole
from glucoloop.models.nonlinear import NonlinearModel, own_reading, reading_of
from glucoloop.models.state_space import ContinuousModel, LinearModel, discretise, halvings_of, linearise, step_response
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal


@pytree
class _NLQDMCState:
    """State of the controller."""

    estimate: jax.Array
    """(n,) filtered state."""
    covariance: jax.Array
    """Lower triangle of the prediction covariance; of n + 1 states where the size of the sensor's error is learned."""
    insulin_mU_min: jax.Array
    """Rate delivered before this sample."""
    sensor: SensorError | None = None
    """Correlated error of the sensor, where its size is learned."""


class _Planned(NamedTuple):
    """Estimate at a sample, and the plan."""

    known: jax.Array
    delivered_mU_min: jax.Array
    estimate: jax.Array
    covariance: jax.Array
    sensor: SensorError | None
    free_mg_dl: jax.Array
    """(p,) free response."""
    response: jax.Array
    """(p, m) dynamic matrix."""
    moves: jax.Array
    converged: jax.Array


class NLQDMC(FilterTuning, name="nlqdmc-se"):
    """Predictive control on the nonlinear patient, linearised again at each sample, with a Kalman filter.

    At each sample the model is linearised at the predicted state and the rate in force. The Kalman gain K belongs to a
    prediction covariance that is carried along, by four steps of the Riccati equation of the linearisation at each
    sample, and so comes near its steady one. The estimate and the free response come from the nonlinear model, K e
    being added at each sample ahead; the effect of the moves comes from the linear one. The moves solve one quadratic
    program::

        min over du of  Gamma_y^2 |r - free - A du|^2 + Gamma_u^2 |du|^2

    subject to the pump's rate and magnitude limits at every planned move.

    ============  ==========================================  ========
    variable      meaning                                     size
    ============  ==========================================  ========
    ``x``         estimated state                             (n,)
    ``K``         Kalman gain of the sample, filter form      (n,)
    ``A``         dynamic matrix of the linearisation         (p, m)
    ``free``      glucose if the rate stayed as it is         (p,)
    ============  ==========================================  ========
    """

    sources = ("parker1999", "gattu1992")
    uses_model: ClassVar = False
    tunable: ClassVar = True
    reference_filters: ClassVar = ".3:.5:.1|.57|.7|.8"  # half as many, since its loops take longer
    heals: ClassVar[bool] = True
    """Whether a step leaves a finite state after any state, so that a guard need not check it."""

    prediction_horizon: PredictionHorizon = default_by_noise(default=5, noisy=6)
    reference_filter: ReferenceFilter = 0.57
    glucose_floor_mg_dl: FloorGlucose = 0.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT
    _: KW_ONLY
    model: NonlinearModel = wired(DATA, default=None)
    Q: jax.Array = wired(DATA, default=None)
    """(n, n) covariance of the process noise."""
    covariance: jax.Array = wired(DATA, default=None)
    """Lower triangle of the prediction covariance at steady state, as the state has it."""
    R: jax.Array | float = wired(DATA, default=None)
    """Variance of a reading."""
    reference: jax.Array = wired(DATA, default=None)
    """(p,) factors ``phi_r^(i-s)`` of the reference."""
    Gamma_y: jax.Array | float = wired(DATA, default=None)
    """Weight on the error of glucose; one, or (p,) one for each sample ahead."""
    Gamma_u: jax.Array | float = wired(DATA, default=None)
    """Weight on each move."""
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    planned: jax.Array | float = wired(DATA, default=1.0)
    """(m,) indicator, 1 for a planned move and 0 for one that is left out; one number counts for all."""
    beyond_model_mU_min: jax.Array | float = wired(DATA, default=0.0)
    """Difference of the person's basal rate from the model's, which is subtracted from the rate given to the model."""
    floor: GlucoseFloor | None = wired(DATA, default=None)
    learning_pace: jax.Array | float | None = wired(DATA, default=None)
    """Pace at which the size of a correlated error of the sensor is learned, or None for noise as it is told."""
    moves: int = wired(STATIC, default=0)
    """Number of planned moves, as the arrays have them."""
    dead_time_samples: int = wired(STATIC, default=0)
    sample_time_min: float = wired(STATIC, default=5.0)
    halvings: int = wired(STATIC, default=0)
    """Halvings of the matrix exponential that samples the linearisation."""

    def designed(self, case: DesignCase) -> NLQDMC:
        """NLQDMC with state estimation, on the equations of the patient."""
        case = case.behind_lag(self.sensor_lag_min)
        noise = case.process_noise(*self.noise_variances)
        return self.of_model(case.nonlinear(), noise, case.limits, dead_time_samples=case.dead_time_samples)

    def of_model(
        self,
        model: NonlinearModel,
        process_noise: jax.typing.ArrayLike,
        limits: DoseLimits,
        *,
        dead_time_samples: int = 0,
        min_horizon: int = 1,
    ) -> NLQDMC:
        """The controller on a model; see `design_nlqdmc_se`.

        A horizon of 0 becomes one that suits the model and is not shorter than `min_horizon`.
        """
        n = model.state.shape[0]
        Q = np.asarray(process_noise, float)
        Q = np.diag(Q) if Q.ndim == 1 else Q
        if (
            Q.shape != (n, n)
            or not np.all(np.isfinite(Q))
            or not np.allclose(Q, Q.T)
            or np.linalg.eigvalsh(Q)[0] < -1e-12
        ):
            raise Refusal(f"the process noise must be a covariance of the {n} states; give {n} variances of 0 or more")
        if dead_time_samples < 0:
            raise Refusal(
                f"a dead time of {dead_time_samples} samples is not possible; give a whole number of 0 or more"
            )
        at_rest = _linearised(model, model.state, model.insulin_mU_min)
        linear = discretise(at_rest, model.sample_time_min)
        steady = steady_state_gain(linear.Phi, linear.reading_row, Q, self.measurement_variance).prediction_covariance
        tuning = suited(self, *response_at_rest(model), usual=min_horizon).longer(dead_time_samples)
        controller: NLQDMC = tuning.made(
            model=model,
            Q=jnp.asarray(Q),
            covariance=triangle(jnp.pad(steady, (0, 1 if self.noise_pace else 0))),
            R=self.measurement_variance,
            reference=jnp.asarray(tuning.reference_factors()),
            Gamma_y=tuning.output_weight,
            Gamma_u=tuning.move_weight,
            limits=limits,
            floor=glucose_floor(self.glucose_floor_mg_dl, self.floor_weight),
            learning_pace=self.noise_pace or None,
            moves=tuning.move_horizon,
            dead_time_samples=dead_time_samples,
            sample_time_min=model.sample_time_min,
            halvings=halvings_of(at_rest, model.sample_time_min),
        )
        return controller

    @property
    def horizons(self) -> tuple[int, int]:
        """Number of planned moves and of predicted samples, as the arrays have them."""
        return self.moves, self.reference.shape[0]

    def padded(self, moves: int, horizon: int) -> NLQDMC:
        """The same controller with room for more moves and more samples, none of which has any weight."""
        own_moves, own_horizon = self.horizons
        more_moves, more_samples = moves - own_moves, horizon - own_horizon
        weight = jnp.broadcast_to(jnp.asarray(self.Gamma_y, float), (own_horizon,))
        planned = jnp.broadcast_to(jnp.asarray(self.planned, float), (own_moves,))
        return self.replaced(
            reference=jnp.pad(self.reference, (0, more_samples)),
            Gamma_y=jnp.pad(weight, (0, more_samples)),
            planned=jnp.pad(planned, (0, more_moves)),
            floor=None if self.floor is None else self.floor.padded(own_horizon, horizon),
            moves=moves,
        )

    def with_basal(self, insulin_mU_min: jax.Array) -> NLQDMC:
        """The same controller for a person with the given basal rate."""
        return self.replaced(beyond_model_mU_min=insulin_mU_min - self.model.insulin_mU_min)

    def settled(self) -> dict[str, Any]:
        """Horizons, in samples; a known dead time is within them."""
        return dict(zip(("move_horizon", "prediction_horizon"), self.horizons, strict=True))

    def init(self, observation: Observation) -> _NLQDMCState:
        """State of a controller at steady state at the model's operating point."""
        basal = self.model.insulin_mU_min + self.beyond_model_mU_min
        delivered = rate_at_start(observation, basal)
        sensor = None if self.learning_pace is None else no_error(delivered)
        return _NLQDMCState(
            estimate=self.model.state, covariance=self.covariance, insulin_mU_min=delivered, sensor=sensor
        )

    def step(self, state: _NLQDMCState, observation: Observation) -> tuple[_NLQDMCState, Decision]:
        """Carry the estimate to this sample, linearise there, correct by the reading, plan, and make the first move."""
        planned = self._planned(state, observation)
        x, delivered, sensor = planned.estimate, planned.delivered_mU_min, planned.sensor
        # An estimate that no person can have may never come back; the operating point is all that is left to go by.
        sound = jnp.all(jnp.isfinite(x)) & is_of_a_person(self.model.glucose_mg_dl(x))
        if sensor is not None:
            sound = sound & sensor.sound
            sensor = sensor.or_none(sound)
        state = _NLQDMCState(
            estimate=jnp.where(sound, x, self.model.state),
            covariance=jnp.where(sound, planned.covariance, self.covariance),
            insulin_mU_min=delivered,
            sensor=sensor,
        )
        wanted = jnp.where(sound, delivered + planned.moves[0], jnp.nan)
        return state, decide(wanted, delivered, self.limits, planned.known, planned.converged)

    def forecast(self, state: _NLQDMCState, observation: Observation) -> DoseForecast:
        """Forecast to the prediction horizon under all planned moves; that of readings where they have a dead time."""
        of = self._planned(state, observation)
        free = jnp.append(self.model.glucose_mg_dl(of.estimate), of.free_mg_dl)
        return forecast_of_moves(of.moves, of.response, free, of.delivered_mU_min, self.limits, self.sample_time_min)

    def _planned(self, state: _NLQDMCState, observation: Observation) -> _Planned:
        """Carry the estimate to this sample, linearise there, correct by the reading, and plan."""
        delivered = delivered_since(observation, state.insulin_mU_min)
        rate = delivered - self.beyond_model_mU_min
        x = self.model.advance(state.estimate, rate)
        glucose, reading = self.model.glucose_mg_dl, reading_of(self.model)
        linear = discretise(_linearised(self.model, x, rate), self.sample_time_min, self.halvings)
        covariance = jnp.where(is_covariance(state.covariance), state.covariance, self.covariance)
        known, residual, sensor = is_known(observation), observation.glucose_mg_dl - reading(x), None
        if self.learning_pace is None or state.sensor is None:
            C = linear.reading_row
            covariance = next_covariance(covariance, linear.Phi, C, self.Q, self.R)
            seen = whole(covariance) @ C
            K = seen / (C @ seen + self.R)
            correction = K * jnp.where(known, residual, 0.0)
        else:
            covariance, sensor, correction = self._learn(
                linear, covariance, state.sensor, residual, known, self.learning_pace
            )
        x = x + correction

        def ahead(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
            x = self.model.advance(x, rate) + correction
            return x, glucose(x)

        p = self.reference.shape[0]
        _, free = jax.lax.scan(ahead, x, None, length=p)
        target = observation.setpoint_mg_dl
        reference = target + self.reference * (glucose(x) - target)
        S = jnp.concatenate([jnp.zeros(self.dead_time_samples), step_response(linear, p - self.dead_time_samples)])
        weight = jnp.broadcast_to(jnp.asarray(self.Gamma_y), (p,))
        response = dynamic_matrix(S, self.moves, p)
        A = weight[:, None] * response * self.planned
        # A move that is left out costs something and gains nothing, so that the minimiser does not make it.
        hessian = A.T @ A + (self.Gamma_u**2 + 1.0 - self.planned) * jnp.eye(self.moves)
        gradient = -A.T @ (weight * (reference - free))
        if self.floor is None:
            moves, converged = minimise_within(hessian, gradient, delivered, self.limits)
        else:
            response = response * self.planned
            moves, converged = minimise_above(self.floor, hessian, gradient, response, free, delivered, self.limits)
        return _Planned(known, delivered, x, covariance, sensor, free, response, moves, converged)

    def _learn(
        self,
        linear: LinearModel,
        covariance: jax.Array,
        sensor: SensorError,
        residual: jax.Array,
        known: jax.Array,
        pace: jax.Array | float,
    ) -> tuple[jax.Array, SensorError, jax.Array]:
        """Estimate the error of the sensor and its size from what a reading is off its prediction.

        The error is one more state of the linearisation. Returns the covariance with that state, the estimates, and the
        correction of the state.
        """
        Phi = jnp.pad(linear.Phi, (0, 1)).at[-1, -1].set(CORRELATION)
        drive = (1.0 - CORRELATION**2) * sensor.deviation_mg_dl**2
        Q = jnp.pad(self.Q, (0, 1)).at[-1, -1].set(drive)
        C = jnp.append(linear.reading_row, 1.0)
        covariance = next_covariance(covariance, Phi, C, Q, self.R)
        seen = whole(covariance) @ C
        variance = C @ seen + self.R
        K = seen / variance
        error = CORRELATION * sensor.error_mg_dl
        innovation = jnp.where(known, residual - error, 0.0)
        result = SensorError(
            error_mg_dl=error + K[-1] * innovation,
            deviation_mg_dl=learned(sensor.deviation_mg_dl, innovation / jnp.sqrt(variance), known, pace),
        )
        return covariance, result, K[:-1] * innovation


def _linearised(model: NonlinearModel, x: jax.Array, insulin_mU_min: jax.Array) -> ContinuousModel:
    return linearise(model.derivative, model.glucose_mg_dl, x, insulin_mU_min, reading=own_reading(model))


@checked
@on_host("it checks the covariance of the noise, number by number")
def design_nlqdmc_se(
    model: NonlinearModel,
    process_noise: jax.typing.ArrayLike,
    tuning: StateTuning | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    measurement_variance: float = NLQDMC.measurement_variance,
    dead_time_samples: int = 0,
    glucose_floor_mg_dl: float = NLQDMC.glucose_floor_mg_dl,
    floor_weight: float = NLQDMC.floor_weight,
    noise_pace: float = NLQDMC.noise_pace,
) -> NLQDMC:
    """`NLQDMC` on a nonlinear model.

    Parameters
    ----------
    model : NonlinearModel
        Internal model of the person; `simulation.internal_model.nonlinear_model` makes one from a patient, and
        `models.sensor_lag.behind_lag` one of a sensor that lags.
    process_noise, tuning, limits, measurement_variance, dead_time_samples, noise_pace
        As for `design_mpc_se`.
    glucose_floor_mg_dl, floor_weight : float
        As for `design_linear_mpc`.

    Raises
    ------
    ValueError
        For a pace outside 0 to 1, noise that is not a covariance of the model's size, a dead time that is negative, or
        a floor that is not possible.
    """
    settings, min_horizon = NLQDMC().tuned(
        tuning,
        measurement_variance=measurement_variance,
        glucose_floor_mg_dl=glucose_floor_mg_dl,
        floor_weight=floor_weight,
        noise_pace=noise_pace,
    )
    return settings.of_model(model, process_noise, limits, dead_time_samples=dead_time_samples, min_horizon=min_horizon)
