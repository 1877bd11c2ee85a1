"""Configuration of a run: the situation of a controller, and the controller with its tuning and model.

In files and on the command line both are given by flat keys; what is not given is filled in here, so that a
configuration that was read is complete.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from glucoloop.config.clock_text import parse_time_of_day
from glucoloop.config.meal_text import meal_text, parse_meal
from glucoloop.config.sentences import one_sentence
from glucoloop.config.unusual import (
    Names,
    ask_about,
    ask_about_clock,
    ask_about_meals,
    ask_about_pump,
    ask_about_settings,
)
from glucoloop.experiments.case import Case
from glucoloop.experiments.situation import Situation
from glucoloop.meals import Meal, Scenario, meal_model_of
from glucoloop.meals.counting import counted_meals
from glucoloop.patients import patient
from glucoloop.patients.capabilities import sites
from glucoloop.plausible import (
    DEAD_TIME,
    DURATION,
    GLUCOSE,
    LARGEST_RATE,
    LEAST_RATE,
    NOISE_BOUND,
    NOISE_VARIANCE,
    RATE_CHANGE,
    RATE_STEP,
    SAMPLE_TIME,
    SETPOINT,
)
from glucoloop.registry import controllers as catalogue
from glucoloop.registry.fault_text import fault_text, parse_fault
from glucoloop.registry.faults import START
from glucoloop.registry.guard import GUARD, complete_guard
from glucoloop.registry.patients import USUAL_PATIENT, PatientEntry, patient_entry
from glucoloop.registry.settings import Value, refuse_unknown_keys

STRICT: Final = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
LONGEST_RUN_MIN: Final = 366 * 1440.0
LARGEST_SEED: Final = 2**32 - 1
SHORTEST_SAMPLE_TIME_MIN: Final = 0.1
"""Shortest sample time; with it the paper's memory of three hours stays within the largest memory."""
LONGEST_SAMPLE_TIME_MIN: Final = 120.0
PAPER_SAMPLE_TIME_MIN: Final = 5.0
_OF_PATIENT: Final = ("operating_point", "max_change_mU_min", "min_insulin_mU_min", "max_insulin_mU_min")
"""Keys whose usual values are the patient's."""
IDENTIFICATION_KEYS: Final = ("model_noise_variance", "memory", "laguerre_pole", "laguerre_functions")
"""Keys of the identification of a model for the run; `model`, which names a file, replaces them."""

Record = TypeVar("Record", bound=BaseModel)
Setpoint = Annotated[float, Field(gt=0.0, le=2000.0), SETPOINT]
Glucose = Annotated[float, Field(gt=0.0, le=2000.0), GLUCOSE]
LeastRate = Annotated[float, Field(ge=0.0, le=10_000.0), LEAST_RATE]
LargestRate = Annotated[float, Field(gt=0.0, le=10_000.0), LARGEST_RATE]
RateChange = Annotated[float, Field(gt=0.0, le=10_000.0), RATE_CHANGE]
RateStep = Annotated[float, Field(gt=0.0, le=10_000.0), RATE_STEP]
DeadTime = Annotated[float, Field(ge=0.0, le=1440.0), DEAD_TIME]
Duration = Annotated[float, Field(gt=0.0, le=LONGEST_RUN_MIN), DURATION]
SampleTime = Annotated[float, Field(ge=SHORTEST_SAMPLE_TIME_MIN, le=LONGEST_SAMPLE_TIME_MIN), SAMPLE_TIME]
Variance = Annotated[float, Field(ge=0.0, le=10_000.0), NOISE_VARIANCE]
NoiseBound = Annotated[float, Field(gt=0.0, le=1000.0), NOISE_BOUND]
Seed = Annotated[int, Field(ge=0, le=LARGEST_SEED)]
Memory = Annotated[int, Field(ge=2, le=2000)]
Pole = Annotated[float, Field(gt=0.0, lt=1.0)]
Functions = Annotated[int, Field(ge=0, le=50)]


def place_of(patient: str, operating_point: str) -> str:
    """Short name of the operating point, after the name of the patient unless it is the usual one."""
    return operating_point if patient == USUAL_PATIENT.name else f"{patient}, {operating_point}"


