"""Situation of a controller: the patient, the sensor and the pump with their faults.

It is declared here once: the options of the commands, the keys of files, help, checks and the loop follow from it.
Where it is made, in Python, from a file or from the command line, its components are completed by the defaults of the
patient; what was given stays apart, see `component.request.Request`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.effects import (
    CHANCE,
    DEAD_TIME,
    EXERCISE,
    GLUCAGON,
    MEALS,
    MEALS_ANNOUNCED,
    READINGS,
    SUBCUTANEOUS,
    TEMPORARY_TARGETS,
    TIME_OF_DAY,
    Need,
)
from glucoloop.component.grammar import as_tree
from glucoloop.component.request import by_default, completed, read_root, request_of
from glucoloop.component.setting import PATIENT_PANEL, SENSOR_PANEL, Option
from glucoloop.control.glucagon import GlucagonComponent
from glucoloop.faults import START, FaultComponent
from glucoloop.meals.models import MealModelComponent
from glucoloop.meals.rescue import RescueComponent
from glucoloop.metrics.metric import Metric, metrics_with
from glucoloop.patients.catalogue import DEFAULT_PATIENT, PATIENTS
from glucoloop.patients.component import PatientComponent
from glucoloop.pumps import PUMPS, PumpComponent
from glucoloop.refusal import Refusal
from glucoloop.sensors import DeadTime, IdealSensor, SensorComponent, WhiteNoise, whole_samples
from glucoloop.situations.scenarios import (
    Actions,
    AnnounceBefore,
    AnnounceMeals,
    CarbBias,
    CarbError,
    Events,
    Rhythms,
    StartTime,
    WarmUp,
)
from glucoloop.situations.therapy_settings import Overrides, ProfileBy, Targets, TherapyProfile, WrongProfile
from glucoloop.situations.therapy_text import parse_change, target_change
from glucoloop.therapy import Schedule
from glucoloop.unit_guess import (
    CONFIRM_OPTION,
    LARGEST_RATE,
    LARGEST_SUBCUTANEOUS_RATE,
    MIN_RATE,
    RATE_CHANGE,
    SAMPLE_TIME,
    SETPOINT,
    refuse_unusual,
)
from glucoloop.units import LARGEST_SEED, parse_time_of_day

if TYPE_CHECKING:
    from glucoloop.meals import MealModel, RescueCarbs
    from glucoloop.patients import Patient, Population
    from glucoloop.physiology.rhythm import Rhythm
    from glucoloop.pumps import BolusLimits, DoseLimits, GlucagonLimits
    from glucoloop.therapy import Profile

SHORTEST_SAMPLE_TIME_MIN: Final = 0.1
"""Shortest sample time; with it the paper's memory of three hours stays within the largest memory."""
LONGEST_SAMPLE_TIME_MIN: Final = 120.0
_PUMP_LIMITS: Final = ("max_change_mU_min", "min_insulin_mU_min", "max_insulin_mU_min")
_patient = functools.partial(Option, panel=PATIENT_PANEL)
_sensor = functools.partial(Option, panel=SENSOR_PANEL)

Glucagon = Annotated[
    GlucagonComponent | None,
    _patient(
        "Glucagon by a second route of the pump, where the patient has it, like threshold or 'mini-dose, dose_ug=100'.",
        alone="threshold",
        rare=True,
    ),
]


