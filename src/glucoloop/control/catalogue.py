"""The controllers by name."""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.control.basal_bolus import BasalBolus
from glucoloop.control.imc import IMC
from glucoloop.control.linear_mpc import LinearMPC
from glucoloop.control.loop_like import LoopLike
from glucoloop.control.meal_mpc import MealMPCSettings
from glucoloop.control.mpc_se import MPCSE
from glucoloop.control.nlqdmc_se import NLQDMC
from glucoloop.control.open_loop import OpenLoop
from glucoloop.control.oref0.controller import Oref0
from glucoloop.control.part import ControllerComponent
from glucoloop.control.pid import PID
from glucoloop.control.pid_ifb import PIDIFB
from glucoloop.control.profile_mpc import ProfileMPCSettings

CONTROLLERS: Final[Catalogue[ControllerComponent]] = Catalogue(
    ControllerComponent,
    (
        LinearMPC,
        MPCSE,
        NLQDMC,
        ProfileMPCSettings,
        MealMPCSettings,
        IMC,
        PID,
        BasalBolus,
        OpenLoop,
        Oref0,
        PIDIFB,
        LoopLike,
    ),
    example="mpc-se, move_horizon=2",
    unnamed=True,
)
DEFAULT_CONTROLLER: Final = CONTROLLERS.usual
TUNABLE: Final = tuple(entry.name for entry in CONTROLLERS.values() if entry.tunable)
"""Controllers of which `glucoloop tune` tries a grid."""
SEARCHED: Final = next(entry for entry in CONTROLLERS.values() if entry.searched)
"""The controller for which `glucoloop robust` searches a tuning."""
ESTIMATING: Final = next(entry for entry in CONTROLLERS.values() if hasattr(entry, "estimator"))
"""The controller whose estimators of meals `glucoloop detect` tries."""


controller_entry: Final = CONTROLLERS.find
"""Function that returns a controller by name: of this package, of another one, or ``module:attribute``."""