class SurroundingKeys(BaseModel):
    """Patient, meals, sensor and pump, without the controller."""

    model_config = STRICT

    patient: str = USUAL_PATIENT.name
    operating_point: str = USUAL_PATIENT.usual_point
    setpoint_mg_dl: Setpoint | None = None
    """Target of the controller, or None for the patient's own."""
    initial_glucose_mg_dl: Glucose | None = None
    """Glucose at which the patient rests at the start, or None for the setpoint."""
    meals: tuple[str, ...] = ("50g@50min",)
    meal_model: str | None = None
    """Name of the model of digestion and absorption, or None for the patient's own."""
    duration_min: Duration = 600.0
    sample_time_min: SampleTime = PAPER_SAMPLE_TIME_MIN
    noise_variance: Variance = 0.0
    dead_time_min: DeadTime = 0.0
    max_change_mU_min: RateChange = USUAL_PATIENT.max_change_mU_min
    min_insulin_mU_min: LeastRate = USUAL_PATIENT.min_insulin_mU_min
    max_insulin_mU_min: LargestRate = USUAL_PATIENT.max_insulin_mU_min
    allow_unusual: bool = False
    """Whether unusual values are accepted."""

    @property
    def place(self) -> str:
        """The operating point, with the patient's name where it is another than the usual one."""
        return place_of(self.patient, self.operating_point)

    def eaten(self) -> tuple[Meal, ...]:
        """Meals of the run."""
        return tuple(parse_meal(text) for text in self.meals)

    def scenario(self, *, announced: bool = False) -> Scenario:
        """Meals, length, target and start.

        Raises
        ------
        ValueError
            For meals or a length that are not possible.
        """
        return Scenario(
            self.eaten(),
            self.duration_min,
            setpoint_mg_dl=self.setpoint_mg_dl,
            initial_glucose_mg_dl=self.initial_glucose_mg_dl,
            allow_unusual=self.allow_unusual,
            announced=announced,
            meal_model=self.meal_model,
        )

    def surroundings(self) -> Situation:
        """The patient, and the limits of the pump."""
        own = ("patient", "operating_point", "setpoint_mg_dl", "meal_model", "noise_variance", "sample_time_min")
        limits = ("max_change_mU_min", "min_insulin_mU_min", "max_insulin_mU_min")
        return Situation(**{key: getattr(self, key) for key in (*own, *limits)})


class SituationKeys(SurroundingKeys):
    """Keys that all controllers of a comparison share."""

    announce_meals: bool = False
    carb_error_pct: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Standard deviation of the announced carbohydrate of a meal, in percent of the true one."""
    carb_bias_pct: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    """Mean error of the announced carbohydrate, in percent."""
    start: str | None = None
    """Time of day at the start, like 07:00, or None if the controller does not get it."""
    noise_bound_mg_dl: NoiseBound = 5.0
    site: str | None = None
    """Site of the sensor, or None for the site at which glucose is controlled."""
    pump_resolution_mU_min: RateStep | None = None
    """Smallest step of the pump, or None for a pump that delivers any rate."""
    faults: tuple[str, ...] = ()
    """Faults of sensor and pump, the first innermost; they wrap noise and dead time."""
    integrator: Literal["fast", "adaptive"] = "fast"
    seed: Seed = 0

    @property
    def noisy(self) -> bool:
        """Whether readings carry noise."""
        return self.noise_variance > 0.0

    @property
    def dead_time_samples(self) -> int:
        """Dead time of the readings.

        Raises
        ------
        ValueError
            Unless it is a whole number of samples.
        """
        return whole_samples(self.dead_time_min, self.sample_time_min)

    def eaten(self) -> tuple[Meal, ...]:
        """Meals of the run, with the announced carbohydrate of each where it is counted with an error."""
        meals, errs = super().eaten(), self.carb_error_pct != 0.0 or self.carb_bias_pct != 0.0
        if not errs:
            return meals
        return counted_meals(meals, self.seed, error_pct=self.carb_error_pct, bias_pct=self.carb_bias_pct)

    @property
    def start_min(self) -> float | None:
        """Time of day at the start, in minutes after midnight.

        Raises
        ------
        ValueError
            For a text that is not a time of day.
        """
        return None if self.start is None else parse_time_of_day(self.start)

    def scenario(self, *, announced: bool = False) -> Scenario:
        """Meals, length, target, start and time of day.

        Raises
        ------
        ValueError
            For meals, a length or a time of day that are not possible.
        """
        return dataclasses.replace(super().scenario(announced=announced), start_min=self.start_min)

    def situation(self) -> Situation:
        """Situation of an experiment from these keys.

        Raises
        ------
        ValueError
            Unless the dead time is a whole number of samples.
        """
        return dataclasses.replace(
            self.surroundings(),
            announced=self.announce_meals,
            carb_error_pct=self.carb_error_pct,
            carb_bias_pct=self.carb_bias_pct,
            start_min=self.start_min,
            noise_bound_mg_dl=self.noise_bound_mg_dl,
            dead_time_samples=self.dead_time_samples,
            site=self.site,
            pump_resolution_mU_min=self.pump_resolution_mU_min,
            faults=self.faults,
            seed=self.seed,
        )


class CaseKeys(BaseModel):
    """A controller, its tuning, and the model it is designed on."""

    model_config = STRICT

    controller: str = "mpc"
    tuning: Mapping[str, Value] = Field(default_factory=dict)
    known_dead_time: bool = False
    guard: bool = False
    guard_limits: Mapping[str, Value] = Field(default_factory=dict)
    """Limits of the guard; empty without a guard."""
    model: str | None = None
    """Path of a model file, or None to identify a model from the patient."""
    model_noise_variance: Variance | None = None
    """Noise of the record that the model is identified from."""
    memory: Memory | None = None
    laguerre_pole: Pole | None = None
    laguerre_functions: Functions | None = None
    """Number of Laguerre functions; 0 leaves the impulse response as it was estimated."""

    def case(self, label: str | None = None) -> Case:
        """Case of an experiment; its controller's name is its label unless another one is given."""
        return Case(
            label=self.controller if label is None else label,
            controller=self.controller,
            tuning=dict(self.tuning),
            known_dead_time=self.known_dead_time,
            guard=dict(self.guard_limits) if self.guard else None,
            **{key: getattr(self, key) for key in IDENTIFICATION_KEYS},
        )


