"""Settings of the controllers, each declared once: type, bounds, unit, meaning and default.

Each declaration becomes an option, a key of configuration files, and a line of the help and of the documentation.
Nothing here imports JAX, so that help is shown at once.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop.component.effects import ANNOUNCEMENTS, ONLY_READINGS, READINGS, TIME_OF_DAY, Need
from glucoloop.component.ranges import Tuned
from glucoloop.component.setting import About, usual
from glucoloop.control.part import ControllerPart
from glucoloop.estimation.unknown_meal.settings import ESTIMATORS, EstimatorPart, NoisePace
from glucoloop.refusal import Refusal
from glucoloop.sensors.delay import LONGEST_LAG_MIN
from glucoloop.unit_guess import (
    FITTED_STEP,
    GLUCOSE_BOUND,
    LAG,
    MEAL,
    PID_GAIN,
)

if TYPE_CHECKING:
    from glucoloop.estimation.unknown_meal import MealHabits

_STEADY: Final = Need("meals_by_time takes its place")
LONGEST_MOVE_HORIZON: Final = 50
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
GlucoseFloor = Annotated[
    float,
    About(
        "Soft floor under predicted glucose, in mg/dl; 0 for none. It implies the moves of qp.",
        at_least=0.0,
        quantity=GLUCOSE_BOUND,
    ),
]
FloorWeight = Annotated[float, About("Weight on the violation of the floor, w.", above=0.0)]
MeasurementVariance = Annotated[float, About("Variance of a reading that the filter assumes, R.", above=0.0)]
SensorLag = Annotated[
    float,
    About(
        "First-order lag of the sensor behind glucose that the estimator knows of, in minutes; 0: none.",
        at_least=0.0,
        at_most=LONGEST_LAG_MIN,
        quantity=LAG,
    ),
]
FittedStep = Annotated[
    float,
    About(
        "Lasting step of insulin to which the first-order model is fitted, in mU/min; "
        "0: 11.165, or half the basal rate where that is less.",
        at_least=0.0,
        quantity=FITTED_STEP,
    ),
]
DEFAULT_FLOOR_WEIGHT: Final = 10.0


class _OfReadings(ControllerPart):
    used: ClassVar = ONLY_READINGS


class MPCTuning(_OfReadings):
    """Horizons and weights of a predictive controller."""

    move_horizon: Annotated[int, About("Number of planned moves, m.", at_least=1, at_most=LONGEST_MOVE_HORIZON)] = 2
    prediction_horizon: PredictionHorizon = usual(default=8, noisy=10)
    output_weight: OutputWeight = usual(default=1.0, noisy=3.0)
    move_weight: MoveWeight = usual(default=0.0, noisy=1.0)

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


class StateTuning(MPCTuning):
    """Tuning of the controllers that estimate the state: the horizons and weights, and a reference filter.

    The reference goes from the estimated glucose to the setpoint as ``phi_r^(i-s)`` for the sample i ahead.
    """

    reference_filter: ReferenceFilter = 0.65
    reference_start: Annotated[
        int, About("1: the reference starts to move at the next sample; 0: at this one.", at_least=0, at_most=1)
    ] = 1

    def reference(self) -> Any:
        """Factors ``phi_r^(i-s)`` of the reference for i = 1 .. p, an array ``(p,)``."""
        import numpy as np

        ahead = np.arange(1, self.prediction_horizon + 1) - self.reference_start
        return np.asarray(self.reference_filter**ahead, np.float64)


class _Planned:
    """A controller whose moves keep the pump's limits and, if asked for, a floor under predicted glucose."""

    constraints: str
    glucose_floor_mg_dl: float
    floor_weight: float

    @property
    def moves(self) -> dict[str, Any]:
        """Arguments of design functions for the computation of the moves."""
        names = ("constraints", "glucose_floor_mg_dl", "floor_weight")
        return {name: getattr(self, name) for name in names if hasattr(self, name)}


class LinearMPCSettings(MPCTuning, _Planned, name="mpc"):
    """Linear model predictive control on the identified step response."""

    sources = ("parker1999", "lee1994")
    design: ClassVar = "glucoloop.control.linear_mpc:design"
    individual: ClassVar = "glucoloop.build.individual:linear_mpc"
    tunable: ClassVar = True

    constraints: Constraints = "clip"
    glucose_floor_mg_dl: GlucoseFloor = 0.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT


