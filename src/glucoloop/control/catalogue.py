"""The controllers by name."""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.control.part import ControllerComponent

CONTROLLERS: Final = Catalogue(
    ControllerComponent,
    {
        "mpc": "glucoloop.control.linear_mpc:LinearMPC",
        "mpc-se": "glucoloop.control.mpc_se:MPCSE",
        "nlqdmc-se": "glucoloop.control.nlqdmc_se:NLQDMC",
        "profile-mpc": "glucoloop.control.profile_mpc:ProfileMPC",
        "therapy-mpc": "glucoloop.control.therapy_mpc:TherapyMPC",
        "meal-mpc": "glucoloop.control.meal_mpc:MealMPC",
        "imc": "glucoloop.control.imc:IMC",
        "pid": "glucoloop.control.pid:PID",
        "basal-bolus": "glucoloop.control.basal_bolus:BasalBolus",
        "basal": "glucoloop.control.open_loop:OpenLoop",
        "oref0": "glucoloop.control.oref0.controller:Oref0",
        "pid-ifb": "glucoloop.control.pid_ifb:PIDIFB",
        "loop-like": "glucoloop.control.loop_like:LoopLike",
    },
    example="mpc-se, move_horizon=2",
    unnamed=True,
)
DEFAULT_CONTROLLER: Final = CONTROLLERS.default
ESTIMATING: Final = "meal-mpc"
"""The controller whose estimators of meals `glucoloop detect` tries."""
SEARCHED: Final = "meal-mpc"
"""The controller for which `glucoloop robust` searches a tuning."""
controller_entry: Final = CONTROLLERS.find
"""Function that returns a controller by name: of this package, of another one, or ``module:attribute``."""


def tunable() -> tuple[str, ...]:
    """Controllers of which `glucoloop tune` tries a grid."""
    return tuple(name for name, entry in CONTROLLERS.items() if entry.tunable)
