"""Controllers by name: what each is, what can be set, and where it is designed.

A controller joins the command line, the configuration files and the comparisons by one entry in `CONTROLLERS`, or by
the entry point of another package in the group ``glucoloop.controllers``. The settings of an entry become keys of
configuration files, and those of `CONTROLLERS` options too. Nothing here imports a numerical library, so that help is
shown at once.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.plausible import GLUCOSE_BOUND
from glucoloop.registry.patients import PatientEntry
from glucoloop.registry.plugins import added, added_names, loaded
from glucoloop.registry.settings import Default, Setting, Value, known_names

_TUNED: Final = ("move_horizon", "prediction_horizon", "output_weight", "move_weight")


@dataclass(frozen=True, kw_only=True)
class ControllerEntry:
    """A controller, as far as it can be told without designing it.

    Raises
    ------
    ValueError
        For a place that is not written as ``module:function``, two settings of one name, a default that its setting
        does not allow, or a tunable controller without horizons and weights.
    """

    name: str
    summary: str
    design: str
    """``module:function``; called with an `experiments.designs.DesignCase` and the settings by name, the function
    returns a controller."""
    settings: tuple[Setting, ...] = ()
    uses_model: bool = True
    """Whether it is designed on an identified model; if not, none is identified for it."""
    individual: str | None = "glucoloop.experiments.individual:one_by_one"
    """``module:function`` that designs it for each person of a trial, see `experiments.individual.individual_design`;
    None for a controller that is the same for everybody."""
    tunable: bool = False
    """Whether `glucoloop tune` tries a grid of it: it has the settings of a predictive controller, and `horizons` and
    `padded` as `control.LinearMPC` has them."""
    slow: bool = False
    """Whether a decision takes it so long that studies of many loops close fewer and shorter ones with it."""

    def __post_init__(self) -> None:
        for place in (self.design, self.individual):
            if place is not None and not all(place.partition(":")):
                raise ValueError(f"{place!r} of the controller {self.name} is no place; write it like module:function")
        names = [setting.name for setting in self.settings]
        lacking = [name for name in _TUNED if name not in names]
        if self.tunable and lacking:
            raise ValueError(f"the controller {self.name} cannot be tunable: it has no setting {lacking[0]!r}")
        for setting in self.settings:
            if names.count(setting.name) > 1:
                raise ValueError(f"the controller {self.name} has two settings {setting.name!r}; leave one out")
            for noisy in (False, True):
                try:
                    setting.check(setting.default.value(noisy=noisy))
                except ValueError as error:
                    raise ValueError(f"a default of the controller {self.name} is not allowed: {error}") from None

    def setting(self, name: str) -> Setting:
        """A setting by name.

        Raises
        ------
        ValueError
            If the controller has no such setting.
        """
        known = {setting.name: setting for setting in self.settings}
        if name not in known:
            raise ValueError(f"the controller {self.name} has no setting {name!r}; {known_names(name, known)}")
        return known[name]

    def designer(self) -> Callable[..., Any]:
        """The design function; importing it imports JAX.

        Raises
        ------
        ValueError
            If there is no such function.
        """
        designer: Callable[..., Any] = loaded(self.design)
        return designer

    def individual_designer(self) -> Callable[..., Any] | None:
        """The function that designs it for each person, if it is not the same for everybody.

        Raises
        ------
        ValueError
            If there is no such function.
        """
        return None if self.individual is None else loaded(self.individual)


def move_horizon(default: Default) -> Setting:
    """The move horizon m of a predictive controller."""
    return Setting("move_horizon", int, "Moves that are planned, m.", default)


def prediction_horizon(default: Default) -> Setting:
    """The prediction horizon p of a predictive controller."""
    return Setting("prediction_horizon", int, "Samples looked ahead, p; a known dead time is added to them.", default)


def output_weight(default: Default) -> Setting:
    """The weight Gamma_y of a predictive controller."""
    return Setting("output_weight", float, "Weight on the error of glucose, Γ_y.", default)


def move_weight(default: Default) -> Setting:
    """The weight Gamma_u of a predictive controller."""
    return Setting("move_weight", float, "Weight on each move of insulin, Γ_u.", default)


def constraints(default: Default) -> Setting:
    """How a predictive controller keeps the pump's limits."""
    return Setting(
        "constraints",
        str,
        "clip: the closed form, clipped as in the paper; qp: the best moves within the pump's limits.",
        default,
        choices=("clip", "qp"),
    )


_NO_FLOOR: Final = Default(0.0)