class Situation(Component):
    """Everything about a loop but its meals and its controllers.

    Parameters are components, see `glucoloop list`, and numbers; the others are defaults of the patient.

    Raises
    ------
    Refusal
        For components and numbers that are not possible, or at odds with one another.
    """

    kind: ClassVar = "situation"

    patient: Annotated[
        PatientComponent,
        _patient("Patient; pump, model and tuning are by default those of the patient.", default=DEFAULT_PATIENT.name),
    ] = by_default(DEFAULT_PATIENT)
    setpoint_mg_dl: Annotated[
        float | None,
        _patient(
            "Target of the controller; the patient's own by default.", above=0.0, at_most=2000.0, quantity=SETPOINT
        ),
    ] = None
    profile_by: ProfileBy = "table"
    profile_error: WrongProfile = None
    therapy: TherapyProfile = ()
    targets: Targets = ()
    overrides: Overrides = ()
    meal_model: Annotated[
        MealModelComponent | None,
        _patient(
            "Digestion of the patient: lehmann-deutsch or hovorka; the controller's does not change.",
            default="the patient's own",
            rare=True,
            needs=(MEALS,),
        ),
    ] = None
    announce_meals: AnnounceMeals = False
    announce_before_min: AnnounceBefore = 0.0
    rescue: Annotated[
        RescueComponent | None,
        _patient(
            "Fast carbohydrate that the person eats when glucose is low, like 'below_mg_dl=65, carbs_g=20'.",
            alone="carbs",
            rare=True,
        ),
    ] = None
    glucagon: Glucagon = None
    carb_error_pct: CarbError = 0.0
    carb_bias_pct: CarbBias = 0.0
    start: StartTime = None
    rhythm: Rhythms = ()
    actions: Actions = ()
    events: Events = ()
    sensor: Annotated[
        tuple[SensorComponent, ...],
        _sensor(
            "Sensor, like dexcom-g6 or 'lag, lag_min=8', see glucoloop list; repeat it, from the innermost outwards.",
            default="ideal",
        ),
    ] = ()
    pump: Annotated[
        PumpComponent,
        _sensor(
            "Pump: limited, resolution or expiring, with its limits; by default those of the patient.",
            default=PUMPS.default,
        ),
    ] = by_default(PUMPS[PUMPS.default])
    faults: Annotated[
        tuple[FaultComponent, ...],
        _sensor(
            "Fault of sensor or pump, like 'missing, start_min=120'; repeat it, each around the earlier ones.",
            flag="--fault",
        ),
    ] = ()
    warm_up_min: WarmUp = 0.0
    metrics: Annotated[
        tuple[Metric, ...],
        Option("Metric beside the default ones, like sensor-accuracy; repeat it for more.", flag="--metric", rare=True),
    ] = ()
    sample_time_min: Annotated[
        float,
        Option(
            "Time between two readings, and between two doses.",
            at_least=SHORTEST_SAMPLE_TIME_MIN,
            at_most=LONGEST_SAMPLE_TIME_MIN,
            quantity=SAMPLE_TIME,
        ),
    ] = 5.0
    seed: Annotated[
        int, Option("The same seed gives the same noise.", at_least=0, at_most=LARGEST_SEED, needs=(CHANCE,))
    ] = 0
    allow_unusual: Annotated[bool, Option("Accept values that look like another unit or are implausible.")] = False

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with the patient at an operating point, and the pump with the limits that suit the patient."""
        patient, pump = request_of(values["patient"]), request_of(values["pump"])
        at_rest = completed(patient, {"operating_point": patient.component.default_operating_point})
        limits = {name: getattr(at_rest, name) for name in _PUMP_LIMITS}
        limited = completed(pump, {**limits, **pump.component.own_limits})
        return super().resolved({**values, "patient": at_rest, "pump": limited})

    def __post_init__(self) -> None:
        from glucoloop.meals import meal_model_of
        from glucoloop.patients.capabilities import refuse_glucagon, sites
        from glucoloop.simulation.minute_inputs import PeopleMinuteInputs, refuse_minute_inputs
        from glucoloop.simulation.plant import SampleGrid

        if self.schedule.by_clock and self.start is None:
            raise Refusal(
                "a therapy by the time of day needs the time of day at the start",
                "give it, like --start 06:00 (start in a file)",
                "leave profile, target and override out",
            )
        list(metrics_with(self.metrics))  # refuses one that is at odds with another
        if self.miscounts and not self.announce_meals:
            raise Refusal(
                "an error of counting carbohydrate concerns announced meals only",
                "announce the meals (--announce-meals)",
                "leave the error and the bias out",
            )
        if self.announce_before_min and not self.announce_meals:
            raise Refusal(
                f"meals that are not announced cannot be announced {self.announce_before_min:g} min before eating",
                "announce the meals (--announce-meals)",
                "leave the time out",
            )
        if self.profile_by == "titration" and not self.patient.subcutaneous:
            raise Refusal(
                f"{self.patient.display_name} gets intravenous insulin, where a bolus acts for minutes and no "
                "carbohydrate ratio is right; leave profile_by out, or choose a patient with subcutaneous insulin"
            )
        meal_model_of(self.nominal, self.gut)
        refuse_minute_inputs(
            self.nominal,
            PeopleMinuteInputs(SampleGrid(1.0, 1), None, self.rhythms, 0, [0]).of(slice(1)),
            self.patient.display_name,
        )
        if self.glucagon is not None:
            refuse_glucagon(self.nominal, self.patient.display_name)
        known = sites(self.nominal)
        if self.site is not None and self.site not in known:
            raise Refusal(
                f"glucose of {self.patient.display_name} cannot be read at the site {self.site!r}; "
                f"give {' or '.join(known)}"
            )
        if any(isinstance(component, IdealSensor) for component in self.sensor[1:]):
            raise Refusal("an ideal sensor is the innermost of a chain; give it first, or leave it out")
        _ = self.dead_time_samples, self.start_min, self.limits, self.bolus  # each refuses what is not possible

    def uses(self) -> frozenset[Need]:
        """Needs that the situation meets; a class that knows its meals, its controllers and its chance says less."""
        clock = {TIME_OF_DAY} if self.rhythm or self.schedule.by_clock else set()
        late = {DEAD_TIME} if self.dead_time_min else set()
        announced = {MEALS_ANNOUNCED} if self.announce_meals or "announce_meals" in self.refused else set()
        temporary = {TEMPORARY_TARGETS} if any(change.temporary for change in self.schedule.changes) else set()
        dual = set() if self.glucagon is None else {GLUCAGON}
        route = {SUBCUTANEOUS} if self.patient.subcutaneous else set()
        of_all = {MEALS, EXERCISE, CHANCE, READINGS} | route
        return self.patient.uses() | of_all | clock | late | announced | temporary | dual

    @property
    def by_chance(self) -> bool:
        """Whether anything of the situation may be drawn at random."""
        plain = type(self.pump) is PUMPS[PUMPS.default]
        return self.noisy or self.drawn_otherwise or bool(self.rhythm) or self.patient.person is not None or not plain

    def refuse_unusual_pump(self) -> None:
        """Refuse a pump in another unit, or one that cannot deliver the rate at which the patient rests.

        A target above the patient's own needs less insulin than that, so that a smaller pump is enough.
        """
        limits, person = self.limits, self.nominal
        most_mU_min, least_mU_min = float(limits.max_mU_min), float(limits.min_mU_min)
        basal, resting = float(person.basal_insulin_mU_min), float(person.setpoint_mg_dl)
        largest, least = LARGEST_SUBCUTANEOUS_RATE if self.patient.subcutaneous else LARGEST_RATE, MIN_RATE
        rest = f"{basal:.1f} mU/min to rest at {resting:.1f} mg/dl"
        if self.setpoint_mg_dl is None or self.setpoint_mg_dl <= resting:
            if most_mU_min < basal:
                largest = largest.within(least=basal, reason=f"the patient needs {rest}")
            if basal < least_mU_min < most_mU_min:
                least = least.within(most=basal, reason=f"the patient needs only {rest}")
        refuse_unusual(most_mU_min, largest, "max_insulin_mU_min of the pump", CONFIRM_OPTION)
        refuse_unusual(least_mU_min, least, "min_insulin_mU_min of the pump", CONFIRM_OPTION)
        refuse_unusual(float(limits.max_change_mU_min), RATE_CHANGE, "max_change_mU_min of the pump", CONFIRM_OPTION)

    def refuse_late_faults(self, duration_min: float) -> None:
        """Refuse a fault that begins after the end of a run."""
        for fault in (*self.events, *self.faults):
            start_min = float(fault.values().get(START, 0.0))
            if start_min >= duration_min:
                raise Refusal(
                    f"the fault {fault.name} begins at {start_min:g} min, but the run ends at {duration_min:g} min; "
                    "let it begin earlier, or leave it out"
                )

    @property
    def fault_texts(self) -> tuple[str, ...]:
        """Faults, each as its text."""
        return tuple(fault.text for fault in self.faults)

    @property
    def further_metrics(self) -> tuple[str, ...]:
        """Metrics beside the default ones, each as its text."""
        texts = tuple(metric.text for metric in self.metrics)
        return texts if self.glucagon is None or "glucagon" in texts else (*texts, "glucagon")

    @property
    def place(self) -> str:
        """The operating point, with the patient's name where it is another than the default one."""
        return self.patient.place

    @property
    def start_min(self) -> float | None:
        """Time of day at the start, in minutes after midnight; None if controllers are not told."""
        return None if self.start is None else parse_time_of_day(self.start)

    @property
    def miscounts(self) -> bool:
        """Whether the announced carbohydrate differs from the true one."""
        return self.carb_error_pct != 0.0 or self.carb_bias_pct != 0.0

    @property
    def _noise(self) -> Iterator[WhiteNoise]:
        return (component for component in self.sensor if isinstance(component, WhiteNoise))

    @property
    def noise_variance(self) -> float:
        """Variance of the white noise of the readings, of which designs are told."""
        return sum(component.variance for component in self._noise)

    @property
    def noise_bound_mg_dl(self) -> float:
        """Largest deviation by that noise."""
        return max((component.bound_mg_dl for component in self._noise), default=WhiteNoise().bound_mg_dl)

    @property
    def noisy(self) -> bool:
        """Whether readings carry white noise."""
        return self.noise_variance > 0.0

    @property
    def drawn_otherwise(self) -> bool:
        """Whether something else than white noise may be drawn: another noise of the sensor, or a fault."""
        plain = (IdealSensor, WhiteNoise, DeadTime)
        return bool(self.events or self.faults) or not all(isinstance(component, plain) for component in self.sensor)

    @property
    def dead_time_min(self) -> float:
        """Dead time of the readings."""
        return sum(component.minutes for component in self.sensor if isinstance(component, DeadTime))

    @property
    def dead_time_samples(self) -> int:
        """Dead time of the readings in samples."""
        components = (component for component in self.sensor if isinstance(component, DeadTime))
        return sum(whole_samples(component.minutes, self.sample_time_min, "a dead time") for component in components)

    @property
    def site(self) -> str | None:
        """Site of the sensor; None for that at which glucose is controlled."""
        return next((component.site for component in self.sensor if isinstance(component, IdealSensor)), None)

    def record_sensor(self, noise_variance: float) -> tuple[SensorComponent, ...]:
        """Sensor of a record from which a model is identified, with other white noise."""
        inner = [sensor for sensor in (component.recorded() for component in self.sensor) if sensor is not None]
        noise = WhiteNoise(variance=noise_variance, bound_mg_dl=self.noise_bound_mg_dl)
        return (*inner, noise) if noise_variance > 0.0 else tuple(inner)

    def without_noise(self) -> Situation:
        """The situation alone, without white noise of the readings."""
        return Situation.narrowed(
            self, sensor=tuple(component for component in self.sensor if not isinstance(component, WhiteNoise))
        )

    def paced(self, every_min: float | None, *, known_dead_time: bool) -> Situation:
        """The situation as a controller meets it that acts at times of its own; itself where there is no such time.

        The dead time is left out unless the controller knows it: otherwise it need not be a whole number of its times.
        """
        if every_min is None or every_min == self.sample_time_min:
            return self
        known_sensors = tuple(
            component for component in self.sensor if known_dead_time or not isinstance(component, DeadTime)
        )
        return Situation.narrowed(self, sample_time_min=every_min, sensor=known_sensors)

    @property
    def schedule(self) -> Schedule:
        """Therapy by the time of day, of which targets act on the profile, and overrides on both."""
        profile = (*map(parse_change, self.therapy), *map(target_change, self.targets))
        return Schedule((*profile, *(change for override in self.overrides for change in override.changes())))

    def of_controller(self) -> Situation:
        """The situation without what is put around a controller: actions of the person, and a therapy by the clock."""
        return Situation.narrowed(self, actions=(), glucagon=None, therapy=(), targets=(), overrides=())

    @property
    def nominal(self) -> Patient:
        """The nominal patient at the operating point, or the one person of the situation."""
        return self._alone[0]

    @property
    def profile(self) -> Profile:
        """Profile of the nominal patient, or of the one person of the situation."""
        return self._alone[1]

    @functools.cached_property
    def one_person(self) -> Population | None:
        """Population of nobody but the one person of the situation; None for a situation of the nominal patient."""
        return one_person_of(self.patient, self.seed)

    @functools.cached_property
    def _alone(self) -> tuple[Patient, Profile]:
        return alone_at_rest(self.patient, self.one_person)

    @property
    def gut(self) -> MealModel | None:
        """Meal model that replaces the patient's own; None if the patient's own is used."""
        return None if self.meal_model is None else self.meal_model.made()

    @property
    def rescue_carbs(self) -> RescueCarbs | None:
        """Carbohydrate that the person eats when glucose is low, as a scenario takes it."""
        return None if self.rescue is None else self.rescue.made()

    @property
    def glucagon_limits(self) -> GlucagonLimits | None:
        """Limits of the second route of the pump; None where no glucagon is given."""
        from glucoloop.pumps import GlucagonLimits

        pump = self.pump
        if self.glucagon is None:
            return None
        return GlucagonLimits(max_ug=pump.max_glucagon_ug, step_ug=pump.glucagon_step_ug)

    @property
    def rhythms(self) -> tuple[Rhythm, ...]:
        """Rhythms of the patient, as a scenario takes them."""
        return self.rhythm

    @property
    def target_mg_dl(self) -> float:
        """The setpoint, or glucose at the operating point."""
        return float(self.nominal.setpoint_mg_dl) if self.setpoint_mg_dl is None else self.setpoint_mg_dl

    @property
    def limits(self) -> DoseLimits:
        """Limits of the pump; Refusal if the bounds are not possible."""
        from glucoloop.pumps import dose_limits

        pump: Any = self.pump
        return dose_limits(
            max_change_mU_min=pump.max_change_mU_min,
            min_mU_min=pump.min_insulin_mU_min,
            max_mU_min=pump.max_insulin_mU_min,
            allow_unusual=True,  # which is asked about with the patient
        )

    @property
    def bolus(self) -> BolusLimits:
        """Limits of a bolus of the pump; Refusal if the bounds are not possible."""
        from glucoloop.pumps import bolus_limits

        pump = self.pump
        return bolus_limits(max_U=pump.max_bolus_U, min_U=pump.min_bolus_U, step_U=pump.bolus_step_U)


