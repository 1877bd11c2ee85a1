"""Keys that several studies share, and the usual controllers of a study with a guard."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from glucoloop.config.key import Key
from glucoloop.config.options.case import GUARD_PANEL

PAPER_CONTROLLERS: Final = ("imc", "mpc", "mpc-se", "nlqdmc-se")
PAPER_MEAL: Final = ["50g@50min"]
Guards = Literal["both", "with", "without"]
GuardsKey = Annotated[
    Guards, Key("Whether controllers are tried with a guard, without one, or both.", panel=GUARD_PANEL)
]
