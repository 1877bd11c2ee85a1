"""Keys of a situation: the patient, meals, sensor, pump, faults and the run."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from glucoloop.config.key import Key, declared
from glucoloop.limits import LARGEST_SEED, LONGEST_RUN_MIN
from glucoloop.parts.clock_text import parse_time_of_day
from glucoloop.parts.faults import FAULTS
from glucoloop.parts.patients import PATIENTS, USUAL_PATIENT
from glucoloop.parts.pumps import PUMPS, USUAL_PUMP
from glucoloop.parts.sensors import SENSORS, USUAL_SENSOR
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
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.meals import Meal, Scenario
    from glucoloop.situations.situation import Situation

SHORTEST_SAMPLE_TIME_MIN: Final = 0.1
"""Shortest sample time; with it the paper's memory of three hours stays within the largest memory."""
LONGEST_SAMPLE_TIME_MIN: Final = 120.0
PAPER_SAMPLE_TIME_MIN: Final = 5.0

PATIENT_PANEL: Final = "Patient and meals"
RUN_PANEL: Final = "Run"
_patient = functools.partial(Key, panel=PATIENT_PANEL)
_sensor = functools.partial(Key, panel="Sensor")
_pump = functools.partial(Key, panel="Pump")
_run = functools.partial(Key, panel=RUN_PANEL)

PATIENTS_TOLD: Final = "; ".join(f"{entry.name}: {entry.summary}" for entry in PATIENTS.values())
_POINTS: Final = " ".join(
    f"Of {entry.name}: {'; '.join(f'{point.name}: {point.summary}' for point in entry.operating_points)}."
    for entry in PATIENTS.values()
)
PUMPS_TOLD: Final = "; ".join(f"{entry.name}: {entry.summary}" for entry in PUMPS.values())
SENSORS_TOLD: Final = "; ".join(f"{entry.name}: {entry.summary}" for entry in SENSORS.values())


def _of_part(part: str) -> str:
    """List of faults with their settings, for help."""
    return "; ".join(
        " ".join([entry.name, *(f"{setting.name}={setting.default.text}" for setting in entry.own_settings().values())])
        for entry in FAULTS.values()
        if entry.part == part
    )


KINDS_OF_FAULTS: Final = (
    f"Sensor: {_of_part('sensor')}. Pump: {_of_part('pump')}. All faults that come and go take start_min, "
    "latest_min, duration_min and per_day."
)

# Keys that an identification has as well.
PatientKey = Annotated[
    str,
    _patient(
        f"{PATIENTS_TOLD}; or one of another package, or module:attribute. Pump, model and tuning are by default those "
        "usual for it."
    ),
]
OperatingPointKey = Annotated[
    str, _patient(f"Where the patient rests. {_POINTS}", metavar="NAME", told="the first of the patient's")
]
VarianceKey = Annotated[
    float,
    _sensor(
        "Variance of the noise on each reading, (mg/dl)²; the paper's is 1.45.",
        flag="--noise",
        at_least=0.0,
        at_most=10_000.0,
        quantity=NOISE_VARIANCE,
    ),
]
NoiseBoundKey = Annotated[
    float, _sensor("Largest deviation of a reading.", above=0.0, at_most=1000.0, quantity=NOISE_BOUND)
]
DeadTimeKey = Annotated[
    float,
    _sensor("Delay of the readings; a whole number of samples.", at_least=0.0, at_most=1440.0, quantity=DEAD_TIME),
]
SampleTimeKey = Annotated[
    float,
    _run(
        "Time between two readings, and between two doses.",
        at_least=SHORTEST_SAMPLE_TIME_MIN,
        at_most=LONGEST_SAMPLE_TIME_MIN,
        quantity=SAMPLE_TIME,
    ),
]
SeedKey = Annotated[int, _run("The same seed gives the same noise.", at_least=0, at_most=LARGEST_SEED)]
AllowUnusualKey = Annotated[bool, _run("Accept values that look like another unit or are implausible.")]


