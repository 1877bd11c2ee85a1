"""A run: the situation a controller is put in, and the controller with its tuning and its model.

In files and on the command line both are given by flat keys; what is not given is filled in here, so that a
configuration that was read is complete.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

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
from glucoloop.meals import Meal
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
from glucoloop.trials import catalogue
from glucoloop.trials.fault_text import fault_text, parse_fault
from glucoloop.trials.faults import START
from glucoloop.trials.guard_catalogue import GUARD, complete_guard

STRICT: Final = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
LONGEST_RUN_MIN: Final = 366 * 1440.0
LARGEST_SEED: Final = 2**32 - 1
SHORTEST_SAMPLE_TIME_MIN: Final = 0.1
"""With it the paper's memory of three hours still has no more samples than a memory may have."""
LONGEST_SAMPLE_TIME_MIN: Final = 120.0
PAPER_SAMPLE_TIME_MIN: Final = 5.0
PAPER_MEMORY_MIN: Final = 180.0
PAPER_POLE: Final = 0.84
IDENTIFICATION_KEYS: Final = ("model_noise_variance", "memory", "laguerre_pole", "laguerre_functions")
"""How a model is identified for the run, in place of `model`, which names a file."""

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


class Surroundings(BaseModel):
    """Patient, meals, sensor and pump, whoever or whatever doses."""

    model_config = STRICT

    operating_point: str = "setpoint-81"
    setpoint_mg_dl: Setpoint | None = None
    """Target; None: the patient's own."""
    initial_glucose_mg_dl: Glucose | None = None
    """Where the patient rests at the start; None: at the setpoint."""
    meals: tuple[str, ...] = ("50g@50min",)
    duration_min: Duration = 600.0
    sample_time_min: SampleTime = PAPER_SAMPLE_TIME_MIN
    noise_variance: Variance = 0.0
    dead_time_min: DeadTime = 0.0
    max_change_mU_min: RateChange = 16.7
    min_insulin_mU_min: LeastRate = 0.0
    max_insulin_mU_min: LargestRate = 66.9
    allow_unusual: bool = False
    """Whether values that are hardly meant are taken as they are."""

    def eaten(self) -> tuple[Meal, ...]:
        """The meals."""
        return tuple(parse_meal(text) for text in self.meals)


class Situation(Surroundings):
    """What all controllers of a comparison share."""

    announce_meals: bool = False
    noise_bound_mg_dl: NoiseBound = 5.0
    pump_resolution_mU_min: RateStep | None = None
    """Smallest step of the pump; None: any rate."""
    faults: tuple[str, ...] = ()
    """Of sensor and pump, the first innermost; around noise and dead time."""
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


class Case(BaseModel):
    """A controller, its tuning, and the model it is designed on."""

    model_config = STRICT

    controller: str = "mpc"
    tuning: Mapping[str, catalogue.Value] = Field(default_factory=dict)
    known_dead_time: bool = False
    guard: bool = False
    guard_limits: Mapping[str, catalogue.Value] = Field(default_factory=dict)
    """Empty without a guard."""
    model: str | None = None
    """Path of a model file; None: a model is identified from the patient."""
    model_noise_variance: Variance | None = None
    """Noise of the record that the model is identified from."""
    memory: Memory | None = None
    laguerre_pole: Pole | None = None
    laguerre_functions: Functions | None = None
    """0: the impulse response is left as it was estimated."""


