"""Keys of a search of a grid."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.parts.guard import GUARD

MOST_SEEDS: Final = 1000
NOT_TUNED: Final = ("guard", *GUARD)
"""Settings of the guard, which are not tuned, since a search is for the controller in a sound loop."""
_grid = functools.partial(Key, panel="Grid")
_range = functools.partial(_grid, metavar="RANGE")


@dataclass(frozen=True, kw_only=True)
class RangeKeys:
    """Range of each parameter that is tuned; None for the usual one."""

    move_horizon: Annotated[str, _range("Numbers of planned moves, m.")] = "1:4"
    prediction_horizon: Annotated[str, _range("Numbers of predicted samples, p; those below m are left out.")] = "1:14"
    reference_filter: Annotated[
        str | None,
        _range(
            "Filters of the reference, φ_r; closer to 1 is slower.",
            told="; ".join(
                f"{entry.name}: {entry.reference_filters}" for entry in CONTROLLERS.values() if entry.reference_filters
            ),
        ),
    ] = None
    output_weight: Annotated[
        str | None, _range("Weights on the error of glucose, Γ_y; only the ratio to Γ_u matters.", told="the paper's")
    ] = None
    move_weight: Annotated[str | None, _range("Weight on each move of insulin, Γ_u.", told="the paper's")] = None


@dataclass(frozen=True, kw_only=True)
class GridKeys:
    """Other keys of a search that a run does not have."""

    seeds: Annotated[
        int | None,
        _grid(
            "Number of runs of each tuning with noise, another sensor or a fault, from --seed on.",
            told="5",
            at_least=1,
            at_most=MOST_SEEDS,
        ),
    ] = None
    top: Annotated[int, _grid("Number of tunings in the table.", at_least=1, at_most=100_000)] = 10
