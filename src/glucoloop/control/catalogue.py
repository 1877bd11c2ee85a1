"""The controllers by name, and what is usual for each with a patient."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from glucoloop.control.settings import (
    BasalBolusSettings,
    BasalSettings,
    IMCSettings,
    LinearMPCSettings,
    MealMPCSettings,
    MPCSESettings,
    NLQDMCSettings,
    PIDSettings,
)
from glucoloop.parts.catalogue import Catalogue
from glucoloop.parts.controllers import ControllerPart
from glucoloop.parts.patients import PatientEntry
from glucoloop.parts.setting import Setting, Value

CONTROLLERS: Final[Catalogue[ControllerPart]] = Catalogue(
    ControllerPart,
    (
        LinearMPCSettings,
        MPCSESettings,
        NLQDMCSettings,
        MealMPCSettings,
        IMCSettings,
        PIDSettings,
        BasalBolusSettings,
        BasalSettings,
    ),
    example="mpc-se, move_horizon=2",
)
USUAL_CONTROLLER: Final = CONTROLLERS.usual
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
    return {name for entry in entries for name in entry.settings()}


def all_settings() -> dict[str, dict[str, Setting]]:
    """Settings of this package's controllers by setting name, then by controller."""
    settings: dict[str, dict[str, Setting]] = {}
    for entry in CONTROLLERS.values():
        for setting in entry.settings().values():
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
        for setting in entry.settings().values()
    }
