"""Situations in which the controllers are compared, and the extent of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, Field

from glucoloop.config.run import LARGEST_SEED, STRICT, checked

OURS: Final = "meal-mpc"
CONTROLLERS: Final = ("imc", "mpc", "mpc-se", "nlqdmc-se", OURS)
NAMES: Final = {
    "imc": "IMC",
    "mpc": "linear MPC",
    "mpc-se": "MPC/SE",
    "nlqdmc-se": "NLQDMC/SE",
    "meal-mpc": "meal-aware MPC",
}
NOISE_VARIANCE: Final = 1.45
MEAL: Final = "50g@50min"
HORIZON_MIN: Final = 600.0
OPERATING_POINT: Final = "setpoint-81"

MOST_SEEDS: Final = 10_000
MOST_PEOPLE: Final = 100_000
QUICK: Final[dict[str, int]] = {"seeds": 16, "people": 64}

TUNING_SEEDS: Final = range(900_000, 900_200)
"""Seeds of the sensor on which the tuning of the meal-aware controller was chosen."""
TUNING_PEOPLE_SEED: Final = 424_242
"""Seed of the people on whom the tuning was chosen."""


@dataclass(frozen=True)
class Situation:
    """Patient, meal and sensor, the same for all controllers."""

    name: str
    title: str
    runs: Literal["one", "seeds", "people"]
    """One run, one for each seed of the sensor, or one for each of many people."""
    keys: Mapping[str, Any] = field(default_factory=dict)
    """Flat configuration keys beyond those that all situations share."""
    oscillation: bool = False
    """Whether the controllers are also tried without noise, to see whether they oscillate."""
    bounded: bool = False
    """Whether the distance to the bound is reported."""

    def of(self, controller: str, seed: int) -> dict[str, Any]:
        """Flat keys of the run of one person."""
        shared = {"operating_point": OPERATING_POINT, "meals": [MEAL], "duration_min": HORIZON_MIN}
        return {**shared, **self.keys, "controller": controller, "seed": seed}

    @property
    def noisy(self) -> bool:
        """Whether readings carry noise."""
        return "noise_variance" in self.keys


_NOISE: Final = {"noise_variance": NOISE_VARIANCE}

SITUATIONS: Final = (
    Situation("noise-free", "Without noise", "one", bounded=True),
    Situation("noise", "With noise", "seeds", _NOISE, bounded=True),
    Situation(
        "dead-time-10",
        "With noise and a known dead time of 10 min",
        "seeds",
        {**_NOISE, "dead_time_min": 10.0, "known_dead_time": True},
        oscillation=True,
    ),
    Situation(
        "dead-time-15",
        "With noise and a known dead time of 15 min",
        "seeds",
        {**_NOISE, "dead_time_min": 15.0, "known_dead_time": True},
    ),
    Situation("announced", "Announced, without noise", "one", {"announce_meals": True}, bounded=True),
    Situation("people", "People, with noise", "people", _NOISE),
)


class Asked(BaseModel):
    """Number of runs, and the first seed."""

    model_config = STRICT

    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED - MOST_SEEDS)] = 1
    seeds: Annotated[int, Field(ge=1, le=MOST_SEEDS)] = 200
    people: Annotated[int, Field(ge=1, le=MOST_PEOPLE)] = 1000

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
        return tuple(found)


def read_asked(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Asked:
    """Read the extent of a comparison from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For an unknown key, or a value of the wrong type or out of bounds.
    """
    for key in keys:
        if key not in Asked.model_fields:
            raise ValueError(f"unknown key {key!r}; the known ones are: {', '.join(Asked.model_fields)}")
    return checked(Asked, dict(keys), names)
