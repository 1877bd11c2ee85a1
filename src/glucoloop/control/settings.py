"""Settings of the controllers, each declared once: type, bounds, unit, meaning and default.

Each declaration becomes an option, a key of configuration files, and a line of the help and of the documentation.
Nothing here imports JAX, so that help is shown at once.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop.control.part import ControllerPart
from glucoloop.estimation.unknown_meal.settings import ESTIMATORS, EstimatorPart, NoisePace
from glucoloop.parts.ranges import Tuned
from glucoloop.parts.setting import About, usual
from glucoloop.plausible import (
    ACTION_TIME,
    BOLUS_STEP,
    CARB_RATIO,
    CORRECTION,
    FITTED_STEP,
    GLUCOSE_BOUND,
    LAG,
    MEAL,
    PID_GAIN,
)
from glucoloop.refusal import Refusal
from glucoloop.sensors.settings import LONGEST_LAG_MIN

if TYPE_CHECKING:
    from glucoloop.estimation.unknown_meal import MealHabits

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
CarbRatio = Annotated[
    float,
    About(
        "Carbohydrate that 1 U covers, in g; 0: of the person's profile, or 500 over the total daily dose.",
        at_least=0.0,
        quantity=CARB_RATIO,
    ),
]
MealShare = Annotated[
    float, About("Share of the bolus for an announced meal that is given; 0: none.", at_least=0.0, at_most=2.0)
]
CorrectionFactor = Annotated[
    float,
    About(
        "Fall of glucose by 1 U, in mg/dl; 0: of the person's profile, or 1800 over the total daily dose.",
        at_least=0.0,
        quantity=CORRECTION,
    ),
]
DEFAULT_FLOOR_WEIGHT: Final = 10.0


class MPCTuning(ControllerPart):
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

    design: ClassVar = "glucoloop.control.linear_mpc:design"
    individual: ClassVar = "glucoloop.experiments.individual:linear_mpc"
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

    design: ClassVar = "glucoloop.control.mpc_se:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:mpc_se"
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

    The caution weight is multiplied by the standard deviation of whether there is a meal, ``sqrt(P (1 - P))``, and so
    counts where the estimate is uncertain. At an anticipation of 1 glucose rests a little below the setpoint, 0.2 mg/dl
    without noise and 0.8 with noise of variance 1.45, and the peak after 50 g is lower by 0.2 and 0.5. At 0 it rests
    0.1 below with this noise, and at the setpoint without noise.
    """

    prediction_horizon: PredictionHorizon = 12
    output_weight: OutputWeight = 1.0
    move_weight: MoveWeight = 0.22
    caution_weight: Annotated[float, About("Weight on low glucose if the meal ended at once.", at_least=0.0)] = 3.5
    caution_mg_dl: Annotated[
        float, About("Distance below the setpoint at which that counts as low, in mg/dl.", at_least=0.0)
    ] = 0.8
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
    ] = 0.35
    iterations: Annotated[int, About("Quadratic programs solved at each sample.", at_least=1, at_most=10)] = 1