@dataclass(frozen=True)
class Run:
    """A controller in its situation."""

    situation: SituationKeys
    case: CaseKeys

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same run is read."""
        return {**self.situation.model_dump(mode="json"), **case_keys(self.case)}

    def with_model(self, path: str) -> Self:
        """The same run, with its model from another file."""
        return type(self)(situation=self.situation, case=self.case.model_copy(update={"model": path}))


def case_keys(case: CaseKeys) -> dict[str, Any]:
    """Flat keys of a case; those of its tuning stand among the others."""
    keys = case.model_dump(mode="json")
    limits = keys.pop("guard_limits")
    return {"controller": keys.pop("controller"), **keys.pop("tuning"), **keys, **limits}


def read_run(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Run:
    """Read the configuration of a run from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For an unknown key, or a value of the wrong type or out of bounds.
    """
    refuse_unknown(keys)
    situation = checked(SituationKeys, only(of_patient(keys), SituationKeys), names)
    if not situation.allow_unusual:
        ask_about_surroundings(situation, situation.eaten(), names)
        ask_about_clock(situation.meals, situation.duration_min)
    refuse_impossible(situation)
    whole_samples(situation.dead_time_min, situation.sample_time_min)
    faults = faults_told(situation.faults, situation.duration_min, allow_unusual=situation.allow_unusual)
    meals = tuple(meal_text(meal) for meal in situation.eaten())
    situation = situation.model_copy(update={"meals": meals, "faults": faults})
    return Run(situation=situation, case=read_case(keys, situation, names))


def of_patient(keys: Mapping[str, object]) -> dict[str, object]:
    """Flat keys completed with those that are usual for the patient.

    Raises
    ------
    ValueError
        For an unknown patient or operating point.
    """
    entry = patient_of(keys)
    told = keys.get("operating_point")
    if isinstance(told, str):
        entry.operating_point(told)
    usual = {key: getattr(entry, key) for key in _OF_PATIENT if key != "operating_point"}
    return {"operating_point": entry.usual_point, **usual, **keys}


def patient_of(keys: Mapping[str, object]) -> PatientEntry:
    """The patient that flat keys name; a value that is not a text is refused later with the other keys."""
    name = keys.get("patient", USUAL_PATIENT.name)
    return patient_entry(name) if isinstance(name, str) else USUAL_PATIENT


def refuse_impossible(situation: SituationKeys) -> None:
    """Refuse a site at which glucose of the patient cannot be read, and a meal model that is not known.

    Raises
    ------
    ValueError
        For either.
    """
    miscounted = situation.carb_error_pct != 0.0 or situation.carb_bias_pct != 0.0
    if miscounted and not situation.announce_meals:
        raise ValueError(
            "an error of counting carbohydrate concerns announced meals only; announce the meals (--announce-meals), "
            "or leave the error and the bias out"
        )
    meal_model_of(patient(situation.patient, situation.operating_point), situation.situation().gut)
    known = sites(patient(situation.patient, situation.operating_point))
    if situation.site is not None and situation.site not in known:
        raise ValueError(
            f"glucose of {situation.patient} cannot be read at the site {situation.site!r}; give {' or '.join(known)}"
        )


def ask_about_surroundings(situation: SurroundingKeys, meals: Iterable[Meal], names: Names = None) -> None:
    """Ask for confirmation of unusual values.

    Raises
    ------
    ValueError
        For the first value outside its plausible range.
    """
    ask_about_pump(
        patient(situation.patient, situation.operating_point),
        situation.setpoint_mg_dl,
        min_insulin_mU_min=situation.min_insulin_mU_min,
        max_insulin_mU_min=situation.max_insulin_mU_min,
        names=names,
    )
    ask_about(situation, names)
    ask_about_meals(meals)


def read_case(keys: Mapping[str, object], situation: SituationKeys, names: Mapping[str, str] | None = None) -> CaseKeys:
    """Read a case from flat keys, completed for its situation."""
    own = only(keys, CaseKeys)
    controller = str(own.get("controller", "mpc"))
    _refuse_reserved(catalogue.controller_entry(controller))
    known = catalogue.setting_names(controller)
    settings = {key: value for key, value in keys.items() if key in known}
    entry = patient_entry(situation.patient)
    tuning = catalogue.complete(controller, settings, entry, situation.operating_point, noisy=situation.noisy)
    if catalogue.controller_entry(controller).uses_model and own.get("model") is None:
        own = {**_identification(situation), **own}
    guard = _guard_limits(keys, bool(own.get("guard", False)), names)
    case = checked(CaseKeys, {**own, "tuning": tuning, "guard_limits": guard}, names)
    if not situation.allow_unusual:
        ask_about(case, names)
        ask_about_settings((*catalogue.controller_entry(case.controller).settings, *GUARD.values()), keys, names)
    return case


def _refuse_reserved(entry: catalogue.ControllerEntry) -> None:
    """Refuse a controller of another package with a setting whose key means something else."""
    reserved = {*SituationKeys.model_fields, *CaseKeys.model_fields, *GUARD, "label"}
    for setting in entry.settings:
        if setting.name in reserved:
            raise ValueError(
                f"the controller {entry.name} has a setting {setting.name!r}, which is a key of every run already; "
                "its author has to give it another name"
            )


def _guard_limits(keys: Mapping[str, object], guarded: bool, names: Mapping[str, str] | None) -> dict[str, Value]:
    refuse_limits_without_guard(keys, guarded=guarded, names=names)
    return complete_guard({key: value for key, value in keys.items() if key in GUARD}) if guarded else {}


def refuse_limits_without_guard(keys: Mapping[str, object], *, guarded: bool, names: Names = None) -> None:
    """Refuse a limit of a guard that is off.

    Raises
    ------
    ValueError
        For the first one.
    """
    for key in keys:
        if key in GUARD and not guarded:
            raise ValueError(
                f"{(names or {}).get(key, key)} is a limit of the guard, which is off; switch it on, or leave it out"
            )


def faults_told(texts: Iterable[str], duration_min: float, *, allow_unusual: bool = False) -> tuple[str, ...]:
    """Faults with all their settings.

    Raises
    ------
    ValueError
        For a text that is no fault, one that begins after the end of the run, or an unusual setting,
        unless that is allowed.
    """
    faults = [parse_fault(text) for text in texts]
    for told in faults:
        if not allow_unusual:
            called = {setting.name: f"{setting.name} of the fault {told.name}" for setting in told.entry.settings}
            ask_about_settings(told.entry.settings, told.settings, called)
        start_min = float(told.settings.get(START, 0.0))
        if start_min >= duration_min:
            raise ValueError(
                f"the fault {told.name} begins at {start_min:g} min, but the run ends at {duration_min:g} min; "
                "let it begin earlier, or leave it out"
            )
    return tuple(fault_text(told) for told in faults)


def _identification(situation: SituationKeys) -> dict[str, object]:
    """The identification that is usual for the patient, from a record as noisy as the run."""
    usual = patient_entry(situation.patient).identification(situation.sample_time_min)
    return {"model_noise_variance": situation.noise_variance, **usual}


def overlay(
    lower: Mapping[str, object], upper: Mapping[str, object], names: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Merge flat keys of two layers, of which the upper one wins.

    Each upper key removes those below that it excludes: a model file and the keys that identify a model, and the
    settings of a controller that another one replaces.

    Raises
    ------
    ValueError
        If one layer holds keys that exclude one another.
    """
    for layer in (lower, upper):
        both = [key for key in IDENTIFICATION_KEYS if key in layer]
        if "model" in layer and both:
            called = (names or {}).get(both[0], both[0])
            raise ValueError(
                f"{called} tells how a model is identified, but the model comes from {layer['model']}; "
                "leave out one of them"
            )
    kept = dict(lower)
    if "model" in upper:
        kept = {key: value for key, value in kept.items() if key not in IDENTIFICATION_KEYS}
    elif any(key in upper for key in IDENTIFICATION_KEYS):
        kept.pop("model", None)
    if "controller" in upper:
        entry = catalogue.controller_entry(str(upper["controller"]))
        own = {setting.name for setting in entry.settings}
        foreign = catalogue.setting_names(*controllers_of(lower)) - own
        kept = {key: value for key, value in kept.items() if key not in foreign}
    if "patient" in upper and upper["patient"] != lower.get("patient", USUAL_PATIENT.name):
        kept = _without_usual(kept)
    if upper.get("guard") is False:
        kept = {key: value for key, value in kept.items() if key not in GUARD}
    return {**kept, **upper}


