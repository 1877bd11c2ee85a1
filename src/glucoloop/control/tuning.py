"""Tuning of predictive controllers, and the tunings of Parker, Doyle and Peppas (1999).

Horizons, weights and reference filters are printed in the captions of Fig. 4 and 5 and in Sec. IV to VI. The
entries of the process noise are not legible: the paper says that those of the glucose and glucagon states are raised
without noise and that all are below 1 with it. The values here are our reading, one per operating point.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop._lazy_jax import np
from glucoloop.component.effects import ANNOUNCEMENTS, ONLY_READINGS, READINGS
from glucoloop.component.pytree_component import DATA, HOST, STATIC
from glucoloop.component.setting import About, default_by_noise
from glucoloop.control.part import CAUTION, FLOOR, ControllerComponent, SensorLag
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import GLUCOSE_BOUND

_LONGEST_MOVE_HORIZON: Final = 50
LONGEST_PREDICTION_HORIZON: Final = 288

PredictionHorizon = Annotated[
    int,
    About(
        "Predicted samples, p; a known dead time is added to them. 0: enough to see 30 % of the gain of the model.",
        at_least=0,
        at_most=LONGEST_PREDICTION_HORIZON,
    ),
]
OutputWeight = Annotated[float, About("Weight on the error of glucose, Γ_y.", above=0.0)]
MoveWeight = Annotated[float, About("Weight on each move of insulin, Γ_u.", at_least=0.0)]
ReferenceFilter = Annotated[
    float, About("Filter of the reference, φ_r; closer to 1 is slower.", at_least=0.0, below=1.0)
]
Constraints = Annotated[
    Literal["clip", "qp"],
    About("clip: the closed form, clipped as in the paper; qp: the best moves within the pump's limits."),
]
FloorGlucose = Annotated[
    float,
    About(
        "Soft floor under predicted glucose, in mg/dl; 0 for none. It implies the moves of qp.",
        at_least=0.0,
        quantity=GLUCOSE_BOUND,
    ),
]
FloorWeight = Annotated[float, About("Weight on the violation of the floor, w.", above=0.0, needs=(FLOOR,))]
MeasurementVariance = Annotated[float, About("Variance of a reading that the filter assumes, R.", above=0.0)]
NoisePace = Annotated[
    float,
    About(
        "Pace at which the size of a correlated error of the sensor is learned, in mg/dl per innovation; "
        "0: the noise is as told.",
        at_least=0.0,
        at_most=1.0,
    ),
]
DEFAULT_FLOOR_WEIGHT: Final = 10.0


class MPCTuning(ControllerComponent):
    """Horizons and weights of a predictive controller."""

    used: ClassVar = ONLY_READINGS
    role_of_settings: ClassVar = HOST

    move_horizon: Annotated[int, About("Number of planned moves, m.", at_least=1, at_most=_LONGEST_MOVE_HORIZON)] = 2
    prediction_horizon: PredictionHorizon = default_by_noise(default=8, noisy=10)
    output_weight: OutputWeight = default_by_noise(default=1.0, noisy=3.0)
    move_weight: MoveWeight = default_by_noise(default=0.0, noisy=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.prediction_horizon < self.move_horizon:
            raise Refusal(
                f"a prediction horizon of {self.prediction_horizon} is not possible with a move horizon of "
                f"{self.move_horizon}; give a whole number from {self.move_horizon} to {LONGEST_PREDICTION_HORIZON}"
            )

    def longer(self, samples: int) -> Self:
        """The same tuning with a longer prediction horizon, as for a known dead time."""
        longer = self.prediction_horizon and self.prediction_horizon + samples  # 0 is chosen by a model that has it
        return dataclasses.replace(self, prediction_horizon=longer)

    def tuned(self, tuning: MPCTuning | None, **settings: Any) -> tuple[Self, int]:
        """Settings with those of a tuning and others, and the minimum horizon where it suits the model.

        Without a tuning it is the default one, with a horizon that suits the model and is not shorter than its own.
        """
        if tuning is None:
            return type(self)(**{**self.values(), "prediction_horizon": 0, **settings}), self.prediction_horizon
        own = {name: value for name, value in tuning.values().items() if name in self.settings()}
        return type(self)(**{**self.values(), **own, **settings}), 1


class StateTuning(MPCTuning):
    """Tuning of the controllers that estimate the state: the horizons and weights, and a reference filter.

    The reference goes from the estimated glucose to the setpoint as ``phi_r^(i-s)`` for the sample i ahead.
    """

    reference_filter: ReferenceFilter = 0.65
    reference_start: Annotated[
        int, About("1: the reference starts to move at the next sample; 0: at this one.", at_least=0, at_most=1)
    ] = 1

    def reference_factors(self) -> Any:
        """Factors ``phi_r^(i-s)`` of the reference for i = 1 .. p, an array ``(p,)``."""
        ahead = np.arange(1, self.prediction_horizon + 1) - self.reference_start
        return np.asarray(self.reference_filter**ahead, np.float64)


class FilterTuning(StateTuning):
    """Tuning of a controller with a Kalman filter."""

    output_weight: OutputWeight = 1.0
    glucose_process_noise: Annotated[float, About("Process noise of each glucose state, in Q.", at_least=0.0)] = (
        default_by_noise(default=30.0, noisy=0.9)
    )
    other_process_noise: Annotated[
        float, About("Process noise of each insulin state and slow insulin effect.", at_least=0.0)
    ] = default_by_noise(default=0.1, noisy=0.01)
    glucagon_process_noise: Annotated[float, About("Process noise of glucagon and its slow effect.", at_least=0.0)] = (
        default_by_noise(default=10.0, noisy=0.005)
    )
    measurement_variance: MeasurementVariance = 1.45
    noise_pace: NoisePace = 0.0
    sensor_lag_min: SensorLag = 0.0

    @property
    def noise_variances(self) -> tuple[float, float, float]:
        """Variances of glucose, of insulin and slow effects, and of glucagon, for `DesignCase.process_noise`."""
        return self.glucose_process_noise, self.other_process_noise, self.glucagon_process_noise


class MealTuning(MPCTuning):
    """Tuning of the meal-aware controller: the horizons and weights, and how careful it is.

    The caution weight is multiplied by ``sqrt(P (1 - P) + 0.1)``: the variance of whether there is a meal, and what is
    not known of a certain one, its end and the speed of the stomach. At an anticipation of 1 glucose rests a little
    below the setpoint, 0.2 mg/dl without noise and 0.8 with noise of variance 1.45, and the peak after 50 g is lower by
    0.2 and 0.5. At 0 it rests 0.1 below with this noise, and at the setpoint without noise.
    """

    used: ClassVar = frozenset({READINGS, ANNOUNCEMENTS})

    prediction_horizon: PredictionHorizon = 12
    output_weight: Annotated[OutputWeight, DATA] = 1.0
    move_weight: Annotated[MoveWeight, DATA] = 0.22
    caution_weight: Annotated[float, About("Weight on low glucose if the meal ended at once.", at_least=0.0), DATA] = (
        3.5
    )
    caution_mg_dl: Annotated[
        float,
        About(
            "Distance below the setpoint at which that counts as low without noise, in mg/dl; less with noise.",
            at_least=0.0,
            needs=(CAUTION,),
        ),
        DATA,
    ] = 2.2
    glucose_floor_mg_dl: Annotated[FloorGlucose, DATA] = 65.0
    floor_weight: Annotated[FloorWeight, DATA] = DEFAULT_FLOOR_WEIGHT
    anticipation: Annotated[
        float,
        About(
            "Share of the always expected meals for which insulin is given; 0: glucose rests at the setpoint.",
            at_least=0.0,
            at_most=1.0,
        ),
        DATA,
    ] = 0.0
    doubt: Annotated[
        float,
        About(
            "Share of the unexplained appearance of glucose that may stop at once; 1: no dose rests on it alone.",
            at_least=0.0,
            at_most=1.0,
        ),
        DATA,
    ] = 1.0
    gut_doubt: Annotated[
        float,
        About(
            "Share of the content of stomach and gut that the lowest likely forecast lacks if noise is large.",
            at_least=0.0,
            below=1.0,
        ),
        DATA,
    ] = 0.4
    iterations: Annotated[int, About("Quadratic programs solved at each sample.", at_least=1, at_most=10), STATIC] = 1


NOISE_FREE: Final = MPCTuning(move_horizon=2, prediction_horizon=8, output_weight=1.0, move_weight=0.0)
"""Tuning of Sec. IV with the smallest sum of squared errors without noise."""
NOISY: Final = MPCTuning(move_horizon=2, prediction_horizon=10, output_weight=3.0, move_weight=1.0)
"""Tuning of Sec. IV for noise of variance 1.45."""


@dataclass(frozen=True)
class _PaperTuning:
    """Tuning of the paper's controllers in one setting."""

    mpc: MPCTuning
    mpc_se: StateTuning
    nlqdmc_se: StateTuning
    noise: tuple[float, float, float]
    """Process noise of glucose, of insulin and its slow effects, and of glucagon, as `process_noise` takes it."""


def _tuning(reference_start: int, noisy: bool, noise: tuple[float, float, float]) -> _PaperTuning:
    return _PaperTuning(
        mpc=NOISY if noisy else NOISE_FREE,
        mpc_se=StateTuning(2, 8 if noisy else 7, 1.0, 1.0 if noisy else 0.0, 0.65, reference_start),
        # The paper shows NLQDMC/SE without noise only; with noise it is detuned here as MPC/SE is.
        nlqdmc_se=StateTuning(2, 6 if noisy else 5, 1.0, 1.0 if noisy else 0.0, 0.57, reference_start),
        noise=noise,
    )


PARKER_1999: Final = {
    ("setpoint-81", False): _tuning(1, False, (30.0, 0.1, 10.0)),
    ("setpoint-81", True): _tuning(1, True, (0.9, 0.01, 0.005)),
    ("nominal-22", False): _tuning(0, False, (10.0, 0.01, 0.1)),
    ("nominal-22", True): _tuning(0, True, (0.9, 0.01, 0.003)),
    ("fasting-81", False): _tuning(0, False, (10.0, 0.01, 0.1)),
    ("fasting-81", True): _tuning(0, True, (0.3, 0.1, 0.03)),
}
"""Tunings by operating point, and by whether readings are noisy."""
