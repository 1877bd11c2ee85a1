"""Situations in which the controllers are compared, and the extent of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from glucoloop.config.key import declared
from glucoloop.papers.meal_aware.mismatches import GROUPS, MISMATCHES, Mismatch
from glucoloop.papers.meal_aware.options import ClaimsKeys
from glucoloop.parts.setting import refuse_unknown_keys
from glucoloop.refusal import Refusal

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


@dataclass(frozen=True)
class NamedSituation:
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

    def of_people(self, controller: str, seed: int, people: int) -> dict[str, Any]:
        """Flat keys of the trial of many people."""
        keys = {key: value for key, value in self.of(controller, seed).items() if key != "controller"}
        return {**keys, "population": "parker2000", "people": people, "controllers": [controller]}

    @property
    def noisy(self) -> bool:
        """Whether readings carry noise."""
        return "noise_variance" in self.keys


_NOISE: Final = {"noise_variance": NOISE_VARIANCE}

SITUATIONS: Final = (
    NamedSituation("noise-free", "Without noise", "one", bounded=True),
    NamedSituation("noise", "With noise", "seeds", _NOISE, bounded=True),
    NamedSituation(
        "dead-time-10",
        "With noise and a known dead time of 10 min",
        "seeds",
        {**_NOISE, "dead_time_min": 10.0, "known_dead_time": True},
        oscillation=True,
        bounded=True,
    ),
    NamedSituation(
        "dead-time-15",
        "With noise and a known dead time of 15 min",
        "seeds",
        {**_NOISE, "dead_time_min": 15.0, "known_dead_time": True},
        bounded=True,
    ),
    NamedSituation("announced", "Announced, without noise", "one", {"announce_meals": True}, bounded=True),
    NamedSituation("people", "People, with noise", "people", _NOISE),
)


CHOICES: Final = (*(situation.name for situation in SITUATIONS), *GROUPS)
"""Names of situations and of groups of them."""


def read_asked(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> ClaimsKeys:
    """Read the extent of a comparison from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or an unknown situation.
    """
    from glucoloop.config.checked import checked  # late, so that help is shown at once

    refuse_unknown_keys(keys, declared(ClaimsKeys))
    asked = checked(ClaimsKeys, dict(keys), names)
    for name in asked.only:
        if name not in CHOICES:
            called = (names or {}).get("only", "only")
            raise Refusal(f"{called} is {name!r}, which is no situation; the known ones are: {', '.join(CHOICES)}")
    return asked


def situations_of(asked: ClaimsKeys) -> tuple[NamedSituation, ...]:
    """The situations that are asked for."""
    return tuple(situation for situation in SITUATIONS if not asked.only or situation.name in asked.only)


def mismatches_of(asked: ClaimsKeys) -> tuple[Mismatch, ...]:
    """The situations asked for in which the controller's model is wrong."""
    return tuple(row for row in MISMATCHES if not asked.only or row.group in asked.only)
