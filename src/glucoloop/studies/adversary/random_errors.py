"""Errors of the same kind as the adversary's, but by chance, on many people: the measure of what a search finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glucoloop.studies.adversary.attack import Attack, Harm
from glucoloop.studies.adversary.space import ErrorSpace
from glucoloop.threefry import uniforms


@dataclass(frozen=True)
class RandomErrors:
    """What came of people whose sensors err by chance."""

    person: npt.NDArray[np.int64]
    """(n,)"""
    harm: Harm

    @property
    def ever_below_54_pct(self) -> float:
        """Of the people."""
        return 100.0 * float((self.harm.below_54_min > 0.0).mean()) if self.person.size else float("nan")


def random_points(space: ErrorSpace, seed: int, person: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Each person's own point of a space, ``(n, dimension)``, evenly drawn: of a seed and the person's number alone."""
    return np.stack([2.0 * uniforms(seed, "sensor error", person, i) - 1.0 for i in range(space.dimension)], axis=1)


def random_errors(attack: Attack, space: ErrorSpace, people: int, seed: int) -> RandomErrors:
    """Let the sensors of people err by chance.

    Parameters
    ----------
    attack : Attack
    space : ErrorSpace
        From which each person's errors are drawn evenly.
    people : int
        Of the population; those without a basal rate are left out.
    seed : int
    """
    person = attack.able(people)
    points = random_points(space, seed, person)
    return RandomErrors(person=person, harm=attack.on_people(person, space.errors(points), space.stuck_from(points)))