def soft_floor(floor: Default = _NO_FLOOR) -> tuple[Setting, ...]:
    """The constraint (19) on predicted glucose, with slack."""
    return (
        Setting(
            "glucose_floor_mg_dl",
            float,
            "Floor under predicted glucose, kept as far as it pays, in mg/dl; 0: none. Implies the moves of qp.",
            floor,
            quantity=GLUCOSE_BOUND,
        ),
        Setting("floor_weight", float, "Weight on what predicted glucose lacks of the floor, w.", Default(10.0)),
    )


def estimation(reference_filter: float) -> tuple[Setting, ...]:
    """Settings of a controller that estimates the state of a model."""
    return (
        Setting("reference_filter", float, "How slowly the reference approaches, φ_r.", Default(reference_filter)),
        Setting(
            "reference_start",
            int,
            "1: the reference starts to move at the next sample; 0: at this one.",
            Default(1),
        ),
        Setting("glucose_process_noise", float, "Process noise of each glucose state, in Q.", Default(30.0, noisy=0.9)),
        Setting(
            "other_process_noise",
            float,
            "Of each insulin state and slow insulin effect.",
            Default(0.1, noisy=0.01),
        ),
        Setting("glucagon_process_noise", float, "Of glucagon and its slow effect.", Default(10.0, noisy=0.005)),
        Setting("measurement_variance", float, "Variance of a reading as the filter takes it, R.", Default(1.45)),
    )


def unknown_meals() -> tuple[Setting, ...]:
    """Settings of a controller that estimates meals."""
    return (
        Setting(
            "estimator",
            str,
            "How meals are estimated: when one begins and ends, over a horizon; or its rate, by a Kalman filter.",
            Default("moving-horizon"),
            choices=("moving-horizon", "kalman"),
        ),
        Setting("meal_horizon", int, "Samples over which its beginning or end is searched for, L.", Default(10)),
        Setting(
            "meals_per_h", float, "Meals to be expected per hour; more is quicker and less certain.", Default(0.57)
        ),
        Setting("mean_carbs_g", float, "Mean size of a meal, in g.", Default(24.0)),
        Setting("disturbance_variance", float, "Walk of the glucose that nothing explains, (mg/min)².", Default(8.0)),
        Setting(
            "measurement_variance",
            float,
            "Variance of a reading as the filter takes it, R; 0: that of the sensor, at least 0.01.",
            Default(0.0),
        ),
        Setting("caution_weight", float, "Weight on low glucose if the meal ended at once.", Default(3.5)),
        Setting("caution_mg_dl", float, "How far below the setpoint that begins, in mg/dl.", Default(0.8)),
        Setting(
            "anticipation",
            float,
            "Share of the meals that are always expected on which doses rest; 0: glucose rests at the setpoint.",
            Default(1.0),
        ),
        Setting("iterations", int, "Quadratic programs solved at each sample.", Default(1)),
        Setting(
            "individual_by",
            str,
            "With a design for each person: where gain and lag of insulin come from, beside the basal rate.",
            Default("record"),
            choices=("record", "basal", "none"),
        ),
    )


def fitted_step() -> Setting:
    """The step of insulin of a controller on a first-order model."""
    return Setting(
        "step_mU_min",
        float,
        "Lasting step of insulin to which the first-order model is fitted, in mU/min; "
        "0: 11.165, or half the basal rate where that is less.",
        Default(0.0),
    )


