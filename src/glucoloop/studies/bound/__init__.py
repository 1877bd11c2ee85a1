"""Bound: the best that any controller could do in a situation."""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final, Literal

from glucoloop.component.effects import Need
from glucoloop.component.setting import Option
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.studies.study import PlainStudy
from glucoloop.units import LONGEST_RUN_MIN

_LONGEST_MIN: Final = 7200.0
_MAX_KNOWN: Final = 20
_SQUARES: Final = Need("squares are minimised for --objective sse alone")
_bound = functools.partial(Option, panel="Bound")


class BoundRequest(Run):
    """A bound in a situation: the knowledge of the meals, and what is minimised."""

    kind: ClassVar = "bound"
    # what concerns controllers only
    refused: ClassVar = (
        *(
            "announce_meals",
            "announce_before_min",
            "carb_error_pct",
            "carb_bias_pct",
            "start",
            "metrics",
            "seed",
            "integrator",
            "faults",
        ),
        *("warm_up_min", "habits", "scenario", "rescue", "glucagon", "events", "actions", "changes", "forecasts"),
        *("controller", "guard", "model"),
    )

    known_after_min: Annotated[
        tuple[float, ...],
        _bound(
            "Time from the start of a meal until it is known; a dead time is added; a negative time is in advance. "
            "Repeat it for more.",
            default="0 and 10",
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
        float, _bound("Weight of squares below the setpoint, for sse.", above=0.0, at_most=1e6, needs=(_SQUARES,))
    ] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon_min > _LONGEST_MIN:
            raise Refusal(
                f"--duration is {self.horizon_min:g} min; give a number above 0 min and up to {_LONGEST_MIN:g} min"
            )
        if len(self.known_after_min) > _MAX_KNOWN:
            raise Refusal(f"--known-after has {len(self.known_after_min)} times; give at most {_MAX_KNOWN}")
        if not self.known_after_min and not self.in_advance and not self.hedged:
            raise Refusal("nothing is asked for; give --known-after or --in-advance, or one meal and --noise")

    def uses(self) -> frozenset[Need]:
        """Needs that the bound meets, which knows readings by their noise and their dead time."""
        return super().uses() | frozenset({_SQUARES} if self.objective == "sse" else ())

    @property
    def hedged(self) -> bool:
        """Whether the bound under sensor noise is computed: for one meal at steady state, and the largest deviation."""
        at_rest = self.setpoint_mg_dl is None and self.initial_glucose_mg_dl is None
        return self.noisy and len(self.meals) == 1 and at_rest and self.objective == "deviation"


BOUND: Final = PlainStudy(
    name="bound",
    what="a bound",
    help=(
        "Compute how closely any controller could hold glucose: the doses within the pump's limits with the minimum "
        "maximum deviation from the setpoint, for a patient and meals that are known exactly from a given time on.\n\n"
        "With --noise, also compute this for a controller that can learn only from the readings that a meal begins or "
        "ends, and prepares for both cases until it can know.\n\n"
        "  glucoloop bound\n\n"
        "  glucoloop bound --known-after 0 --known-after 20 --in-advance --out bound\n\n"
        "  glucoloop bound --noise 1.45\n\n"
        "  glucoloop bound --config bound/bound.toml"
    ),
    module="glucoloop.studies.bound.study",
    request=BoundRequest,
    summary="bound.json",
)
