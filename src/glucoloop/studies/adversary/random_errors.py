"""Random errors of the same kind as the adversary's, on many people, as a comparison for the result of a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glucoloop.studies.adversary.attack import Attack, Harm
from glucoloop.studies.adversary.space import ErrorSpace
from glucoloop.threefry import uniforms


@dataclass(frozen=True)
class RandomErrors:
    """Results of people whose sensors have random errors."""

    person: npt.NDArray[np.int64]
    """(n,) numbers of the people."""
    harm: Harm

    @property
    def ever_below_54_pct(self) -> float:
        """Percentage of the people who were ever below 54 mg/dl."""
        return 100.0 * float((self.harm.below_54_min > 0.0).mean()) if self.person.size else float("nan")


def random_points(space: ErrorSpace, seed: int, person: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Each person's own point of a space, ``(n, dimension)``, drawn uniformly from a seed and the person's number."""
    return np.stack([2.0 * uniforms(seed, "sensor error", person, i) - 1.0 for i in range(space.dimension)], axis=1)


def random_errors(attack: Attack, space: ErrorSpace, people: int, seed: int) -> RandomErrors:
    """Simulate people whose sensors have random errors.

    Parameters
    ----------
    attack : Attack
    space : ErrorSpace
        Space from which each person's errors are drawn uniformly.
    people : int
        Number of people of the population; those without a basal rate are left out.
    seed : int
    """
    person = attack.feasible(people)
    points = random_points(space, seed, person)
    return RandomErrors(person=person, harm=attack.on_people(person, space.errors(points), space.stuck_from(points)))
