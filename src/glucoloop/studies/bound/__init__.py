"""Bound: the best that any controller could do in a situation."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from glucoloop.config.key import Key, declared
from glucoloop.config.options.situation import SituationKeys
from glucoloop.limits import LONGEST_RUN_MIN
from glucoloop.studies.study import PlainStudy

_OF_CONTROLLERS: Final = (
    *("announce_meals", "carb_error_pct", "carb_bias_pct", "start", "metrics", "seed", "integrator", "faults"),
    *("noise_bound_mg_dl", "site", "pump", "pump_resolution_mU_min", "max_bolus_U", "min_bolus_U", "bolus_step_U"),
)
TAKEN: Final = tuple(key for key in declared(SituationKeys) if key not in _OF_CONTROLLERS)
"""Keys of a situation that do not concern controllers only."""
_bound = functools.partial(Key, panel="Bound")


@dataclass(frozen=True, kw_only=True)
class BoundSettings:
    """Keys of a bound that a run does not have: the knowledge of the meals, and what is minimised."""

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


BOUND: Final = PlainStudy(
    name="bound",
    what="a bound",
    help=(
        "Compute how closely any controller could hold glucose: the doses within the pump's limits with the least "
        "maximum deviation from the setpoint, for a patient and meals that are known exactly from a given time on.\n\n"
        "With --noise, also compute this for a controller that can learn only from the readings that a meal begins or "
        "ends, and prepares for both cases until it can know.\n\n"
        "  glucoloop bound\n\n"
        "  glucoloop bound --known-after 0 --known-after 20 --in-advance --out bound\n\n"
        "  glucoloop bound --noise 1.45\n\n"
        "  glucoloop bound --config bound/bound.toml"
    ),
    module="glucoloop.studies.bound.study",
    settings=(BoundSettings,),
    taken=TAKEN,
    summary="bound.json",
)
