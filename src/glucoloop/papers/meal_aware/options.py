"""Keys of a comparison of the controllers with the meal-aware one: its extent."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.limits import LARGEST_SEED

MOST_SEEDS: Final = 10_000
MOST_PEOPLE: Final = 100_000
QUICK: Final[dict[str, int | bool]] = {"seeds": 16, "people": 64, "bounds": False}

TUNING_SEEDS: Final = range(900_000, 900_200)
"""Seeds of the sensor on which the tuning of the meal-aware controller was chosen."""
TUNING_PEOPLE_SEED: Final = 424_242
"""Seed of the people on whom the tuning was chosen."""
MISMATCH_TUNING_SEED: Final = 1000
"""Seed of the people and of the noise on which the settings for a wrong model were chosen."""
EXTENT_PANEL: Final = "How much"
_extent = functools.partial(Key, panel=EXTENT_PANEL)


@dataclass(frozen=True, kw_only=True)
class ClaimsKeys:
    """Situations, number of runs, and the first seed."""

    only: Annotated[
        tuple[str, ...],
        _extent("A situation, or a group of them, to try in place of all; repeat it for more.", metavar="NAME"),
    ] = ()

    seeds: Annotated[
        int,
        _extent("Runs of each noisy situation.", told=f"200; quick: {QUICK['seeds']}", at_least=1, at_most=MOST_SEEDS),
    ] = 200
    people: Annotated[
        int, _extent("Number of people.", told=f"1000; quick: {QUICK['people']}", at_least=1, at_most=MOST_PEOPLE)
    ] = 1000
    seed: Annotated[
        int,
        _extent(
            "The first seed of the sensor, and that of the people; the same seed gives the same numbers.",
            at_least=0,
            at_most=LARGEST_SEED - MOST_SEEDS,
        ),
    ] = 1

    bounds: Annotated[
        bool,
        _extent(
            "Whether the best possible doses are found where a model is wrong, for the distance to them.",
            flag="--bounds/--no-bounds",
            told="yes; quick: no",
        ),
    ] = True

    @property
    def sensor_seeds(self) -> range:
        """Seeds of the sensor, as those of ``glucoloop run --seed``."""
        return range(self.seed, self.seed + self.seeds)

    @property
    def tuned_on(self) -> tuple[str, ...]:
        """Seeds and people of this comparison on which the tuning was chosen, in words; empty if there are none."""
        both = range(max(TUNING_SEEDS.start, self.seed), min(TUNING_SEEDS.stop, self.seed + self.seeds))
        found = []
        if len(both):
            found.append(f"seeds {both.start} to {both.stop - 1} of the sensor")
        if self.seed == TUNING_PEOPLE_SEED:
            found.append(f"the people of seed {self.seed}")
        if self.seed == MISMATCH_TUNING_SEED:
            found.append(f"the people and the noise of seed {self.seed}")
        return tuple(found)