def _without_usual(lower: Mapping[str, object]) -> dict[str, object]:
    """Keys without those that were usual for their patient, since another patient has its own."""
    entry = patient_of(lower)
    usual: dict[str, object] = {key: getattr(entry, key) for key in _OF_PATIENT if key != "operating_point"}
    sample_time = lower.get("sample_time_min", PAPER_SAMPLE_TIME_MIN)
    if isinstance(sample_time, int | float) and sample_time > 0.0:
        usual |= entry.identification(float(sample_time))
    point, controller = lower.get("operating_point", entry.usual_point), lower.get("controller", "mpc")
    noisy = bool(lower.get("noise_variance"))
    usual |= catalogue.complete(str(controller), {}, entry, str(point), noisy=noisy)
    return {
        key: value
        for key, value in lower.items()
        if key not in ("patient", "operating_point") and not (key in usual and usual[key] == value)
    }


def controllers_of(keys: Mapping[str, object], cases: Iterable[Mapping[str, object]] = ()) -> list[str]:
    """Controllers that flat keys name, directly or in cases.

    Raises
    ------
    ValueError
        For an unknown one, with the label of its case.
    """
    named = []
    for table in (keys, *cases):
        name, label = table.get("controller"), table.get("label")
        if not isinstance(name, str):
            continue
        try:
            catalogue.controller_entry(name)
        except ValueError as error:
            raise ValueError(f"case {label!r}: {error}" if isinstance(label, str) else str(error)) from None
        named.append(name)
    return named