def place_of(patient: str, operating_point: str) -> str:
    """Short name of the operating point, after the name of the patient unless it is the usual one."""
    return operating_point if patient == USUAL_PATIENT.name else f"{patient}, {operating_point}"


@dataclass(frozen=True, kw_only=True)
class SituationKeys:
    """Keys that all controllers of a comparison share."""

    patient: PatientKey = USUAL_PATIENT.name
    operating_point: OperatingPointKey = USUAL_PATIENT.usual_point
    setpoint_mg_dl: Annotated[
        float | None,
        _patient(
            "Target of the controller; the patient's own by default.", above=0.0, at_most=2000.0, quantity=SETPOINT
        ),
    ] = None
    initial_glucose_mg_dl: Annotated[
        float | None,
        _patient(
            "Glucose at which the patient rests at the start; by default the patient's own setpoint.",
            above=0.0,
            at_most=2000.0,
            quantity=GLUCOSE,
        ),
    ] = None
    meals: Annotated[
        tuple[str, ...],
        _patient(
            "Carbohydrate and time, like 50g@50min or 50g@1.5h, or 50g@1.5h/15min if eating takes 15 min; repeat it "
            "for more meals.",
            flag="--meal",
            metavar="G@TIME",
            empty=("no_meal", "A run without meals."),
        ),
    ] = ("50g@50min",)
    meal_model: Annotated[
        str | None,
        _patient(
            "Model of digestion and absorption of the patient: lehmann-deutsch or hovorka; the meal model of the "
            "controller does not change.",
            told="the patient's own",
        ),
    ] = None
    announce_meals: Annotated[
        bool, _patient("Tell the controller of each meal when it begins.", flag="--announce-meals/--no-announce-meals")
    ] = False
    carb_error_pct: Annotated[
        float,
        _patient(
            "Error of counting the carbohydrate of announced meals: its standard deviation in percent of a meal, drawn "
            "for each meal and person.",
            at_least=0.0,
            at_most=100.0,
        ),
    ] = 0.0
    carb_bias_pct: Annotated[
        float,
        _patient(
            "Mean of that error in percent of a meal; below 0 too little is announced.", at_least=-100.0, at_most=100.0
        ),
    ] = 0.0
    start: Annotated[
        str | None,
        _patient("Time of day at the start, of which controllers are told; not told by default.", metavar="HH:MM"),
    ] = None
    sensor: Annotated[
        str,
        _sensor(
            f"{SENSORS_TOLD}; or one of another package, or module:attribute; with its settings, like 'white-noise, "
            "variance=1.45'. The noise and the dead time below are added to it, and designs are told of these only.",
            metavar="SENSOR",
        ),
    ] = USUAL_SENSOR
    noise_variance: VarianceKey = 0.0
    noise_bound_mg_dl: NoiseBoundKey = 5.0
    dead_time_min: DeadTimeKey = 0.0
    site: Annotated[
        str | None,
        _sensor(
            "Site of the sensor: arterial or interstitial, or plasma or interstitial, depending on the patient.",
            told="the site at which glucose is controlled",
        ),
    ] = None
    pump: Annotated[
        str,
        _pump(
            f"{PUMPS_TOLD}; or one of another package, or module:attribute; with its settings, like 'expiring, "
            "samples=3'. It gets the limits below, which are by default its own, or those usual for the patient; the "
            "resolution is put around it.",
            metavar="PUMP",
        ),
    ] = USUAL_PUMP
    max_change_mU_min: Annotated[
        float,
        _pump(
            "Largest change of the rate from one sample to the next.",
            flag="--max-rate-change",
            above=0.0,
            at_most=10_000.0,
            quantity=RATE_CHANGE,
            told=f"{USUAL_PATIENT.max_change_mU_min:g}, or the patient's",
        ),
    ] = USUAL_PATIENT.max_change_mU_min
    min_insulin_mU_min: Annotated[
        float, _pump("Least rate of the pump.", at_least=0.0, at_most=10_000.0, quantity=LEAST_RATE)
    ] = USUAL_PATIENT.min_insulin_mU_min
    max_insulin_mU_min: Annotated[
        float,
        _pump(
            "Greatest rate of the pump.",
            above=0.0,
            at_most=10_000.0,
            quantity=LARGEST_RATE,
            told=f"{USUAL_PATIENT.max_insulin_mU_min:g}, or the patient's",
        ),
    ] = USUAL_PATIENT.max_insulin_mU_min
    pump_resolution_mU_min: Annotated[
        float | None,
        _pump("Smallest step of the rate; any rate by default.", above=0.0, at_most=10_000.0, quantity=RATE_STEP),
    ] = None
    max_bolus_U: Annotated[
        float, _pump("Largest bolus of the pump.", flag="--max-bolus", metavar="U", above=0.0, at_most=1000.0)
    ] = 25.0
    min_bolus_U: Annotated[
        float,
        _pump(
            "Least bolus that the pump gives; a smaller one is not given.",
            flag="--min-bolus",
            metavar="U",
            at_least=0.0,
            at_most=1000.0,
        ),
    ] = 0.05
    bolus_step_U: Annotated[
        float,
        _pump(
            "Step of a bolus, which is rounded down to whole ones.",
            flag="--bolus-step",
            metavar="U",
            above=0.0,
            at_most=1000.0,
        ),
    ] = 0.05
    faults: Annotated[
        tuple[str, ...],
        Key(
            "A fault, like 'missing, start_min=120, duration_min=30' or 'spikes, per_day=8, size_mg_dl=-40'; repeat it "
            f"for more, each around the earlier ones. {KINDS_OF_FAULTS}",
            panel="Faults",
            flag="--fault",
            metavar="FAULT",
            empty=("no_fault", "A run without faults, also if the file has some."),
        ),
    ] = ()
    metrics: Annotated[
        tuple[str, ...],
        _run(
            "A metric of another package, or module:attribute, beside the usual ones, with its settings, like 'NAME, "
            "setting=value'; repeat it for more.",
            flag="--metric",
            metavar="METRIC",
        ),
    ] = ()
    duration_min: Annotated[
        float, _run("Length of the run.", above=0.0, at_most=LONGEST_RUN_MIN, quantity=DURATION)
    ] = 600.0
    sample_time_min: SampleTimeKey = PAPER_SAMPLE_TIME_MIN
    seed: SeedKey = 0
    integrator: Annotated[
        Literal["fast", "adaptive"],
        _run("fast: one exponential step per sample; adaptive: Runge-Kutta of order 8, the reference."),
    ] = "fast"
    allow_unusual: AllowUnusualKey = False

    @property
    def place(self) -> str:
        """The operating point, with the patient's name where it is another than the usual one."""
        return place_of(self.patient, self.operating_point)

    @property
    def noisy(self) -> bool:
        """Whether readings carry noise."""
        return self.noise_variance > 0.0

    @property
    def drawn(self) -> bool:
        """Whether runs may differ by their seeds: by noise, by another sensor, or by a fault."""
        return self.noisy or self.drawn_otherwise

    @property
    def drawn_otherwise(self) -> bool:
        """Whether something else than noise around the sensor may be drawn: its own noise, or a fault."""
        return self.sensor != USUAL_SENSOR or bool(self.faults)

    @property
    def miscounts(self) -> bool:
        """Whether carbohydrate is counted with an error."""
        return self.carb_error_pct != 0.0 or self.carb_bias_pct != 0.0

    @property
    def dead_time_samples(self) -> int:
        """Dead time of the readings.

        Raises
        ------
        ValueError
            Unless it is a whole number of samples.
        """
        return whole_samples(self.dead_time_min, self.sample_time_min)

    @property
    def start_min(self) -> float | None:
        """Time of day at the start, in minutes after midnight.

        Raises
        ------
        ValueError
            For a text that is not a time of day.
        """
        return None if self.start is None else parse_time_of_day(self.start)

    def eaten(self) -> tuple[Meal, ...]:
        """Meals of the run, with the announced carbohydrate of each where it is counted with an error."""
        from glucoloop.meals.counting import counted_meals
        from glucoloop.situations.meal_text import parse_meal

        meals = tuple(parse_meal(text) for text in self.meals)
        if not self.miscounts:
            return meals
        return counted_meals(meals, self.seed, error_pct=self.carb_error_pct, bias_pct=self.carb_bias_pct)

    def scenario(self) -> Scenario:
        """Meals, length, target, start and time of day.

        Raises
        ------
        ValueError
            For meals, a length or a time of day that are not possible.
        """
        from glucoloop.meals import Scenario

        return Scenario(
            self.eaten(),
            self.duration_min,
            setpoint_mg_dl=self.setpoint_mg_dl,
            initial_glucose_mg_dl=self.initial_glucose_mg_dl,
            allow_unusual=self.allow_unusual,
            announced=self.announce_meals,
            meal_model=self.meal_model,
            start_min=self.start_min,
        )

    def situation(self) -> Situation:
        """Situation of an experiment from these keys.

        Raises
        ------
        ValueError
            Unless the dead time is a whole number of samples.
        """
        return situation_of(self, announced=self.announce_meals)