@dataclass(frozen=True)
class Run:
    """A controller in its situation."""

    situation: Situation
    case: Case

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same run is read."""
        return {**self.situation.model_dump(mode="json"), **case_keys(self.case)}

    def with_model(self, path: str) -> Self:
        """The same run, with its model from another file."""
        return type(self)(situation=self.situation, case=self.case.model_copy(update={"model": path}))


def case_keys(case: Case) -> dict[str, Any]:
    """The flat keys of a case: its tuning stands among the others."""
    keys = case.model_dump(mode="json")
    limits = keys.pop("guard_limits")
    return {"controller": keys.pop("controller"), **keys.pop("tuning"), **keys, **limits}


def read_run(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Run:
    """Run from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        What a key is called where it was given; for messages.

    Raises
    ------
    ValueError
        For an unknown key, or a value of the wrong type or out of bounds.
    """
    refuse_unknown(keys)
    situation = checked(Situation, _only(keys, Situation), names)
    if not situation.allow_unusual:
        ask_about_surroundings(situation, situation.eaten(), names)
        ask_about_clock(situation.meals, situation.duration_min)
    whole_samples(situation.dead_time_min, situation.sample_time_min)
    faults = faults_told(situation.faults, situation.duration_min, allow_unusual=situation.allow_unusual)
    meals = tuple(meal_text(meal) for meal in situation.eaten())
    situation = situation.model_copy(update={"meals": meals, "faults": faults})
    return Run(situation=situation, case=read_case(keys, situation, names))


def ask_about_surroundings(situation: Surroundings, meals: Iterable[Meal], names: Names = None) -> None:
    """Ask about what is hardly meant.

    Raises
    ------
    ValueError
        For the first value outside the range in which people mean it.
    """
    ask_about_pump(
        situation.operating_point,
        situation.setpoint_mg_dl,
        min_insulin_mU_min=situation.min_insulin_mU_min,
        max_insulin_mU_min=situation.max_insulin_mU_min,
        names=names,
    )
    ask_about(situation, names)
    ask_about_meals(meals)


def read_case(keys: Mapping[str, object], situation: Situation, names: Mapping[str, str] | None = None) -> Case:
    """Case from flat keys, completed for its situation."""
    own = _only(keys, Case)
    controller = own.get("controller", "mpc")
    settings = {key: value for key, value in keys.items() if key in catalogue.all_settings()}
    tuning = catalogue.complete(
        str(controller), settings, operating_point=situation.operating_point, noisy=situation.noisy
    )
    if catalogue.controller_entry(str(controller)).uses_model and own.get("model") is None:
        own = {**_identification(situation), **own}
    guard = _guard_limits(keys, bool(own.get("guard", False)), names)
    case = checked(Case, {**own, "tuning": tuning, "guard_limits": guard}, names)
    if not situation.allow_unusual:
        ask_about(case, names)
        ask_about_settings((*catalogue.controller_entry(case.controller).settings, *GUARD.values()), keys, names)
    return case


def _guard_limits(
    keys: Mapping[str, object], guarded: bool, names: Mapping[str, str] | None
) -> dict[str, catalogue.Value]:
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
    """Faults in full.

    Raises
    ------
    ValueError
        For a text that is no fault, one that begins after the end of the run, or a setting that is hardly meant,
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


def _identification(situation: Situation) -> dict[str, object]:
    """The paper's identification, at the run's own sample time."""
    sample_time_min = situation.sample_time_min
    return {
        "model_noise_variance": situation.noise_variance,
        "memory": paper_memory(sample_time_min),
        "laguerre_pole": paper_pole(sample_time_min),
        "laguerre_functions": 2,
    }


def paper_memory(sample_time_min: float) -> int:
    """Samples that cover the paper's memory of three hours."""
    return max(2, round(PAPER_MEMORY_MIN / sample_time_min))


def paper_pole(sample_time_min: float) -> float:
    """Pole that decays with the paper's time constant at another sample time."""
    return float(PAPER_POLE ** (sample_time_min / PAPER_SAMPLE_TIME_MIN))


def overlay(
    lower: Mapping[str, object], upper: Mapping[str, object], names: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Flat keys in two layers, of which the upper one wins.

    With a key go those it excludes: a model file and the way of identifying one, and the settings of a controller that
    another one takes the place of.

    Raises
    ------
    ValueError
        Where one layer holds keys that exclude one another.
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
        foreign = catalogue.all_settings().keys() - own
        kept = {key: value for key, value in kept.items() if key not in foreign}
    if upper.get("guard") is False:
        kept = {key: value for key, value in kept.items() if key not in GUARD}
    return {**kept, **upper}


def refuse_unknown(keys: Mapping[str, object], more: tuple[str, ...] = ()) -> None:
    """Refuse a key that neither a situation, a case nor any controller has."""
    known = [*run_keys(), *more]
    for key in keys:
        if key not in known:
            raise ValueError(f"unknown key {key!r}; {catalogue.known_names(key, known)}")


def run_keys() -> list[str]:
    """All flat keys of a run."""
    return [*Situation.model_fields, *case_key_names()]


def case_key_names() -> list[str]:
    """The flat keys that a case of a comparison may set."""
    own = [key for key in Case.model_fields if key not in ("tuning", "guard_limits")]
    return [*own, *catalogue.all_settings(), *GUARD]


def whole_samples(minutes: float, sample_time_min: float, what: str = "a dead time") -> int:
    """Minutes as samples; `what` they are, for messages.

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
    """A record from its keys, refused in one sentence."""
    try:
        return record.model_validate({key: tuple(v) if isinstance(v, list) else v for key, v in keys.items()})
    except ValidationError as error:
        raise ValueError(one_sentence(error, record, names)) from None


def _only(keys: Mapping[str, object], record: type[BaseModel]) -> dict[str, object]:
    return {key: value for key, value in keys.items() if key in record.model_fields}