class _Estimating(StateTuning, _Planned):
    """Settings of a controller with a Kalman filter."""

    output_weight: OutputWeight = 1.0
    glucose_process_noise: Annotated[float, About("Process noise of each glucose state, in Q.", at_least=0.0)] = usual(
        default=30.0, noisy=0.9
    )
    other_process_noise: Annotated[
        float, About("Process noise of each insulin state and slow insulin effect.", at_least=0.0)
    ] = usual(default=0.1, noisy=0.01)
    glucagon_process_noise: Annotated[float, About("Process noise of glucagon and its slow effect.", at_least=0.0)] = (
        usual(default=10.0, noisy=0.005)
    )
    measurement_variance: MeasurementVariance = 1.45
    noise_pace: NoisePace = 0.0
    sensor_lag_min: SensorLag = 0.0

    @property
    def process_noise(self) -> tuple[float, float, float]:
        """Variances of glucose, of insulin and slow effects, and of glucagon, for `DesignCase.process_noise`."""
        return self.glucose_process_noise, self.other_process_noise, self.glucagon_process_noise


class MPCSESettings(_Estimating, name="mpc-se"):
    """Linear MPC with a Kalman filter on the linearised patient."""

    sources = ("parker1999", "ricker1990")
    design: ClassVar = "glucoloop.control.mpc_se:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:mpc_se"
    tunable: ClassVar = True
    reference_filters: ClassVar = ".3:.8:.05"

    prediction_horizon: PredictionHorizon = usual(default=7, noisy=8)
    offset_free: Annotated[
        Literal["held-innovation", "output-disturbance", "input-disturbance", "none"],
        About("Way of removing a lasting error."),
    ] = "held-innovation"
    constraints: Constraints = "clip"
    glucose_floor_mg_dl: GlucoseFloor = 0.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT


class NLQDMCSettings(_Estimating, name="nlqdmc-se"):
    """Predictive control on the nonlinear patient, linearised anew at each sample, with a Kalman filter."""

    sources = ("parker1999", "gattu1992")
    design: ClassVar = "glucoloop.control.nlqdmc_se:design"
    uses_model: ClassVar = False
    tunable: ClassVar = True
    reference_filters: ClassVar = ".3:.5:.1|.57|.7|.8"  # half as many, since its loops take longer

    prediction_horizon: PredictionHorizon = usual(default=5, noisy=6)
    reference_filter: ReferenceFilter = 0.57
    glucose_floor_mg_dl: GlucoseFloor = 0.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT


class MealTuning(MPCTuning):
    """Tuning of the meal-aware controller: the horizons and weights, and how careful it is.

    The caution weight is multiplied by ``sqrt(P (1 - P) + 0.1)``: the variance of whether there is a meal, and what is
    not known of a certain one, its end and the speed of the stomach. At an anticipation of 1 glucose rests a little
    below the setpoint, 0.2 mg/dl without noise and 0.8 with noise of variance 1.45, and the peak after 50 g is lower by
    0.2 and 0.5. At 0 it rests 0.1 below with this noise, and at the setpoint without noise.
    """

    used: ClassVar = frozenset({READINGS, ANNOUNCEMENTS})

    prediction_horizon: PredictionHorizon = 12
    output_weight: OutputWeight = 1.0
    move_weight: MoveWeight = 0.22
    caution_weight: Annotated[float, About("Weight on low glucose if the meal ended at once.", at_least=0.0)] = 3.5
    caution_mg_dl: Annotated[
        float,
        About(
            "Distance below the setpoint at which that counts as low without noise, in mg/dl; less with noise.",
            at_least=0.0,
        ),
    ] = 2.2
    glucose_floor_mg_dl: GlucoseFloor = 65.0
    floor_weight: FloorWeight = DEFAULT_FLOOR_WEIGHT
    anticipation: Annotated[
        float,
        About(
            "Share of the always expected meals for which insulin is given; 0: glucose rests at the setpoint.",
            at_least=0.0,
            at_most=1.0,
        ),
    ] = 0.0
    doubt: Annotated[
        float,
        About(
            "Share of the unexplained appearance of glucose that may stop at once; 1: no dose rests on it alone.",
            at_least=0.0,
            at_most=1.0,
        ),
    ] = 1.0
    gut_doubt: Annotated[
        float,
        About(
            "Share of the content of stomach and gut that the lowest likely forecast lacks if noise is large.",
            at_least=0.0,
            below=1.0,
        ),
    ] = 0.4
    iterations: Annotated[int, About("Quadratic programs solved at each sample.", at_least=1, at_most=10)] = 1


