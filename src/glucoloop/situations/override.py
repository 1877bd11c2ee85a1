"""Overrides: hours of each day with another target and another need of insulin, as a person sets for sport or illness.

An override of p percent multiplies the basal rate by p / 100 and divides carbohydrate ratio and correction factor by
it, as overrides of Loop and profile switches of AndroidAPS do. Hours are those of every day of a run.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import PROFILE
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.therapy import TARGET, TherapyChange
from glucoloop.unit_guess import SETPOINT
from glucoloop.units import MIN_PER_DAY

_ALL: Final = 100.0


class OverrideComponent(Component):
    """Declaration of an override: its hours, its target and the need of insulin in them."""

    kind: ClassVar = "override"

    from_min: Annotated[float, About("Time of day at which it begins, like 17h.", at_least=0.0, below=MIN_PER_DAY)] = (
        0.0
    )
    to_min: Annotated[
        float,
        About("Time of day at which it ends, on the next day if that is earlier.", at_least=0.0, at_most=MIN_PER_DAY),
    ] = MIN_PER_DAY
    target_mg_dl: Annotated[
        float | None, About("Target; that without it by default.", at_least=60.0, at_most=300.0, quantity=SETPOINT)
    ] = None
    insulin_pct: Annotated[
        float,
        About(
            "Basal rate, and insulin for meals and corrections, in percent.",
            at_least=10.0,
            at_most=1000.0,
            needs=(PROFILE,),
        ),
    ] = _ALL

    def __post_init__(self) -> None:
        if self.from_min == self.to_min:
            raise Refusal(
                f"the override {self.name} begins and ends at {self.from_min:g} min; give two different times"
            )

    def changes(self) -> tuple[TherapyChange, ...]:
        """Changes of a therapy that it stands for."""
        hours, share = (self.from_min, self.to_min), self.insulin_pct / _ALL
        result = (
            []
            if self.target_mg_dl is None
            else [TherapyChange(TARGET, *hours, value=self.target_mg_dl, temporary=True)]
        )
        if share != 1.0:
            result.append(TherapyChange("basal_mU_min", *hours, factor=share))
            result += [
                TherapyChange(field, *hours, factor=1.0 / share) for field in ("carb_ratio_g_U", "correction_mg_dl_U")
            ]
        return tuple(result)


class Override(OverrideComponent, name="override"):
    """Another target or need of insulin for any reason."""


class ExerciseOverride(OverrideComponent, name="exercise"):
    """Exercise, with a target of 150 mg/dl until another one is given."""

    target_mg_dl: float | None = 150.0


class IllnessOverride(OverrideComponent, name="illness"):
    """Illness, with 20 % more insulin until another number is given."""

    insulin_pct: float = 120.0


OVERRIDES: Final = Catalogue(
    OverrideComponent,
    {
        "override": "glucoloop.situations.override:Override",
        "exercise": "glucoloop.situations.override:ExerciseOverride",
        "illness": "glucoloop.situations.override:IllnessOverride",
    },
    example="exercise, from=17h, to=19h",
    unnamed=True,
)
