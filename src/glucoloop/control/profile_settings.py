"""Settings of the controllers that dose by the profile of a person and give boluses, each declared once.

See `glucoloop.control.settings` for those of the others.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from glucoloop.component.effects import AHEAD, ANNOUNCEMENTS, DOSES_BY_PROFILE, Need
from glucoloop.component.setting import About
from glucoloop.control.part import ControllerPart
from glucoloop.control.settings import SensorLag
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import ACTION_TIME, BOLUS_STEP, CARB_RATIO, CORRECTION, GLUCOSE_BOUND

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


class _ByProfile(ControllerPart):
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:by_profile"
    gives_boluses: ClassVar = True
    used: ClassVar = DOSES_BY_PROFILE


class ProfileMPCSettings(_ByProfile, name="profile-mpc"):
    """Predictive control by the profile of a person, with boluses for announced meals; for insulin under the skin."""

    sources = ("hovorka2004", "boiroux2018", "diehl2005")
    design: ClassVar = "glucoloop.control.profile_mpc:design"
    slow: ClassVar = True

    straight_beyond_mg_dl: Annotated[
        float, About("Distance above the target beyond which the cost grows no faster, in mg/dl.", above=0.0)
    ] = 5.0
    low_weight: Annotated[
        float, About("Cost of expected glucose below the target, as a multiple of that above it.", above=0.0)
    ] = 50.0
    glucose_floor_mg_dl: Annotated[
        float,
        About("Floor under the cautious forecast, in mg/dl, at most the target.", above=0.0, quantity=GLUCOSE_BOUND),
    ] = 90.0
    floor_weight: Annotated[
        float,
        About("Cost of the cautious forecast below the floor, as a multiple of that above the target.", at_least=0.0),
    ] = 20.0
    doubt: Annotated[
        float,
        About(
            "Standard deviations by which the cautious forecast takes the content of the gut to be less.", at_least=0.0
        ),
    ] = 1.0
    disturbance_doubt: Annotated[
        float,
        About(
            "Share of the appearance of glucose that no meal explains which the cautious forecast leaves out.",
            at_least=0.0,
            at_most=1.0,
        ),
    ] = 0.5
    move_weight: Annotated[
        float, About("Weight on planned rates away from the basal rate, as multiples of it.", at_least=0.0)
    ] = 45.0
    bolus_weight: Annotated[
        float,
        About(
            "Weight on the rate of the coming sample away from the basal rate, unless a meal is announced.",
            at_least=0.0,
        ),
    ] = 7.0
    automatic_boluses: Annotated[
        bool,
        About(
            "Whether insulin that is wanted at once is a bolus at any time, or with announced meals alone: true or "
            "false."
        ),
    ] = True
    gut_min: Annotated[
        float,
        About("Longest time from eating to the largest appearance of glucose that is believed, in minutes.", above=0.0),
    ] = 36.0
    gut_error_pct: Annotated[
        float,
        About(
            "Standard deviation of people's own times, which are learned from their meals, in percent; 0: gut_min is "
            "everybody's.",
            at_least=0.0,
        ),
    ] = 25.0
    counting_error_pct: Annotated[
        float, About("Standard deviation of the error of announced carbohydrate, in percent.", at_least=0.0)
    ] = 30.0
    meal_noise_g: Annotated[
        float, About("Standard deviation of the carbohydrate that is eaten unannounced in 5 min.", at_least=0.0)
    ] = 6.0
    disturbance_noise_mg_min: Annotated[
        float, About("Standard deviation of the change in 5 min of the appearance that no meal explains.", at_least=0.0)
    ] = 10.0
    disturbance_min: Annotated[
        float, About("Time constant with which the appearance that no meal explains fades.", above=0.0)
    ] = 60.0
    glucose_noise_mg_min: Annotated[
        float, About("Standard deviation of a part of that appearance which is new at each sample.", at_least=0.0)
    ] = 10.0
    measurement_variance: Annotated[
        float,
        About("Variance of white noise of a reading, R; 0: that of the sensor, at least 0.25.", at_least=0.0),
    ] = 0.0
    sensor_error_mg_dl: Annotated[
        float, About("Standard deviation of a correlated error of the sensor; 0: none.", at_least=0.0)
    ] = 9.0
    sensor_lag_min: SensorLag = 10.0


class PIDIFBSettings(_ByProfile, name="pid-ifb"):
    """PID with insulin feedback and meal boluses, by the total daily dose, as in hybrid closed loops."""

    sources = ("steil2011", "ruiz2012")
    design: ClassVar = "glucoloop.control.pid_ifb:design"

    gain: Annotated[float, About("Factor on the gain that follows from the total daily dose.", above=0.0)] = 1.0
    integral_time_min: Annotated[float, About("Integral time T_I, in minutes.", above=0.0)] = 450.0
    derivative_time_min: Annotated[float, About("Derivative time T_D, in minutes.", above=0.0)] = 90.0
    feedback: Annotated[
        float, About("Factor on the gains of the insulin feedback; 0: a PID controller.", at_least=0.0, at_most=5.0)
    ] = 1.0
    carb_ratio_g_U: CarbRatio = 0.0
    meal_bolus: MealShare = 1.0

    def uses(self) -> frozenset[Need]:
        """Needs that the controller meets; announcements where meals have a bolus."""
        return super().uses() - frozenset(() if self.meal_bolus else {ANNOUNCEMENTS, AHEAD})


class LoopLikeSettings(_ByProfile, name="loop-like"):
    """Forecast and doses after LoopKit's: insulin, meals, unexplained changes, and the slope of readings."""

    sources = ("loopalgorithm",)
    design: ClassVar = "glucoloop.control.loop_like:design"

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


class BasalBolusSettings(_ByProfile, name="basal-bolus"):
    """Basal rate, and boluses for announced meals and against high glucose, by the usual formula."""

    sources = ("zisser2008",)
    design: ClassVar = "glucoloop.control.basal_bolus:design"

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


class Oref0Settings(_ByProfile, name="oref0"):
    """oref0 0.7.1 of OpenAPS: temporary basal rates and microboluses by four forecasts; research only.

    The defaults are those of oref0, but for two that allow no more than a temporary basal rate below the person's own
    until they are changed: ``max_iob_U``, which is 0 there, and ``enable_smb_always``, which is off there. Preferences
    have their names of there.
    """

    sources = ("lewis2016", "oref0")
    design: ClassVar = "glucoloop.control.oref0.controller:design"

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
