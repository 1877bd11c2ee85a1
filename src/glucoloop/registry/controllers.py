"""Catalogue of controllers: description, settings, and place of the design.

A controller joins the command line, the configuration files and the comparisons by one entry in `CONTROLLERS`, or by
the entry point of another package in the group ``glucoloop.controllers``. The settings of an entry become keys of
configuration files, and those of `CONTROLLERS` options too. Nothing here imports a numerical library, so that help is
shown at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from glucoloop.refusal import Refusal
from glucoloop.registry.entries import Entry
from glucoloop.registry.patients import PatientEntry
from glucoloop.registry.plugins import Catalogue, loaded
from glucoloop.registry.ranges import Tuned
from glucoloop.registry.settings import Setting, Value

_TUNED: Final = ("move_horizon", "prediction_horizon", "output_weight", "move_weight")


@dataclass(frozen=True, kw_only=True)
class ControllerEntry(Entry):
    """Description of a controller that is available without designing it.

    Raises
    ------
    ValueError
        For a place that is not written as ``module:function``, a default that its setting does not allow, or a tunable
        controller without horizons and weights.
    """

    kind: ClassVar = "controller"

    design: str
    """Place ``module:function`` of the design. The function is called with a `control.design_case.DesignCase`, and with
    the record of settings if there is one, and returns a controller.
    """
    uses_model: bool = True
    """Whether it is designed on an identified model; if not, none is identified for it."""
    individual: str | None = "glucoloop.experiments.individual:one_by_one"
    """Place ``module:function`` of the design for each person of a trial, see
    `experiments.individual.individual_design`; None for a controller that is the same for all people.
    """
    tunable: bool = False
    """Whether `glucoloop tune` tries a grid of it: it has the settings of a predictive controller, and `horizons` and
    `padded` as `control.LinearMPC` has them."""
    reference_filters: str | None = None
    """Range of the setting ``reference_filter`` that `glucoloop tune` tries unless another one is given, like
    ``.3:.8:.05``; without it, the usual value alone."""
    gives_boluses: bool = False
    """Whether it decides on boluses too; the controller then has ``gives_boluses = True`` as well."""
    slow: bool = False
    """Whether a decision takes so long that studies of many loops use fewer and shorter ones with this controller."""
    searched: tuple[Tuned, ...] = ()
    """Settings that `glucoloop robust` can search, with their usual ranges."""
    estimator_settings: tuple[str, ...] = ()
    """Settings of the estimator of unknown meals in the controller, which `glucoloop detect` tries. The controller then
    has a setting ``estimator``, and a ``model`` and an ``estimator`` as `control.MealMPC` has them.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        lacking = set(_TUNED) - {setting.name for setting in self.settings} if isinstance(self.record, type) else set()
        if self.tunable and lacking:
            raise Refusal(f"the controller {self.name} cannot be tunable: it has no setting {min(lacking)!r}")

    @property
    def places(self) -> tuple[object, ...]:
        """Names of functions, each to be written as ``module:function``."""
        return self.design, self.individual

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
        """Function that designs the controller for each person; None if it is the same for all people.

        Raises
        ------
        ValueError
            If there is no such function.
        """
        return None if self.individual is None else loaded(self.individual)


CONTROLLERS: Final = Catalogue(
    "controller",
    ControllerEntry,
    (
        ControllerEntry(
            name="mpc",
            summary="linear model predictive control on the identified step response",
            design="glucoloop.control.linear_mpc:design",
            record="glucoloop.control.settings:LinearMPCSettings",
            individual="glucoloop.experiments.individual:linear_mpc",
            tunable=True,
        ),
        ControllerEntry(
            name="mpc-se",
            summary="linear MPC with a Kalman filter on the linearised patient",
            design="glucoloop.control.mpc_se:design",
            record="glucoloop.control.settings:MPCSESettings",
            uses_model=False,
            individual="glucoloop.experiments.individual:mpc_se",
            tunable=True,
            reference_filters=".3:.8:.05",
        ),
        ControllerEntry(
            name="nlqdmc-se",
            summary="predictive control on the nonlinear patient, linearised anew at each sample, with a Kalman filter",
            design="glucoloop.control.nlqdmc_se:design",
            record="glucoloop.control.settings:NLQDMCSettings",
            uses_model=False,
            tunable=True,
            reference_filters=".3:.5:.1,.57,.7,.8",  # half as many, since its loops take a hundred times as long
            slow=True,
        ),
        ControllerEntry(
            name="meal-mpc",
            summary="predictive control on the nonlinear patient that estimates meals nobody announced",
            design="glucoloop.control.meal_mpc:design",
            record="glucoloop.control.settings:MealMPCSettings",
            uses_model=False,
            individual="glucoloop.experiments.individual_meal_mpc:individual_meal_mpc",
            slow=True,
            searched=(
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
            ),
            estimator_settings=(
                "meal_horizon",
                "fast_horizon",
                "meals_per_h",
                "meals_by_time",
                "mean_carbs_g",
                "fast_meals",
                "ends_unseen",
                "disturbance_variance",
                "largest_disturbance_mg_min",
                "measurement_variance",
                "noise_pace",
                "noise_patience",
                "failures_per_h",
                "failure_min",
                "sensor_lag_min",
            ),
        ),
        ControllerEntry(
            name="imc",
            summary="internal model control with a filter, on a first-order model with dead time",
            design="glucoloop.control.imc:design",
            record="glucoloop.control.settings:IMCSettings",
            uses_model=False,
        ),
        ControllerEntry(
            name="pid",
            summary="PID whose integral waits at limits, tuned on a first-order model with dead time",
            design="glucoloop.control.pid:design",
            record="glucoloop.control.settings:PIDSettings",
            uses_model=False,
        ),
        ControllerEntry(
            name="basal-bolus",
            summary="basal rate, and boluses for announced meals and against high glucose, by the usual formula",
            design="glucoloop.control.basal_bolus:design",
            record="glucoloop.control.settings:BasalBolusSettings",
            uses_model=False,
            individual="glucoloop.experiments.individual:by_basal_rate",
            gives_boluses=True,
        ),
        ControllerEntry(
            name="basal",
            summary="no controller: the rate at which the loop starts",
            design="glucoloop.control.open_loop:design",
            uses_model=False,
            individual=None,
        ),
    ),
)


USUAL_CONTROLLER: Final = "mpc"
TUNABLE: Final = tuple(entry.name for entry in CONTROLLERS.values() if entry.tunable)
"""Controllers of which `glucoloop tune` tries a grid."""
SEARCHED: Final = next(entry for entry in CONTROLLERS.values() if entry.searched)
"""The controller for which `glucoloop robust` searches a tuning."""
ESTIMATING: Final = next(entry for entry in CONTROLLERS.values() if entry.estimator_settings)
"""The controller whose estimators of meals `glucoloop detect` tries."""


controller_entry: Final = CONTROLLERS.find
"""Function that returns a controller by name: of this package, of another one, or ``module:attribute``."""
controller_names: Final = CONTROLLERS.names
"""Function that returns the names of all controllers, those of other packages included."""


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
    """Settings of this package's controllers by setting name, then by controller."""
    settings: dict[str, dict[str, Setting]] = {}
    for entry in CONTROLLERS.values():
        for setting in entry.settings:
            settings.setdefault(setting.name, {})[entry.name] = setting
    return settings


def complete(
    controller: str, given: Mapping[str, object], patient: PatientEntry, operating_point: str, *, noisy: bool
) -> dict[str, Value]:
    """All settings of a controller: the given ones, and the usual ones of the patient for the others.

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
