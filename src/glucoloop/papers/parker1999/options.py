"""Keys of the reproduction: the parts of the paper, and the number of runs."""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final

from glucoloop.limits import LARGEST_SEED
from glucoloop.parts.part import Part
from glucoloop.situations.option import Option

POINTS: Final = ("setpoint-81", "nominal-22", "fasting-81")
SEEDS: Final = 60
QUICK_SEEDS: Final = 3
MOST_SEEDS: Final = 1000
_part = functools.partial(Option, panel="Parts of the paper")
_extent = functools.partial(Option, panel="How much")


class Reproduction(Part):
    """Parts of the paper that are reproduced, and the number of runs."""

    kind: ClassVar = "reproduction"

    operating_point: Annotated[
        tuple[str, ...],
        _part("One of its operating points; repeat it for more.", default="all"),
    ] = POINTS
    table: Annotated[
        tuple[str, ...], _part("Only this table, I or II; repeat it for both.", metavar="N", default="all")
    ] = ()
    figure: Annotated[
        tuple[str, ...], _part("Only this figure, 2 to 6; repeat it for more.", metavar="N", default="all")
    ] = ()
    seeds: Annotated[
        int | None,
        _extent(
            "Runs of each noisy experiment.", default=f"{SEEDS}; quick: {QUICK_SEEDS}", at_least=1, at_most=MOST_SEEDS
        ),
    ] = None
    seed: Annotated[
        int, _extent("The same seed gives the same numbers.", at_least=0, at_most=LARGEST_SEED - MOST_SEEDS)
    ] = 1
    quick: Annotated[bool, _extent("A quick look: few seeds, dead times up to 5 min, no tuning searches.")] = False

    @property
    def points(self) -> tuple[str, ...]:
        """Operating points, each once."""
        return tuple(dict.fromkeys(self.operating_point))

    @property
    def runs(self) -> int:
        """Number of runs of each noisy experiment."""
        return self.seeds or (QUICK_SEEDS if self.quick else SEEDS)
