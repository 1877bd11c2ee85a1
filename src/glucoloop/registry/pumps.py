"""Catalogue of pumps: description, settings, limits, and place of the function that makes each.

A pump joins every command by one entry in `PUMPS`, or by the entry point of another package in the group
``glucoloop.pumps``. Its text is its name and its settings: ``expiring, samples=3``. Nothing here imports a numerical
library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Final

from glucoloop.refusal import Refusal
from glucoloop.registry.entries import PartCatalogue, PartEntry
from glucoloop.registry.fault_settings import ResolutionSettings
from glucoloop.registry.settings import About, known_names, settings_record

LIMITS: Final = (
    "max_change_mU_min",
    "min_insulin_mU_min",
    "max_insulin_mU_min",
    "pump_resolution_mU_min",
    "max_bolus_U",
    "min_bolus_U",
    "bolus_step_U",
)
"""Keys of a run that say what a pump can deliver."""


@dataclass(frozen=True, kw_only=True)
class PumpEntry(PartEntry):
    """A pump of the catalogue.

    Its function is also given, if it has parameters of these names, ``inner`` (a pump that only keeps the limits of the
    run), ``limits`` (`pumps.DoseLimits`), ``bolus`` (`pumps.BolusLimits`) and ``sample_time_min``.

    Raises
    ------
    ValueError
        For a limit that no run has.
    """

    kind: ClassVar = "pump"

    limits: Mapping[str, float] = field(default_factory=dict)
    """Limits of the pump by key, of `LIMITS`, where they are not those usual for the patient. With this pump they are
    the defaults of a run, so that controllers, guard and metrics know them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in self.limits:
            if key not in LIMITS:
                raise Refusal(f"the pump {self.name} has a limit {key!r}; {known_names(key, LIMITS)}")


@settings_record
class ExpiringSettings:
    """Settings of the pump `expiring`."""

    samples: Annotated[
        int,
        About(
            "Samples for which a command holds, the one in which it arrives included.",
            at_least=1,
            called="number of samples for which a command holds",
        ),
    ] = 2


PUMPS: Final = PartCatalogue(
    "pump",
    PumpEntry,
    (
        PumpEntry(name="limited", summary="keeps its limits", make="glucoloop.pumps:LimitedPump"),
        PumpEntry(
            name="resolution",
            summary="delivers whole steps of the rate, and the remainder later",
            make="glucoloop.pumps:with_resolution",
            record=ResolutionSettings,
        ),
        PumpEntry(
            name="expiring",
            summary="returns to the basal rate if no command arrives for some samples",
            make="glucoloop.pumps:expiring",
            record=ExpiringSettings,
        ),
    ),
    example="expiring, samples=3",
)
USUAL_PUMP: Final = "limited"