class MealMPCSettings(MealTuning, name="meal-mpc"):
    """Predictive control on the nonlinear patient that estimates meals nobody announced."""

    sources = ("lehmann1992", "diehl2005")
    design: ClassVar = "glucoloop.control.meal_mpc:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:individual_meal_mpc"
    slow: ClassVar = True
    searched: ClassVar = (
        Tuned("move_weight", 0.02, 2.0, log=True),
        Tuned("caution_weight", 0.5, 50.0, log=True),
        Tuned("caution_mg_dl", 0.0, 15.0, log=False),
        Tuned("meals_per_h", 0.02, 5.0, log=True),
        Tuned("mean_carbs_g", 10.0, 150.0, log=True),
        Tuned("disturbance_variance", 0.1, 1000.0, log=True),
        Tuned("output_weight", 0.1, 10.0, log=True, by_default=False),
        Tuned("glucose_floor_mg_dl", 55.0, 80.0, log=False, by_default=False),
        Tuned("floor_weight", 0.5, 50.0, log=True, by_default=False),
        Tuned("measurement_variance", 0.3, 30.0, log=True, by_default=False),
    )

    estimator: Annotated[EstimatorPart, About("Estimator of meals.")] = ESTIMATORS[ESTIMATORS.usual].partial({})
    meals_per_h: Annotated[
        float,
        About("Expected number of meals per hour; more is quicker and less certain.", above=0.0, needs=(_STEADY,)),
    ] = 0.57
    meals_by_time: Annotated[
        str,
        About(
            "Expected number of meals per hour by the time of day, in place of meals_per_h: values with the times from "
            "which they hold, like '0.6@06:30 0.02@22:00', or 24 numbers, one for each hour; empty: always the same."
        ),
    ] = ""
    mean_carbs_g: Annotated[float, About("Mean size of a meal, in g.", above=0.0, quantity=MEAL)] = 20.0
    disturbance_variance: Annotated[
        float, About("Variance of the change of unexplained glucose per sample, (mg/min)².", at_least=0.0)
    ] = 10.0
    measurement_variance: Annotated[
        float,
        About(
            "Variance of a reading that the filter assumes, R; 0: that of the sensor, from 0.01 to 1.45 where the "
            "estimator learns the noise beyond it.",
            at_least=0.0,
        ),
    ] = 0.0
    sensor_lag_min: SensorLag = 0.0
    individual_by: Annotated[
        Literal["record", "basal", "none"],
        About("Source of gain and lag of insulin in a design for each person, beside the basal rate."),
    ] = "record"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.needs_time_of_day:
            self.habits()

    def uses(self) -> frozenset[Need]:
        """Needs that the controller meets; the time of day where meals are expected by it."""
        return super().uses() | frozenset({TIME_OF_DAY} if self.needs_time_of_day else {_STEADY})

    @property
    def needs_time_of_day(self) -> bool:
        """Whether the expected number of meals depends on the time of day."""
        return bool(self.meals_by_time)

    def habits(self) -> MealHabits:
        """Prior of meals; meals by the time of day that are no table are refused."""
        from glucoloop.estimation.unknown_meal import MealHabits

        return MealHabits(self.meals_per_h, self.mean_carbs_g, self.meals_by_time)


class IMCSettings(_OfReadings, name="imc"):
    """Internal model control with a filter, on a first-order model with dead time."""

    sources = ("parker1999", "sorensen1985", "morari1989")
    design: ClassVar = "glucoloop.control.imc:design"
    uses_model: ClassVar = False

    filter_min: Annotated[float, About("Time constant of the filter, λ, in minutes.", above=0.0)] = 1.0
    delay_min: Annotated[float, About("Dead time of the first-order model, in minutes.", at_least=0.0)] = 5.0
    step_mU_min: FittedStep = 0.0


class PIDSettings(_OfReadings, name="pid"):
    """PID whose integral never winds up, tuned on a first-order model with dead time."""

    sources = ("rivera1986", "astrom1989")
    design: ClassVar = "glucoloop.control.pid:design"
    uses_model: ClassVar = False

    closed_loop_min: Annotated[float, About("Desired time constant of the loop, in minutes.", above=0.0)] = 30.0
    gain: Annotated[
        float, About("Gain K_c, in mU/min per mg/dl; 0: from the model.", at_least=0.0, quantity=PID_GAIN)
    ] = 0.0
    integral_time_min: Annotated[float, About("Integral time T_I, in minutes; 0: from the model.", at_least=0.0)] = 0.0
    derivative_time_min: Annotated[
        float, About("Derivative time T_D, in minutes; -1: from the model.", at_least=-1.0)
    ] = -1.0
    step_mU_min: FittedStep = 0.0


class BasalSettings(ControllerPart, name="basal"):
    """The rate at which the loop starts, without a controller."""

    design: ClassVar = "glucoloop.control.open_loop:design"
    uses_model: ClassVar = False
    individual: ClassVar = None
    used: ClassVar = frozenset()