def refuse_unknown(keys: Mapping[str, object], cases: Iterable[Mapping[str, object]] = ()) -> None:
    """Refuse a key that belongs neither to a situation, a case nor a controller of this package or of the cases."""
    known = run_keys(*controllers_of(keys, cases))
    refuse_unknown_keys(keys, known)


def run_keys(*controllers: str) -> list[str]:
    """All flat keys of a run, with the settings of controllers of other packages that are named."""
    return [*SituationKeys.model_fields, *case_key_names(*controllers)]


def case_key_names(*controllers: str) -> list[str]:
    """All flat keys that a case of a comparison may set, with the settings of named controllers of other packages."""
    own = [key for key in CaseKeys.model_fields if key not in ("tuning", "guard_limits")]
    return [*own, *sorted(catalogue.setting_names(*controllers)), *GUARD]


def whole_samples(minutes: float, sample_time_min: float, what: str = "a dead time") -> int:
    """Minutes as a number of samples; `what` names the quantity in messages.

    Raises
    ------
    ValueError
        Unless they are a whole number of samples.
    """
    samples = round(minutes / sample_time_min)
    if abs(samples * sample_time_min - minutes) > 1e-9 * max(minutes, sample_time_min):
        below = int(minutes / sample_time_min) * sample_time_min
        raise ValueError(
            f"{what} of {minutes:g} min is not a whole number of {sample_time_min:g}-min samples; "
            f"give {below:g} or {below + sample_time_min:g} min"
        )
    return samples


def checked(record: type[Record], keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Record:
    """Build a record from its keys, or refuse them in one sentence."""
    try:
        return record.model_validate({key: tuple(v) if isinstance(v, list) else v for key, v in keys.items()})
    except ValidationError as error:
        raise ValueError(one_sentence(error, record, names)) from None


def only(keys: Mapping[str, object], record: type[BaseModel]) -> dict[str, object]:
    """Keys of a record among others."""
    return {key: value for key, value in keys.items() if key in record.model_fields}
