"""Trials whose controllers are tried with a guard, without one, or both: what several studies ask for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, ClassVar, Final, Literal

from glucoloop.cohorts.trial import Trial
from glucoloop.parts.guard import GuardSettings, guard_of
from glucoloop.situations.case import Case
from glucoloop.situations.option import CONTROLLER_PANEL, Option

PAPER_CONTROLLERS: Final = ("imc", "mpc", "mpc-se", "nlqdmc-se")
PAPER_MEAL: Final = ("50g@50min",)
Guards = Literal["both", "with", "without"]
GuardsSetting = Annotated[
    Guards, Option("Whether controllers are tried with a guard, without one, or both.", panel=CONTROLLER_PANEL)
]
WITH_GUARD: Final[Mapping[Guards, tuple[bool, ...]]] = {"both": (False, True), "with": (True,), "without": (False,)}
"""Whether there is a guard, for each time that a controller is tried."""


class GuardedTrial(Trial):
    """A trial whose controllers are tried with a guard, without one, or both; `guard` holds the settings of all."""

    kind: ClassVar = "guarded trial"
    refused: ClassVar[tuple[str, ...]] = ("traces", "metrics")

    guards: GuardsSetting = "both"

    @property
    def limits_of_guard(self) -> GuardSettings:
        """All settings of the guard."""
        return guard_of(self.patient, self.guard)

    @property
    def bare_cases(self) -> tuple[Case, ...]:
        """The controllers without a guard."""
        return tuple(dataclasses.replace(case, guard=None) for case in self.cases)

    @property
    def base(self) -> Trial:
        """The trial without a guard and without faults."""
        return self.with_cases(self.bare_cases, faults=())