class MealMPCSettings(MealTuning, name="meal-mpc"):
    """Predictive control on the nonlinear patient that estimates meals nobody announced."""

    design: ClassVar = "glucoloop.control.meal_mpc:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:individual_meal_mpc"
    slow: ClassVar = True
    searched: ClassVar = (
        Tuned("move_weight", 0.02, 2.0, log=True),
        Tuned("caution_weight", 0.5, 50.0, log=True),
        Tuned("caution_mg_dl", 0.0, 15.0, log=False),
        Tuned("meals_per_h", 0.02, 5.0, log=True),
        Tuned("mean_carbs_g", 10.0, 150.0, log=True),
        Tuned("disturbance_variance", 0.1, 1000.0, log=True),
        Tuned("output_weight", 0.1, 10.0, log=True, unasked=False),
        Tuned("glucose_floor_mg_dl", 55.0, 80.0, log=False, unasked=False),
        Tuned("floor_weight", 0.5, 50.0, log=True, unasked=False),
        Tuned("measurement_variance", 0.3, 30.0, log=True, unasked=False),
    )

    estimator: Annotated[EstimatorPart, About("Estimator of meals.")] = ESTIMATORS[ESTIMATORS.usual].partial({})
    meals_per_h: Annotated[
        float, About("Expected number of meals per hour; more is quicker and less certain.", above=0.0)
    ] = 0.57
    meals_by_time: Annotated[
        str,
        About(
            "Expected number of meals per hour by the time of day, in place of meals_per_h: values with the times from "
            "which they hold, like '0.6@06:30 0.02@22:00', or 24 numbers, one for each hour; empty: always the same."
        ),
    ] = ""
    mean_carbs_g: Annotated[float, About("Mean size of a meal, in g.", above=0.0, quantity=MEAL)] = 24.0
    disturbance_variance: Annotated[
        float, About("Variance of the change of unexplained glucose per sample, (mg/min)².", at_least=0.0)
    ] = 8.0
    measurement_variance: Annotated[
        float,
        About("Variance of a reading that the filter assumes, R; 0: that of the sensor, at least 0.01.", at_least=0.0),
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

    @property
    def needs_time_of_day(self) -> bool:
        """Whether the expected number of meals depends on the time of day."""
        return bool(self.meals_by_time)

    def habits(self) -> MealHabits:
        """Prior of meals; meals by the time of day that are no table are refused."""
        from glucoloop.estimation.unknown_meal import MealHabits

        return MealHabits(self.meals_per_h, self.mean_carbs_g, self.meals_by_time)


class ProfileMPCSettings(ControllerPart, name="profile-mpc"):
    """Predictive control by the profile of a person, with boluses for announced meals; for insulin under the skin."""

    design: ClassVar = "glucoloop.control.profile_mpc:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:by_profile"
    gives_boluses: ClassVar = True
    slow: ClassVar = True

    straight_beyond_mg_dl: Annotated[
        float, About("Distance above the target beyond which the cost grows no faster, in mg/dl.", above=0.0)
    ] = 5.0
    low_weight: Annotated[
        float, About("How many times as dear expected glucose below the target is as above it.", above=0.0)
    ] = 50.0
    glucose_floor_mg_dl: Annotated[
        float,
        About("Floor under the cautious forecast, in mg/dl, at most the target.", above=0.0, quantity=GLUCOSE_BOUND),
    ] = 90.0
    floor_weight: Annotated[
        float, About("How many times as dear the cautious forecast below the floor is.", at_least=0.0)
    ] = 20.0
    doubt: Annotated[
        float,
        About("Standard deviations of the content of the gut that the cautious forecast lacks.", at_least=0.0),
    ] = 1.5
    disturbance_doubt: Annotated[
        float,
        About("Share of the unexplained appearance that the cautious forecast lacks.", at_least=0.0, at_most=1.0),
    ] = 0.5
    move_weight: Annotated[float, About("Weight on planned rates away from the basal rate.", at_least=0.0)] = 1.0
    bolus_weight: Annotated[
        float, About("The same for the coming sample, unless a meal was announced for it.", at_least=0.0)
    ] = 0.15
    automatic_boluses: Annotated[
        bool,
        About(
            "Whether insulin that is wanted at once is a bolus at any time, or with announced meals alone: true or "
            "false."
        ),
    ] = True
    gut_min: Annotated[
        float, About("Time from eating to the largest appearance of glucose, in minutes.", above=0.0)
    ] = 40.0
    counting_error_pct: Annotated[
        float, About("Standard deviation of the error of announced carbohydrate, in percent.", at_least=0.0)
    ] = 30.0
    meal_noise_g: Annotated[float, About("Standard deviation of what is eaten unannounced in 5 min.", at_least=0.0)] = (
        6.0
    )
    disturbance_noise_mg_min: Annotated[
        float, About("Standard deviation of the change of the unexplained appearance in 5 min.", at_least=0.0)
    ] = 10.0
    disturbance_min: Annotated[
        float, About("Time constant with which the unexplained appearance fades.", above=0.0)
    ] = 60.0
    glucose_noise_mg_min: Annotated[
        float, About("Standard deviation of further appearance, new at each sample.", at_least=0.0)
    ] = 10.0
    measurement_variance: Annotated[
        float,
        About("Variance of white noise of a reading, R; 0: that of the sensor, at least 0.25.", at_least=0.0),
    ] = 0.0
    sensor_error_mg_dl: Annotated[
        float, About("Standard deviation of a correlated error of the sensor; 0: none.", at_least=0.0)
    ] = 0.0
    sensor_lag_min: SensorLag = 0.0


class IMCSettings(ControllerPart, name="imc"):
    """Internal model control with a filter, on a first-order model with dead time."""

    design: ClassVar = "glucoloop.control.imc:design"
    uses_model: ClassVar = False

    filter_min: Annotated[float, About("Time constant of the filter, λ, in minutes.", above=0.0)] = 1.0
    delay_min: Annotated[float, About("Dead time of the first-order model, in minutes.", at_least=0.0)] = 5.0
    step_mU_min: FittedStep = 0.0


class PIDSettings(ControllerPart, name="pid"):
    """PID whose integral never winds up, tuned on a first-order model with dead time."""

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


class PIDIFBSettings(ControllerPart, name="pid-ifb"):
    """PID with insulin feedback and meal boluses, by the total daily dose, as in hybrid closed loops."""

    design: ClassVar = "glucoloop.control.pid_ifb:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:by_profile"
    gives_boluses: ClassVar = True

    gain: Annotated[float, About("Factor on the gain that follows from the total daily dose.", above=0.0)] = 1.0
    integral_time_min: Annotated[float, About("Integral time T_I, in minutes.", above=0.0)] = 450.0
    derivative_time_min: Annotated[float, About("Derivative time T_D, in minutes.", above=0.0)] = 90.0
    feedback: Annotated[
        float, About("Factor on the gains of the insulin feedback; 0: a PID controller.", at_least=0.0, at_most=5.0)
    ] = 1.0
    carb_ratio_g_U: CarbRatio = 0.0
    meal_bolus: MealShare = 1.0


class LoopLikeSettings(ControllerPart, name="loop-like"):
    """Forecast and doses after LoopKit's: insulin, meals, unexplained changes, and the slope of readings."""

    design: ClassVar = "glucoloop.control.loop_like:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:by_profile"
    gives_boluses: ClassVar = True

    dosing: Annotated[
        Literal["automatic-bolus", "temporary-basal"],
        About("Way of correcting: 40 % of the dose as a bolus at each sample, or a rate that gives it in 30 min."),
    ] = "automatic-bolus"
    insulin: Annotated[
        Literal["rapid-adult", "rapid-child", "fiasp", "lyumjev"], About("Insulin whose course of action is assumed.")
    ] = "rapid-adult"
    carb_ratio_g_U: CarbRatio = 0.0
    correction_mg_dl_U: CorrectionFactor = 0.0
    range_mg_dl: Annotated[
        float, About("Width of the correction range around the setpoint, in mg/dl.", at_least=0.0, at_most=200.0)
    ] = 10.0
    suspend_mg_dl: Annotated[
        float,
        About("Forecast glucose below which no insulin is given, in mg/dl.", above=0.0, quantity=GLUCOSE_BOUND),
    ] = 75.0
    absorption_min: Annotated[
        float, About("Absorption time of meals, in minutes.", above=0.0, quantity=ACTION_TIME)
    ] = 180.0
    max_basal: Annotated[float, About("Largest temporary rate, in basal rates.", at_least=1.0, at_most=20.0)] = 4.0
    max_bolus_U: Annotated[float, About("Largest bolus, in U; twice it is the most on board.", above=0.0)] = 10.0
    meal_bolus: MealShare = 1.0


class BasalBolusSettings(ControllerPart, name="basal-bolus"):
    """Basal rate, and boluses for announced meals and against high glucose, by the usual formula."""

    design: ClassVar = "glucoloop.control.basal_bolus:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:by_profile"
    gives_boluses: ClassVar = True

    carb_ratio_g_U: CarbRatio = 0.0
    correction_mg_dl_U: CorrectionFactor = 0.0
    insulin_on_board_min: Annotated[
        float, About("Minutes after which 5 % of a bolus is still under the skin.", above=0.0, quantity=ACTION_TIME)
    ] = 300.0
    correction_above_mg_dl: Annotated[
        float,
        About("Reading above which a correction is given without a meal, in mg/dl.", above=0.0, quantity=GLUCOSE_BOUND),
    ] = 180.0
    correction_every_min: Annotated[
        float,
        About("Minutes since the last bolus before which no correction is given without a meal.", at_least=0.0),
    ] = 180.0


class Oref0Settings(ControllerPart, name="oref0"):
    """oref0 0.7.1 of OpenAPS: temporary basal rates and microboluses by four forecasts; research only.

    The defaults are those of oref0, but for two that allow no more than a temporary basal rate below the person's own
    until they are changed: ``max_iob_U``, which is 0 there, and ``enable_smb_always``, which is off there. Preferences
    have their names of there.
    """

    design: ClassVar = "glucoloop.control.oref0.controller:design"
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.experiments.individual:by_profile"
    gives_boluses: ClassVar = True

    meal_bolus: Annotated[
        float,
        About(
            "Share of an announced meal for which the person gives a bolus by the carbohydrate ratio; 0: no bolus.",
            at_least=0.0,
            at_most=1.0,
        ),
    ] = 1.0
    carb_ratio_g_U: CarbRatio = 0.0
    correction_mg_dl_U: CorrectionFactor = 0.0
    curve: Annotated[
        Literal["rapid-acting", "ultra-rapid"], About("Curve of insulin action, which peaks after 75 or 55 min.")
    ] = "rapid-acting"
    insulin_action_min: Annotated[
        float, About("Time for which insulin acts (DIA).", at_least=300.0, at_most=600.0, quantity=ACTION_TIME)
    ] = 300.0
    insulin_peak_min: Annotated[
        float, About("Time of the peak of insulin action; 0: of the curve.", at_least=0.0, at_most=120.0)
    ] = 0.0
    max_iob_U: Annotated[
        float,
        About(
            "Largest insulin on board above the basal rate; 0: three hours of the basal rate and a mean meal's bolus.",
            at_least=0.0,
        ),
    ] = 0.0
    max_basal_mU_min: Annotated[
        float, About("Largest temporary basal rate; 0: as the two multipliers and the pump allow.", at_least=0.0)
    ] = 0.0
    max_daily_safety_multiplier: Annotated[
        float, About("Largest temporary basal rate, in basal rates of the day.", above=0.0)
    ] = 3.0
    current_basal_safety_multiplier: Annotated[
        float, About("Largest temporary basal rate, in present basal rates.", above=0.0)
    ] = 4.0
    enable_uam: Annotated[bool, About("Whether meals that nobody announced are forecast.")] = True
    enable_smb_always: Annotated[bool, About("Whether microboluses are given at any time.")] = True
    enable_smb_with_cob: Annotated[bool, About("Whether microboluses are given with carbohydrate on board.")] = False
    enable_smb_after_carbs: Annotated[bool, About("Whether microboluses are given for six hours after a meal.")] = False
    enable_smb_high_bg: Annotated[bool, About("Whether microboluses are given while glucose is high.")] = False
    enable_smb_high_bg_target_mg_dl: Annotated[
        float, About("Glucose from which enable_smb_high_bg takes it for high.", above=0.0, quantity=GLUCOSE_BOUND)
    ] = 110.0
    max_smb_basal_min: Annotated[float, About("Largest microbolus, in minutes of the basal rate.", above=0.0)] = 30.0
    max_uam_smb_basal_min: Annotated[
        float,
        About(
            "Largest microbolus where insulin on board covers the carbohydrate, in minutes of the basal rate.",
            above=0.0,
        ),
    ] = 30.0
    smb_interval_min: Annotated[
        float, About("Least time from one bolus to a microbolus.", at_least=1.0, at_most=10.0)
    ] = 3.0
    bolus_increment_U: Annotated[float, About("Step of microboluses.", above=0.0, quantity=BOLUS_STEP)] = 0.1
    max_delta_bg_threshold: Annotated[
        float,
        About("Rise in 5 min, as a share of glucose, above which no microbolus is given.", above=0.0, at_most=0.3),
    ] = 0.2
    min_5m_carbimpact: Annotated[
        float, About("Least rise of glucose by carbohydrate on board, in mg/dl per 5 min.", above=0.0)
    ] = 8.0
    max_cob_g: Annotated[float, About("Largest carbohydrate on board.", above=0.0)] = 120.0
    remaining_carbs_fraction: Annotated[
        float, About("Share of carbohydrate that appears though nothing tells of it yet.", above=0.0, at_most=1.0)
    ] = 1.0
    remaining_carbs_cap_g: Annotated[
        float, About("Largest carbohydrate that appears though nothing tells of it yet.", above=0.0, at_most=90.0)
    ] = 90.0
    steps_per_U_h: Annotated[
        Literal[20, 40], About("Steps of 1 U/h of a temporary basal rate below 1 U/h; 40 of the pumps x23 and x54.")
    ] = 20
    flat_is_error: Annotated[
        bool, About("Whether readings that do not change for 40 min are taken for an error of the sensor.")
    ] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = (50.0, 120.0) if self.curve == "rapid-acting" else (35.0, 100.0)
        if self.insulin_peak_min and not least <= self.insulin_peak_min <= most:
            raise Refusal(
                f"a peak of {self.curve} insulin after {self.insulin_peak_min:g} min is not possible; "
                f"give insulin_peak_min from {least:g} to {most:g} min, or 0"
            )


class BasalSettings(ControllerPart, name="basal"):
    """The rate at which the loop starts, without a controller."""

    design: ClassVar = "glucoloop.control.open_loop:design"
    uses_model: ClassVar = False
    individual: ClassVar = None
