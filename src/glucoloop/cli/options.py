"""Options of the commands, and their conversion to configuration keys.

An option stands for a key of the configuration, so that the command line and files use the same settings. Options that
were not given are not passed on, so that files and defaults apply.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import typer

from glucoloop.registry.controllers import CONTROLLERS, all_settings
from glucoloop.registry.faults import FAULTS as KNOWN_FAULTS
from glucoloop.registry.guard import GUARD
from glucoloop.registry.patients import PATIENTS, USUAL_PATIENT

Given = dict[str, Any]
"""Value of each option that was given, by its key."""


_NUMBERS: Final[dict[Any, str]] = {int: "a whole number", float: "a number"}


@dataclass(frozen=True)
class Option:
    """One option of a command."""

    key: str
    flag: str
    """Name with dashes; a switch has its opposite after a slash."""
    kind: Any
    help: str
    panel: str
    metavar: str | None = None
    default: str | None = None
    """Text of the default in the help."""

    @property
    def name(self) -> str:
        """Name of the option as the user writes it."""
        return self.flag.split("/")[0]

    def parameter(self) -> inspect.Parameter:
        """Parameter of a command's signature, from which Typer makes the option."""
        told = self.help if self.default is None else f"{self.help} (default {self.default})"
        info = typer.Option(
            None, self.flag, help=told, metavar=self.metavar, rich_help_panel=self.panel, show_default=False
        )
        # Numbers come as text: what is wrong with one is told like all other mistakes.
        kind = str if self.kind in _NUMBERS else self.kind
        return inspect.Parameter(self.key, inspect.Parameter.KEYWORD_ONLY, default=info, annotation=kind | None)

    def read(self, value: Any) -> Any:
        """The value in the option's type.

        Raises
        ------
        ValueError
            For a text that is not a number.
        """
        if self.kind not in _NUMBERS:
            return value
        try:
            return self.kind(value)
        except ValueError:
            raise ValueError(f"{self.name} is {value!r}; give {_NUMBERS[self.kind]}") from None


def reworded(options: Iterable[Option], **words: Mapping[str, str | None]) -> Iterator[Option]:
    """Options with other texts by key, in place of some of theirs: ``help={"people": "Number of people."}``."""
    for option in options:
        texts: dict[str, Any] = {field: of[option.key] for field, of in words.items() if option.key in of}
        yield dataclasses.replace(option, **texts)


def names(options: Iterable[Option], given: Given) -> dict[str, str]:
    """Option names by key for the given options; keys of a file keep their own names."""
    return {option.key: option.name for option in options if option.key in given}


