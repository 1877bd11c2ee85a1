"""Linear model predictive control with state estimation (MPC/SE).

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. V; N. L. Ricker, Ind. Eng. Chem. Res. 29, 1990.
"""

from __future__ import annotations

import dataclasses
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, on_host
from glucoloop.component.pytree_component import DATA, STATIC, wired
from glucoloop.component.setting import About, default_by_noise
from glucoloop.control.decision import decide, delivered_since, is_known, is_of_a_person, rate_at_start
from glucoloop.control.design_case import DesignCase
from glucoloop.control.horizon import linear_response, suited, unseen
from glucoloop.control.planning import MovePlan, glucose_floor, plan_moves, plans_of_people
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.control.tuning import (
    DEFAULT_FLOOR_WEIGHT,
    Constraints,
    FilterTuning,
    FloorGlucose,
    FloorWeight,
    PredictionHorizon,
    StateTuning,
)
from glucoloop.estimation.kalman import steady_state_gain
from glucoloop.estimation.noise_level import NoisyFilters, SensorError, no_error, noisy_filters, shares
from glucoloop.models.state_space import LinearModel
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal

Matrix: TypeAlias = "npt.NDArray[np.float64]"


@pytree
class _MPCSEState:
    """State of the controller."""

    estimate: jax.Array
    """(n, ...) filtered state, a deviation from the model's operating point."""
    insulin_mU_min: jax.Array
    """Rate delivered before this sample."""
    sensor: SensorError | None = None
    """Correlated error of the sensor, where its size is learned."""


class _Observed(NamedTuple):
    """Estimate at a sample, and glucose ahead as deviations from that of the model."""

    known: jax.Array
    delivered_mU_min: jax.Array
    rate_mU_min: jax.Array
    """The delivered rate as a deviation."""
    estimate: jax.Array
    sensor: SensorError | None
    error_mg_dl: jax.Array
    """(p, ...) reference less the free response."""
    free_mg_dl: jax.Array
    """(p, ...) free response."""


@pytree
class _NoiseLearning:
    """Filters by the size of a correlated error of the sensor, and what follows from them."""

    filters: NoisyFilters
    free_innovation: jax.Array
    """(levels, p) free response to the innovation under the gain of each filter, if it is held."""


@dataclass(frozen=True)
class FilteredModels:
    """Models of many people with the gains of their filters, people trailing."""

    Phi: Matrix
    """(n, n, people) transition matrices."""
    Gamma: Matrix
    """(n, people) effects of insulin."""
    C: Matrix
    """(n, people) output rows."""
    kalman_gain: Matrix
    """(n, people) Kalman gains in filter form."""
    rest: Matrix
    """(n, people) steady state per unit of insulin."""