def situation_of(keys: Any, **other: Any) -> Situation:
    """Situation of an experiment from a record of keys; what the record does not say is as usual."""
    from glucoloop.situations.situation import Situation

    said = {field.name: getattr(keys, field.name) for field in fields(Situation) if hasattr(keys, field.name)}
    return Situation(**{**said, **other})


def refuse_parts_of_samples(
    horizon_min: float, sample_time_min: float, names: Mapping[str, str] | None = None, *, has_duration: bool = True
) -> None:
    """Refuse a run that is not a whole number of samples long.

    Parameters
    ----------
    horizon_min, sample_time_min : float
    names : mapping, optional
        Name under which the user gave each key; where any is an option, the mend is told as options.
    has_duration : bool
        Whether the horizon can be given in minutes.

    Raises
    ------
    ValueError
        With the nearest sample time and the nearest duration that would be possible.
    """

    def samples_of(minutes: float) -> int | None:
        number = max(1, round(horizon_min / minutes))
        return number if abs(number * minutes - horizon_min) <= 1e-9 * horizon_min else None

    if samples_of(sample_time_min) is not None:
        return
    options = any(name.startswith("-") for name in (names or {}).values())
    own = declared(SituationKeys)
    sample_time, duration = (own[key].flag if options else f"{key} =" for key in ("sample_time_min", "duration_min"))
    tenths = (tenth / 10.0 for tenth in range(1, round(10.0 * LONGEST_SAMPLE_TIME_MIN) + 1))
    near = (minutes for minutes in tenths if sample_time_min / 2.0 < minutes < 2.0 * sample_time_min)
    possible = [minutes for minutes in near if samples_of(minutes) is not None]
    mends = [f"{sample_time} {min(possible, key=lambda minutes: abs(minutes - sample_time_min)):g}"] if possible else []
    if has_duration:
        mends.append(f"{duration} {max(1, round(horizon_min / sample_time_min)) * sample_time_min:g}")
    raise Refusal(
        f"a horizon of {horizon_min:g} min is not a whole number of samples of {sample_time_min:g} min; "
        f"give {' or '.join(mends) or 'another sample time'}"
    )


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
        raise Refusal(
            f"{what} of {minutes:g} min is not a whole number of {sample_time_min:g}-min samples; "
            f"give {below:g} or {below + sample_time_min:g} min"
        )
    return samples