def with_options(options: Iterable[Option]) -> Callable[[Callable[[Given], None]], Callable[..., None]]:
    """Make a command from a function of the given options."""
    by_key = {option.key: option for option in options}
    parameters = [option.parameter() for option in by_key.values()]

    def decorate(function: Callable[[Given], None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            function({key: by_key[key].read(value) for key, value in values.items() if value is not None})

        command.__doc__ = function.__doc__
        command.__dict__["__signature__"] = inspect.Signature(parameters)
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return command

    return decorate


_PATIENT: Final = "Patient and meals"
_SENSOR: Final = "Sensor"
_PUMP: Final = "Pump"
_FAULTS: Final = "Faults"
_RUN: Final = "Run"
_CONTROLLER: Final = "Controller"
_GUARD: Final = "Guard"
_MODEL: Final = "Model"
_OUTPUT: Final = "Files and output"

PATIENT: Final = Option(
    "patient",
    "--patient",
    str,
    "; ".join(f"{entry.name}: {entry.summary}" for entry in PATIENTS.values())
    + "; or one of another package, or module:attribute. Pump, model and tuning are by default those usual for it.",
    _PATIENT,
    metavar="NAME",
    default=USUAL_PATIENT.name,
)
OPERATING_POINT: Final = Option(
    "operating_point",
    "--operating-point",
    str,
    "Where the patient rests. "
    + " ".join(
        f"Of {entry.name}: {'; '.join(f'{point.name}: {point.summary}' for point in entry.operating_points)}."
        for entry in PATIENTS.values()
    ),
    _PATIENT,
    metavar="NAME",
    default="the first of the patient's",
)
NOISE: Final = Option(
    "noise_variance",
    "--noise",
    float,
    "Variance of the noise on each reading, (mg/dl)²; the paper's is 1.45.",
    _SENSOR,
    metavar="VARIANCE",
    default="0",
)
NOISE_BOUND: Final = Option(
    "noise_bound_mg_dl",
    "--noise-bound",
    float,
    "Largest deviation of a reading.",
    _SENSOR,
    metavar="MG_DL",
    default="5",
)
DEAD_TIME: Final = Option(
    "dead_time_min",
    "--dead-time",
    float,
    "Delay of the readings; a whole number of samples.",
    _SENSOR,
    metavar="MIN",
    default="0",
)
SAMPLE_TIME: Final = Option(
    "sample_time_min",
    "--sample-time",
    float,
    "Time between two readings, and between two doses.",
    _RUN,
    metavar="MIN",
    default="5",
)
SEED: Final = Option("seed", "--seed", int, "The same seed gives the same noise.", _RUN, metavar="N", default="0")
ALLOW_UNUSUAL: Final = Option(
    "allow_unusual",
    "--allow-unusual",
    bool,
    "Accept values that look like another unit or are implausible.",
    _RUN,
)
MEMORY: Final = Option(
    "memory",
    "--memory",
    int,
    "Number of samples after which the effect of a dose has died out, M.",
    _MODEL,
    metavar="M",
    default="3 hours",
)
LAGUERRE_POLE: Final = Option(
    "laguerre_pole",
    "--laguerre-pole",
    float,
    "Pole of the Laguerre functions that smooth the impulse response.",
    _MODEL,
    metavar="POLE",
    default="0.84 at 5-min samples",
)
LAGUERRE_FUNCTIONS: Final = Option(
    "laguerre_functions",
    "--laguerre-functions",
    int,
    "Number of Laguerre functions; 0 leaves the impulse response as it was estimated.",
    _MODEL,
    metavar="L",
    default="2",
)
MEALS: Final = "meals"
NO_MEAL: Final = "no_meal"
SETTINGS: Final = "settings"
FAULTS: Final = "faults"
NO_FAULT: Final = "no_fault"


def _of_part(part: str) -> str:
    """List of faults with their settings, for help."""
    return "; ".join(
        " ".join([entry.name, *(f"{setting.name}={setting.default.text}" for setting in entry.settings)])
        for entry in KNOWN_FAULTS.values()
        if entry.part == part
    )


KINDS_OF_FAULTS: Final = (
    f"Sensor: {_of_part('sensor')}. Pump: {_of_part('pump')}. All faults that come and go take start_min, "
    "latest_min, duration_min and per_day."
)


SITUATION: Final = (
    PATIENT,
    OPERATING_POINT,
    Option(
        "setpoint_mg_dl",
        "--setpoint",
        float,
        "Target of the controller; the patient's own by default.",
        _PATIENT,
        metavar="MG_DL",
    ),
    Option(
        "initial_glucose_mg_dl",
        "--initial-glucose",
        float,
        "Glucose at which the patient rests at the start; by default the patient's own setpoint.",
        _PATIENT,
        metavar="MG_DL",
    ),
    Option(
        MEALS,
        "--meal",
        list[str],
        "Carbohydrate and time, like 50g@50min or 50g@1.5h, or 50g@1.5h/15min if eating takes 15 min; repeat it for "
        "more meals.",
        _PATIENT,
        metavar="G@TIME",
        default="50g@50min",
    ),
    Option(NO_MEAL, "--no-meal", bool, "A run without meals.", _PATIENT),
    Option(
        "meal_model",
        "--meal-model",
        str,
        "Model of digestion and absorption of the patient: lehmann-deutsch or hovorka; the meal model of the "
        "controller does not change.",
        _PATIENT,
        metavar="NAME",
        default="the patient's own",
    ),
    Option(
        "announce_meals",
        "--announce-meals/--no-announce-meals",
        bool,
        "Tell the controller of each meal when it begins.",
        _PATIENT,
    ),
    Option(
        "carb_error_pct",
        "--carb-error",
        float,
        "Error of counting the carbohydrate of announced meals: its standard deviation in percent of a meal, drawn for "
        "each meal and person.",
        _PATIENT,
        metavar="PCT",
        default="0",
    ),
    Option(
        "carb_bias_pct",
        "--carb-bias",
        float,
        "Mean of that error in percent of a meal; below 0 too little is announced.",
        _PATIENT,
        metavar="PCT",
        default="0",
    ),
    Option(
        "start",
        "--start",
        str,
        "Time of day at the start, of which controllers are told; not told by default.",
        _PATIENT,
        metavar="HH:MM",
    ),
    NOISE,
    NOISE_BOUND,
    DEAD_TIME,
    Option(
        "site",
        "--site",
        str,
        "Site of the sensor: arterial or interstitial, or plasma or interstitial, depending on the patient.",
        _SENSOR,
        metavar="NAME",
        default="the site at which glucose is controlled",
    ),
    Option(
        "max_change_mU_min",
        "--max-rate-change",
        float,
        "Largest change of the rate from one sample to the next.",
        _PUMP,
        metavar="MU_MIN",
        default="16.7, or the patient's",
    ),
    Option(
        "min_insulin_mU_min", "--min-insulin", float, "Least rate of the pump.", _PUMP, metavar="MU_MIN", default="0"
    ),
    Option(
        "max_insulin_mU_min",
        "--max-insulin",
        float,
        "Greatest rate of the pump.",
        _PUMP,
        metavar="MU_MIN",
        default="66.9, or the patient's",
    ),
    Option(
        "pump_resolution_mU_min",
        "--pump-resolution",
        float,
        "Smallest step of the rate; any rate by default.",
        _PUMP,
        metavar="MU_MIN",
    ),
    Option(
        FAULTS,
        "--fault",
        list[str],
        "A fault, like 'missing, start_min=120, duration_min=30' or 'spikes, per_day=8, size_mg_dl=-40'; repeat it for "
        f"more, each around the earlier ones. {KINDS_OF_FAULTS}",
        _FAULTS,
        metavar="FAULT",
    ),
    Option(NO_FAULT, "--no-fault", bool, "A run without faults, also if the file has some.", _FAULTS),
    Option("duration_min", "--duration", float, "Length of the run.", _RUN, metavar="MIN", default="600"),
    SAMPLE_TIME,
    SEED,
    Option(
        "integrator",
        "--integrator",
        str,
        "fast: one exponential step per sample; adaptive: Runge-Kutta of order 8, the reference.",
        _RUN,
        metavar="fast|adaptive",
        default="fast",
    ),
    ALLOW_UNUSUAL,
)
"""Options that all controllers of a comparison share."""


def _setting_options() -> Iterable[Option]:
    """An option for each setting of the catalogue, with the default of each controller that has it."""
    for name, owners in all_settings().items():
        first = next(iter(owners.values()))
        by_text: dict[str, list[str]] = {}
        for controller, setting in owners.items():
            by_text.setdefault(setting.default.text, []).append(controller)
        defaults = "; ".join(f"{', '.join(controllers)}: {text}" for text, controllers in by_text.items())
        yield Option(
            name,
            f"--{name.replace('_', '-')}",
            first.type,
            f"{first.summary} One of {', '.join(first.choices)}." if first.choices else first.summary,
            _CONTROLLER,
            metavar={int: "N", float: "X", str: "NAME"}[first.type],
            default=defaults,
        )


def _guard_options() -> Iterable[Option]:
    for setting in GUARD.values():
        flag = f"--{setting.name.replace('_', '-')}"
        yield Option(
            setting.name, flag, setting.type, setting.summary, _GUARD, metavar="X", default=setting.default.text
        )


OF_OTHERS: Final = "or one of another package, or module:attribute, whose settings are given by --setting"
"""Text for help on controllers of other packages."""
SETTING: Final = Option(
    SETTINGS,
    "--setting",
    list[str],
    "A setting of the controller, like gain=0.2; needed for a controller of another package, whose settings have no "
    "options of their own. Repeat it for more.",
    _CONTROLLER,
    metavar="KEY=VALUE",
)
CASE: Final = (
    Option(
        "controller",
        "--controller",
        str,
        "; ".join(f"{entry.name}: {entry.summary}" for entry in CONTROLLERS.values()) + f"; {OF_OTHERS}.",
        _CONTROLLER,
        metavar="NAME",
        default="mpc",
    ),
    SETTING,
    *_setting_options(),
    Option(
        "known_dead_time",
        "--known-dead-time/--unknown-dead-time",
        bool,
        "Whether the controller knows the dead time: its model is then delayed and its prediction horizon longer.",
        _CONTROLLER,
        default="unknown",
    ),
    Option(
        "guard",
        "--guard/--no-guard",
        bool,
        "Put a guard around the controller: it rejects impossible readings, falls back to the basal rate without "
        "readings, suspends insulin on predicted low glucose, and bounds the dose.",
        _GUARD,
        default="no guard",
    ),
    *_guard_options(),
    Option(
        "model",
        "--model",
        str,
        "Model from `glucoloop identify`; by default one is identified from the patient.",
        _MODEL,
        metavar="FILE",
    ),
    Option(
        "model_noise_variance",
        "--model-noise",
        float,
        "Variance of the noise on the record that the model is identified from.",
        _MODEL,
        metavar="VARIANCE",
        default="as --noise",
    ),
    MEMORY,
    LAGUERRE_POLE,
    LAGUERRE_FUNCTIONS,
)
"""Options of a controller, its tuning and its model."""

OUTPUT: Final = (
    Option(
        "config",
        "--config",
        str,
        "Read options from a TOML file; those given here win, and a list given here takes the place of the file's.",
        _OUTPUT,
        metavar="FILE",
    ),
    Option("out", "--out", str, "Folder for tables, figures and the configuration.", _OUTPUT, metavar="DIR"),
    Option("overwrite", "--overwrite", bool, "Replace an earlier result in that folder.", _OUTPUT),
    Option("json", "--json", bool, "Print one JSON object instead of a table.", _OUTPUT),
)
MMOL: Final = Option("mmol", "--mmol", bool, "Show glucose in mmol/l as well.", _OUTPUT)