class MPCSE(FilterTuning, name="mpc-se"):
    """Linear MPC with a Kalman filter on the linearised patient.

    The estimate is corrected by ``z += K e`` with the innovation ``e = y - C z``. The free response goes on from it,
    ``w_i = Phi w_(i-1) + Gamma u_(k-1) + K e``, the innovation being held over the horizon, and the moves minimise::

        Gamma_y^2 sum_i (r_i - C w_i - (A du)_i)^2 + Gamma_u^2 |du|^2,    r_i = phi_r^(i-s) C z

    in deviations from the operating point.

    ============  ==========================================  ========
    variable      meaning                                     size
    ============  ==========================================  ========
    ``z``         estimated state                             (n,)
    ``K``         Kalman gain, filter form                    (n,)
    ``A``         dynamic matrix of the model                 (p, m)
    ``r``         filtered reference                          (p,)
    ============  ==========================================  ========

    A lasting error is removed in one of these ways. ``"held-innovation"``: the correction K e is repeated at each
    sample ahead, the reading of the paper that its numbers need. It brings the estimate C z to the setpoint, so that of
    a lasting disturbance the part ``(1 - C K) e`` of the innovation is left: little where readings are trusted.
    ``"output-disturbance"`` and ``"input-disturbance"``: an integrating state is estimated beside the others, on the
    output or as unmeasured insulin, and nothing is left. ``"none"``: the plain prediction.
    """

    sources = ("parker1999", "ricker1990")
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:mpc_se"
    tunable: ClassVar = True
    reference_filters: ClassVar = ".3:.8:.05"
    heals: ClassVar[bool] = True
    """Whether a step leaves a finite state after any state, so that a guard need not check it."""

    prediction_horizon: PredictionHorizon = default_by_noise(default=7, noisy=8)
    offset_free: Annotated[
        Literal["held-innovation", "output-disturbance", "input-disturbance", "none"],
        About("Way of removing a lasting error."),
    ] = "held-innovation"
    constraints: Constraints = "clip"
    glucose_floor_mg_dl: FloorGlucose = 0.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT
    _: KW_ONLY
    Phi: jax.Array = wired(DATA, default=None)
    Gamma: jax.Array = wired(DATA, default=None)
    C: jax.Array = wired(DATA, default=None)
    kalman_gain: jax.Array = wired(DATA, default=None)
    """(n,) steady Kalman gain in filter form."""
    rest: jax.Array = wired(DATA, default=None)
    """(n,) steady state per unit of insulin."""
    free_state: jax.Array = wired(DATA, default=None)
    """(p, n) free response to the estimate, ``C Phi^i``."""
    free_input: jax.Array = wired(DATA, default=None)
    """(p,) free response to the rate in force."""
    free_innovation: jax.Array = wired(DATA, default=None)
    """(p,) free response to the innovation, if it is held."""
    reference: jax.Array = wired(DATA, default=None)
    """(p,) factors ``phi_r^(i-s)`` of the reference."""
    plan: MovePlan = wired(DATA, default=None)
    basal_mU_min: jax.Array = wired(DATA, default=None)
    basal_glucose_mg_dl: jax.Array = wired(DATA, default=None)
    C_reading: jax.Array | None = wired(DATA, default=None)
    """(n,) output row of the sensor, or None where it reads glucose."""
    learning: _NoiseLearning | None = wired(DATA, default=None)
    """Filters by the size of a correlated error of the sensor, which is learned; None for noise as it is told."""
    dead_time_samples: int = wired(STATIC, default=0)
    sample_time_min: float = wired(STATIC, default=5.0)

    def designed(self, case: DesignCase) -> MPCSE:
        """MPC with state estimation, on the patient linearised at the operating point."""
        case = case.behind_lag(self.sensor_lag_min)
        noise = case.process_noise(*self.noise_variances)
        return self.of_model(case.linearised(), noise, case.limits, dead_time_samples=case.dead_time_samples)

    def of_model(
        self,
        model: LinearModel,
        process_noise: jax.typing.ArrayLike,
        limits: DoseLimits,
        *,
        dead_time_samples: int = 0,
        disturbance_variance: float = 1.0,
        min_horizon: int = 1,
    ) -> MPCSE:
        """The controller on a model; see `design_mpc_se`.

        A horizon of 0 becomes one that suits the model and is not shorter than `min_horizon`.
        """
        if dead_time_samples < 0:
            raise Refusal(
                f"a dead time of {dead_time_samples} samples is not possible; give a whole number of 0 or more"
            )
        Q = np.asarray(process_noise, float)
        Q = np.diag(Q) if Q.ndim == 1 else Q
        parts = (model.Phi, model.Gamma, model.C, model.reading_row)
        Phi, Gamma, C, C_reading = (np.asarray(part, float) for part in parts)
        n = Gamma.size
        rest = np.linalg.solve(np.eye(n) - Phi, Gamma)
        if self.offset_free.endswith("disturbance"):
            Phi, Gamma, (C, C_reading), Q = _with_disturbance(
                Phi, Gamma, (C, C_reading), Q, self.offset_free, disturbance_variance
            )
            rest = np.append(rest, 0.0)
        K = np.asarray(steady_state_gain(Phi, C_reading, Q, self.measurement_variance).gain)
        tuning = suited(self, *linear_response(model), usual=min_horizon)

        Phi, Gamma, C, K, rest = (part[..., None] for part in (Phi, Gamma, C, K, rest))
        one = tuning.of_people(
            FilteredModels(Phi=Phi, Gamma=Gamma, C=C, kalman_gain=K, rest=rest),
            limits,
            basal_mU_min=model.insulin_mU_min,
            basal_glucose_mg_dl=model.glucose_mg_dl,
            sample_time_min=model.sample_time_min,
            dead_time_samples=dead_time_samples,
        )
        tuned = tuning.longer(dead_time_samples)
        varying = ("Phi", "Gamma", "C", "kalman_gain", "rest", "free_state", "free_input", "free_innovation")
        S = np.append(np.zeros(dead_time_samples), one.free_input[..., 0])
        plan = plan_moves(S, tuned, limits, self.constraints, one.plan.floor)
        learning = None
        if self.noise_pace > 0.0:
            filters = noisy_filters(Phi[..., 0], C_reading, Q, self.measurement_variance, pace=self.noise_pace)
            free_response = np.zeros((len(filters.gain), tuned.prediction_horizon))
            if self.offset_free == "held-innovation":
                # C Phi^i of i = 0 .. p - 1; the free response to the estimate begins with i = 1
                ahead = np.concatenate([C.T, np.asarray(one.free_state)[:-1, :, 0]])
                free_response = np.cumsum(np.asarray(filters.gain)[:, :-1] @ ahead.T, axis=1)
            learning = _NoiseLearning(filters=filters, free_innovation=jnp.asarray(free_response))
        return one.replaced(
            plan=plan,
            C_reading=None if model.C_reading is None else jnp.asarray(C_reading),
            learning=learning,
            **{name: getattr(one, name)[..., 0] for name in varying},
        )

    def of_people(
        self,
        models: FilteredModels,
        limits: DoseLimits,
        *,
        basal_mU_min: jax.Array,
        basal_glucose_mg_dl: jax.Array,
        sample_time_min: float,
        dead_time_samples: int = 0,
    ) -> MPCSE:
        """Controllers of many people, who trail, from their models and Kalman gains.

        The rate of a person whose model at the horizon shows less than `horizon.MIN_SHARE` of its gain is kept.
        """
        floor = glucose_floor(self.glucose_floor_mg_dl, self.floor_weight)
        seen_samples = self.prediction_horizon
        tuning = self.longer(dead_time_samples)
        Phi, Gamma, kalman_gain = models.Phi, models.Gamma, models.kalman_gain
        rows = [models.C]
        for _ in range(tuning.prediction_horizon):
            rows.append(np.einsum("i...,ij...->j...", rows[-1], Phi))
        C_Phi = np.stack(rows)  # C Phi^i, i = 0 .. p
        free_input = np.cumsum(np.einsum("pi...,i...->p...", C_Phi[:-1], Gamma), axis=0)
        free_innovation = np.cumsum(np.einsum("pi...,i...->p...", C_Phi[:-1], kalman_gain), axis=0)
        hidden = unseen(free_input, np.einsum("i...,i...->...", models.C, models.rest), seen_samples)
        late = np.zeros((dead_time_samples, *free_input.shape[1:]))
        controller: MPCSE = tuning.made(
            Phi=jnp.asarray(Phi),
            Gamma=jnp.asarray(Gamma),
            C=jnp.asarray(models.C),
            kalman_gain=jnp.asarray(kalman_gain),
            rest=jnp.asarray(models.rest),
            free_state=jnp.asarray(C_Phi[1:]),
            free_input=jnp.asarray(free_input),
            free_innovation=jnp.asarray(
                free_innovation if self.offset_free == "held-innovation" else np.zeros_like(free_input)
            ),
            reference=jnp.asarray(tuning.reference_factors()),
            plan=plans_of_people(
                np.concatenate([late, free_input]), tuning, limits, self.constraints, floor, hidden=hidden
            ),
            basal_mU_min=basal_mU_min,
            basal_glucose_mg_dl=basal_glucose_mg_dl,
            dead_time_samples=dead_time_samples,
            sample_time_min=sample_time_min,
        )
        return controller

    @property
    def horizons(self) -> tuple[int, int]:
        """Number of planned moves and of predicted samples, as the arrays have them."""
        return self.plan.hessian.shape[0], self.plan.gain.shape[0]

    def settled(self) -> dict[str, Any]:
        """Horizons, in samples; a known dead time is within them."""
        return dict(zip(("move_horizon", "prediction_horizon"), self.horizons, strict=True))

    def padded(self, moves: int, horizon: int) -> MPCSE:
        """The same controller with room for more moves and more samples, none of which has any weight."""
        more_samples = horizon - self.horizons[1]
        return self.replaced(
            free_state=jnp.pad(self.free_state, ((0, more_samples), (0, 0))),
            free_input=jnp.pad(self.free_input, (0, more_samples)),
            free_innovation=jnp.pad(self.free_innovation, (0, more_samples)),
            reference=jnp.pad(self.reference, (0, more_samples)),
            learning=self.learning
            and dataclasses.replace(
                self.learning, free_innovation=jnp.pad(self.learning.free_innovation, ((0, 0), (0, more_samples)))
            ),
            plan=self.plan.padded(moves, horizon),
        )

    def with_basal(self, insulin_mU_min: jax.Array) -> MPCSE:
        """The same controller for a person with the given basal rate, from which deviations are taken."""
        return self.replaced(basal_mU_min=insulin_mU_min)

    def init(self, observation: Observation) -> _MPCSEState:
        """State of a controller at steady state under the delivered rate."""
        delivered = rate_at_start(observation, self.basal_mU_min)
        return _MPCSEState(
            estimate=jnp.multiply.outer(self.rest, delivered - self.basal_mU_min),
            insulin_mU_min=delivered,
            sensor=None if self.learning is None else no_error(delivered),
        )

    def step(self, state: _MPCSEState, observation: Observation) -> tuple[_MPCSEState, Decision]:
        """Carry the estimate to this sample, correct it by the reading, plan, and make the first move."""
        seen = self._observed(state, observation)
        delivered, estimate, sensor = seen.delivered_mU_min, seen.estimate, seen.sensor
        move, converged = self.plan.first_move(seen.error_mg_dl, delivered, self.basal_glucose_mg_dl + seen.free_mg_dl)

        # An estimate that no person can have comes back late or never; rest under the present rate is all that is
        # left to go by.
        sound = jnp.all(jnp.isfinite(estimate), axis=0) & is_of_a_person(self.basal_glucose_mg_dl + self.C @ estimate)
        if sensor is not None:
            sound = sound & sensor.sound
            sensor = sensor.or_none(sound)
        estimate = jnp.where(sound, estimate, jnp.multiply.outer(self.rest, seen.rate_mU_min))
        state = _MPCSEState(estimate=estimate, insulin_mU_min=delivered, sensor=sensor)
        wanted = jnp.where(sound, delivered + move, jnp.nan)
        return state, decide(wanted, delivered, self.plan.limits, seen.known, converged)

    def forecast(self, state: _MPCSEState, observation: Observation) -> DoseForecast:
        """Forecast to the prediction horizon under all planned moves; that of readings where they have a dead time."""
        seen = self._observed(state, observation)
        now = self.C @ seen.estimate
        free = self.basal_glucose_mg_dl + jnp.concatenate([now[None], seen.free_mg_dl])
        response = jnp.concatenate([jnp.zeros(self.dead_time_samples), self.free_input])
        return self.plan.forecast(seen.error_mg_dl, seen.delivered_mU_min, free, response, self.sample_time_min)

    def _observed(self, state: _MPCSEState, observation: Observation) -> _Observed:
        """Carry the estimate to this sample, correct it by the reading, and predict under the delivered rate."""
        delivered = delivered_since(observation, state.insulin_mU_min)
        rate = delivered - self.basal_mU_min
        estimate = self.Phi @ state.estimate + jnp.multiply.outer(self.Gamma, rate)
        known = is_known(observation)
        predicted = (self.C if self.C_reading is None else self.C_reading) @ estimate
        innovation = jnp.where(known, observation.glucose_mg_dl - self.basal_glucose_mg_dl - predicted, 0.0)
        sensor = free_response = None
        if self.learning is None or state.sensor is None:
            estimate = estimate + jnp.multiply.outer(self.kalman_gain, innovation)
        else:
            sensor, correction, free_response = self._learn(self.learning, state.sensor, innovation, known)
            estimate = estimate + correction

        target = observation.setpoint_mg_dl - self.basal_glucose_mg_dl
        reference = target + jnp.multiply.outer(self.reference, self.C @ estimate - target)
        free = self.free_state @ estimate + jnp.multiply.outer(self.free_input, rate)
        free = free + (jnp.multiply.outer(self.free_innovation, innovation) if free_response is None else free_response)
        return _Observed(known, delivered, rate, estimate, sensor, reference - free, free)

    def _learn(
        self, learning: _NoiseLearning, sensor: SensorError, residual: jax.Array, known: jax.Array
    ) -> tuple[SensorError, jax.Array, jax.Array]:
        """Estimate the error of the sensor and its size from what a reading is off its prediction.

        Returns the estimates, the correction of the state ``(n, ...)``, and the free response to it ``(p, ...)``.
        """
        filters = learning.filters
        share = shares(sensor.deviation_mg_dl)
        gain = jnp.einsum("l...,ln->n...", share, filters.gain)
        deviation = jnp.sqrt(jnp.einsum("l...,l->...", share, filters.innovation_variance))
        error = filters.correlation * sensor.error_mg_dl
        innovation = jnp.where(known, residual - error, 0.0)
        result = SensorError(
            error_mg_dl=error + gain[-1] * innovation,
            deviation_mg_dl=filters.learn(sensor.deviation_mg_dl, innovation / deviation, known),
        )
        free_response = jnp.einsum("l...,lp->p...", share, learning.free_innovation) * innovation
        return result, gain[:-1] * innovation, free_response