CONTROLLERS: Final[dict[str, ControllerEntry]] = {
    entry.name: entry
    for entry in (
        ControllerEntry(
            name="mpc",
            summary="linear model predictive control on the identified step response",
            design="glucoloop.experiments.designs:linear_mpc",
            settings=(
                move_horizon(Default(2)),
                prediction_horizon(Default(8, noisy=10)),
                output_weight(Default(1.0, noisy=3.0)),
                move_weight(Default(0.0, noisy=1.0)),
                constraints(Default("clip")),
                *soft_floor(),
            ),
            individual="glucoloop.experiments.individual:linear_mpc",
            tunable=True,
        ),
        ControllerEntry(
            name="mpc-se",
            summary="linear MPC with a Kalman filter on the linearised patient",
            design="glucoloop.experiments.designs:mpc_se",
            settings=(
                move_horizon(Default(2)),
                prediction_horizon(Default(7, noisy=8)),
                output_weight(Default(1.0)),
                move_weight(Default(0.0, noisy=1.0)),
                *estimation(0.65),
                Setting(
                    "offset_free",
                    str,
                    "What removes a lasting error.",
                    Default("held-innovation"),
                    choices=("held-innovation", "output-disturbance", "input-disturbance", "none"),
                ),
                constraints(Default("clip")),
                *soft_floor(),
            ),
            uses_model=False,
            individual="glucoloop.experiments.individual:mpc_se",
            tunable=True,
        ),
        ControllerEntry(
            name="nlqdmc-se",
            summary="predictive control on the nonlinear patient, linearised anew at each sample, with a Kalman filter",
            design="glucoloop.experiments.designs:nlqdmc_se",
            settings=(
                move_horizon(Default(2)),
                prediction_horizon(Default(5, noisy=6)),
                output_weight(Default(1.0)),
                move_weight(Default(0.0, noisy=1.0)),
                *estimation(0.57),
                *soft_floor(),
            ),
            uses_model=False,
            tunable=True,
            slow=True,
        ),
        ControllerEntry(
            name="meal-mpc",
            summary="predictive control on the nonlinear patient that estimates meals nobody announced",
            design="glucoloop.experiments.designs:meal_mpc",
            settings=(
                move_horizon(Default(2)),
                prediction_horizon(Default(12)),
                output_weight(Default(1.0)),
                move_weight(Default(0.22)),
                *unknown_meals(),
                *soft_floor(Default(65.0)),
            ),
            uses_model=False,
            individual="glucoloop.experiments.individual_meal_mpc:individual_meal_mpc",
            slow=True,
        ),
        ControllerEntry(
            name="imc",
            summary="internal model control with a filter, on a first-order model with dead time",
            design="glucoloop.experiments.designs:imc",
            settings=(
                Setting("filter_min", float, "Time constant of the filter, λ, in minutes.", Default(1.0)),
                Setting("delay_min", float, "Dead time of the first-order model, in minutes.", Default(5.0)),
                fitted_step(),
            ),
            uses_model=False,
        ),
        ControllerEntry(
            name="pid",
            summary="PID in velocity form, tuned on a first-order model with dead time",
            design="glucoloop.experiments.designs:pid",
            settings=(
                Setting("closed_loop_min", float, "Time constant wanted of the loop, in minutes.", Default(30.0)),
                Setting("gain", float, "K_c, mU/min per mg/dl; 0: from the model.", Default(0.0)),
                Setting("integral_time_min", float, "T_I, in minutes; 0: from the model.", Default(0.0)),
                Setting("derivative_time_min", float, "T_D, in minutes; -1: from the model.", Default(-1.0)),
                fitted_step(),
            ),
            uses_model=False,
        ),
        ControllerEntry(
            name="basal",
            summary="no controller: the rate at which the loop starts",
            design="glucoloop.experiments.designs:basal",
            uses_model=False,
            individual=None,
        ),
    )
}


TUNABLE: Final = tuple(entry.name for entry in CONTROLLERS.values() if entry.tunable)
"""Controllers of which `glucoloop tune` tries a grid."""


@functools.cache
def controller_entry(name: str) -> ControllerEntry:
    """A controller by name: of this package, of another one, or ``module:attribute``.

    Raises
    ------
    ValueError
        For an unknown name, or a controller of another package that cannot be loaded.
    """
    if name in CONTROLLERS:
        return CONTROLLERS[name]
    entry: ControllerEntry | None = added("controllers", name, ControllerEntry)
    if entry is None:
        raise ValueError(f"unknown controller {name!r}; {known_names(name, controller_names())}")
    return entry


def controller_names() -> list[str]:
    """Names of all controllers, those of other packages included."""
    return [*CONTROLLERS, *added_names("controllers")]


def setting_names(*controllers: str) -> set[str]:
    """Names of all settings of the controllers of this package, and of the controllers that are named.

    Raises
    ------
    ValueError
        For an unknown controller.
    """
    entries = [*CONTROLLERS.values(), *(controller_entry(name) for name in controllers)]
    return {setting.name for entry in entries for setting in entry.settings}


def all_settings() -> dict[str, dict[str, Setting]]:
    """Setting name -> controller of this package -> its setting of the name."""
    settings: dict[str, dict[str, Setting]] = {}
    for entry in CONTROLLERS.values():
        for setting in entry.settings:
            settings.setdefault(setting.name, {})[entry.name] = setting
    return settings


def complete(
    controller: str, given: Mapping[str, object], patient: PatientEntry, operating_point: str, *, noisy: bool
) -> dict[str, Value]:
    """All settings of a controller: the given ones, and for the others those usual for the patient.

    Raises
    ------
    ValueError
        For an unknown controller, setting or operating point, or a value of the wrong type.
    """
    entry = controller_entry(controller)
    checked = {name: entry.setting(name).check(value) for name, value in given.items()}
    usual = patient.usual_settings(controller, operating_point)
    return {
        setting.name: checked.get(setting.name, usual.get(setting.name, setting.default).value(noisy=noisy))
        for setting in entry.settings
    }