def alone_at_rest(patient: PatientComponent, one_person: Population | None) -> tuple[Patient, Profile]:
    """The one person at the glucose of the operating point, or the nominal patient; with the profile."""
    from glucoloop.patients.population import alone, nominal_profile

    nominal = _nominal(patient.display_name, patient.rests_at)
    if one_person is None:
        return nominal, nominal_profile(patient.display_name, nominal)
    return alone(one_person, float(nominal.setpoint_mg_dl))


def one_person_of(patient: PatientComponent, seed: int) -> Population | None:
    """Population of nobody but the one person that a patient is; None for the nominal patient."""
    from glucoloop.situations.population import person_of

    return None if patient.person is None else person_of(patient.person, patient.display_name, seed)


@functools.cache
def _nominal(name: str, operating_point: str) -> Patient:
    from glucoloop.patients import patient

    return patient(name, operating_point)


def configured(root: type[Any], keys: Mapping[str, Any] | None = None, where: str = "", **more: Any) -> Any:
    """A situation, or what extends one, from plain values as a file has them: ``configured(Run, sensor=["lag"])``."""
    return completed(read_root(root, as_tree({**(keys or {}), **more}, where), allow_unusual=True))


def default_situation(patient: str = DEFAULT_PATIENT.name, operating_point: str | None = None) -> Situation:
    """A patient at an operating point, the default one by default, with the default pump and noise-free readings."""
    return Situation(patient=PATIENTS.find(patient)(operating_point=operating_point))