def _with_disturbance(
    Phi: Matrix, Gamma: Matrix, outputs: tuple[Matrix, ...], Q: Matrix, offset_free: str, variance: float
) -> tuple[Matrix, Matrix, tuple[Matrix, ...], Matrix]:
    """Add one integrating state, a disturbance of each output or of the input."""
    n = Gamma.size
    on_output = offset_free == "output-disturbance"
    Phi = np.block([[Phi, np.zeros((n, 1)) if on_output else Gamma[:, None]], [np.zeros((1, n)), np.ones((1, 1))]])
    Q = np.block([[Q, np.zeros((n, 1))], [np.zeros((1, n)), np.full((1, 1), variance)]])
    return Phi, np.append(Gamma, 0.0), tuple(np.append(row, 1.0 if on_output else 0.0) for row in outputs), Q


@checked
@on_host("its Kalman gain comes from a Riccati equation that SciPy solves")
def design_mpc_se(
    model: LinearModel,
    process_noise: jax.typing.ArrayLike,
    tuning: StateTuning | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    measurement_variance: float = MPCSE.measurement_variance,
    offset_free: str = MPCSE.offset_free,
    disturbance_variance: float = 1.0,
    dead_time_samples: int = 0,
    constraints: str = MPCSE.constraints,
    glucose_floor_mg_dl: float = MPCSE.glucose_floor_mg_dl,
    floor_weight: float = MPCSE.floor_weight,
    noise_pace: float = MPCSE.noise_pace,
) -> MPCSE:
    """`MPCSE` on a state-space model, with a steady Kalman filter and a reference filter.

    Parameters
    ----------
    model : LinearModel
        Model of the person, and perhaps of a sensor that lags; `simulation.internal_model.linear_model` makes one from
        a patient. The innovation is of the sensor's reading, all else of glucose.
    process_noise : (n,) or (n, n) array
        Q, per sample; a vector is its diagonal.
    tuning : StateTuning, optional
        Tuning; by default that of the catalogue, its horizon longer where the model is slower, so that at its end the
        response has `horizon.DEFAULT_SHARE` of the gain. A horizon of 0 follows from the model too.
    limits : DoseLimits
        Limits of the pump, by default those of 1999; give ``gl.usual_limits(patient)`` for another patient.
    measurement_variance : float
        R, (mg/dl)^2.
    offset_free : {"held-innovation", "output-disturbance", "input-disturbance", "none"}
        Way of removing a lasting error.
    disturbance_variance : float
        Process noise of that integrating state, (mg/dl)^2 or (mU/min)^2 per sample.
    dead_time_samples : int
        Dead time that the controller knows of: as many rows of zeros enter A and the horizon grows by as many, while
        the filter is unchanged, as in the paper.
    constraints : {"clip", "qp"}
        Argument as in `design_linear_mpc`.
    glucose_floor_mg_dl, floor_weight : float
        Argument as in `design_linear_mpc`.
    noise_pace : float
        Pace at which the size of a correlated error of the sensor, beside the noise of variance R, is learned, mg/dl
        per innovation; see `estimation.noise_level`. 0: there is no such error, as in the paper.

    Raises
    ------
    ValueError
        For an unknown option, a pace outside 0 to 1, a floor that is not possible, noise that is not a covariance, a
        model whose gain is not below 0, that shows less than `horizon.MIN_SHARE` of it within the horizon or that
        cannot be estimated from glucose, or a dead time that is negative.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> model = LinearModel(
    ...     Phi=jnp.array([[0.9]]), Gamma=jnp.array([-0.3]), C=jnp.array([1.0]), state=jnp.array([81.0]),
    ...     insulin_mU_min=jnp.array(25.0), glucose_mg_dl=jnp.array(81.0), sample_time_min=5.0,
    ... )
    >>> controller = design_mpc_se(model, [1.0], StateTuning(move_horizon=2, prediction_horizon=7))
    >>> round(float(controller.kalman_gain[0]), 4)
    0.5276
    """
    settings, min_horizon = MPCSE().tuned(
        tuning,
        measurement_variance=measurement_variance,
        offset_free=offset_free,
        constraints=constraints,
        glucose_floor_mg_dl=glucose_floor_mg_dl,
        floor_weight=floor_weight,
        noise_pace=noise_pace,
    )
    return settings.of_model(
        model,
        process_noise,
        limits,
        dead_time_samples=dead_time_samples,
        disturbance_variance=disturbance_variance,
        min_horizon=min_horizon,
    )
