"""Trials whose controllers are tried with a guard, without one, or both: what several studies ask for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop.component.effects import Need
from glucoloop.component.request import Request
from glucoloop.component.setting import CONTROLLER_PANEL, Option
from glucoloop.control.guard_settings import GuardSettings, guard_of
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.trials.trial import Trial

_GUARD: Final = Need("controllers are tried without a guard alone")
PAPER_CONTROLLERS: Final = ("imc", "mpc", "mpc-se", "nlqdmc-se")
PAPER_MEAL: Final = ("50g@50min",)
Guards = Literal["both", "with", "without"]
GuardsSetting = Annotated[
    Guards, Option("Whether controllers are tried with a guard, without one, or both.", panel=CONTROLLER_PANEL)
]
WITH_GUARD: Final[Mapping[Guards, tuple[bool, ...]]] = {"both": (False, True), "with": (True,), "without": (False,)}
"""Whether there is a guard, for each time that a controller is tried."""


class GuardedTrial(Trial):
    """A trial whose controllers are tried with a guard, without one, or both; `guard` has the settings of the guard."""

    kind: ClassVar = "guarded trial"
    refused: ClassVar[tuple[str, ...]] = ("traces", "metrics")

    guard: Annotated[
        Request[GuardSettings] | None,
        Option(
            "Settings of the guard, like 'max_on_board=2'; by default those of the patient.",
            panel=CONTROLLER_PANEL,
            alone="usual",
            needs=(_GUARD,),
        ),
    ] = None
    guards: GuardsSetting = "both"

    def uses(self) -> frozenset[Need]:
        """Needs that the trial meets; by its guard, where there is one."""
        guard = GuardSettings().uses() | {_GUARD} if self.guards != "without" else frozenset()
        return super().uses() | guard

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults; a guard that is left out is refused."""
        if any(part.explicit.get("guard", part) is None for part in (request, *request.value("controller"))):
            raise Refusal("--guard is none; let --guards say whether there is one, like --guards without")
        return super().defaults_of(request, defaults)

    def with_guard(self, case: Case, guarded: bool) -> Case:
        """A controller with the guard that it has of its own or with that of all, or without one."""
        guard = case.guard or guard_of(self.patient, self.guard)
        return dataclasses.replace(case, guard=guard if guarded else None)

    @property
    def base(self) -> Trial:
        """The trial without a guard and without faults."""
        return self.with_cases(tuple(self.with_guard(case, False) for case in self.cases), faults=())
