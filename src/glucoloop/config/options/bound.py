"""Keys of a bound: the situation, and the times at which its meals become known."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from glucoloop.config.key import Key
from glucoloop.config.options.situation import RUN_PANEL, SituationKeys
from glucoloop.limits import LONGEST_RUN_MIN
from glucoloop.plausible import DURATION

NOT_OF_A_BOUND: Final = (
    "announce_meals",
    "metrics",
    "carb_error_pct",
    "carb_bias_pct",
    "start",
    "noise_bound_mg_dl",
    "site",
    "pump",
    "pump_resolution_mU_min",
    "max_bolus_U",
    "min_bolus_U",
    "bolus_step_U",
    "faults",
    "seed",
    "integrator",
)
"""Keys of a situation that concern controllers only."""
_bound = functools.partial(Key, panel="Bound")


@dataclass(frozen=True, kw_only=True)
class BoundKeys(SituationKeys):
    """Situation as of a run, without a controller, and the knowledge of the meals."""

    duration_min: Annotated[
        float, Key("Length of the run.", panel=RUN_PANEL, above=0.0, at_most=7200.0, quantity=DURATION)
    ] = 600.0
    known_after_min: Annotated[
        tuple[float, ...],
        _bound(
            "Time from the start of a meal until it is known; a dead time is added; a negative time is in advance. "
            "Repeat it for more.",
            told="0 and 10",
            at_least=-LONGEST_RUN_MIN,
            at_most=LONGEST_RUN_MIN,
        ),
    ] = (0.0, 10.0)
    in_advance: Annotated[bool, _bound("Also for all meals known from the start of the run.")] = False
    objective: Annotated[
        Literal["deviation", "undershoot", "peak", "sse"],
        _bound(
            "Quantity that is minimised: the largest deviation to either side; the undershoot, then the peak; the "
            "peak, then the undershoot; the sum of squared deviations."
        ),
    ] = "deviation"
    undershoot_weight: Annotated[
        float, _bound("Weight of squares below the setpoint, for sse.", above=0.0, at_most=1e6)
    ] = 1.0

    @property
    def hedged(self) -> bool:
        """Whether the bound under sensor noise is computed: for one meal at rest, and the largest deviation."""
        elsewhere = self.setpoint_mg_dl is not None or self.initial_glucose_mg_dl is not None
        return self.noisy and len(self.meals) == 1 and not elsewhere and self.objective == "deviation"
