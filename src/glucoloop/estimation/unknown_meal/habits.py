"""Prior knowledge of meals: how often they begin, and how large they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from glucoloop.arguments import checked
from glucoloop.meals.stomach import SERVED_G_PER_MIN


@checked
@dataclass(frozen=True)
class MealHabits:
    """Prior of meals: they begin with the same probability at any time, and so do they end once they have begun.

    Parameters
    ----------
    meals_per_h : float
        Expected number of meals in an hour, above 0. A higher figure makes an estimator quicker and less certain.
    mean_carbs_g : float
        Mean size, above 0.

    Raises
    ------
    ValueError
        Outside these bounds.
    """

    meals_per_h: float = 0.57
    mean_carbs_g: float = 24.0

    def __post_init__(self) -> None:
        for value, what in ((self.meals_per_h, "meals per hour"), (self.mean_carbs_g, "g of a mean meal")):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{value:g} {what} are not possible; give a finite value above 0")

    def begins(self, sample_time_min: float) -> float:
        """Probability that a meal begins in a sample."""
        return -math.expm1(-self.meals_per_h * sample_time_min / 60.0)

    def ends(self, sample_time_min: float) -> float:
        """Probability that a meal under way ends in a sample."""
        return -math.expm1(-SERVED_G_PER_MIN * sample_time_min / self.mean_carbs_g)
