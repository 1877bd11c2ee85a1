"""Meals of a day, repeated daily, their variation between people and days, and errors of counting carbohydrate."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from glucoloop.arguments import checked
from glucoloop.limits import LONGEST_RUN_MIN, MOST_DAYS
from glucoloop.meals.protocol import Eaten
from glucoloop.meals.scenario import LARGEST_MEAL_G, Meal, eaten, in_order
from glucoloop.refusal import Refusal
from glucoloop.threefry import checked_counter, checked_people, uniforms
from glucoloop.units import MIN_PER_DAY

MOST_MEALS_A_DAY: Final = 100
DAY: Final = 1 << 16  # between the random numbers of one day and of the next


@checked
@dataclass(frozen=True)
class MealPlan:
    """Meals of a day, repeated daily, with their variation.

    Parameters
    ----------
    meals : iterable of Meal
        Meals of one day; times count from its start.
    days : int
        Number of days.
    size_spread_pct : float
        Carbohydrate is uniform within this percentage of each meal's own, drawn anew for every person and meal.
    time_spread_min : float
        The time of each meal is uniform within these minutes, drawn likewise.
    horizon_min : float, optional
        Length of the run; the days by default. A run of one day may be shorter or longer than 24 h.
    own : callable, optional
        Function of a seed and of persons ``(n,)`` that gives the day of each as `Eaten`, ``(meals, n)`` with as many
        meals as the plan, which then says what is eaten on average.

    Raises
    ------
    ValueError
        For days, spreads or a horizon out of bounds, or a meal that can be too large, or begin before its day or
        after the end of it or of the run.
    """

    meals: tuple[Meal, ...]
    days: int
    size_spread_pct: float
    time_spread_min: float
    horizon_min: float
    own: Callable[[int, npt.ArrayLike], Eaten] | None

    def __init__(
        self,
        meals: Iterable[Meal],
        days: int = 1,
        *,
        size_spread_pct: float = 0.0,
        time_spread_min: float = 0.0,
        horizon_min: float | None = None,
        own: Callable[[int, npt.ArrayLike], Eaten] | None = None,
    ) -> None:
        if not 1 <= days <= MOST_DAYS:
            raise Refusal(f"days is {days!r}; give a whole number from 1 to {MOST_DAYS}")
        whole = days * MIN_PER_DAY
        object.__setattr__(self, "meals", in_order(meals))
        object.__setattr__(self, "days", days)
        object.__setattr__(self, "own", own)
        object.__setattr__(self, "size_spread_pct", float(size_spread_pct))
        object.__setattr__(self, "time_spread_min", float(time_spread_min))
        object.__setattr__(self, "horizon_min", whole if horizon_min is None else float(horizon_min))
        if not 0.0 < self.horizon_min <= LONGEST_RUN_MIN:
            raise Refusal(
                f"a horizon of {self.horizon_min:g} min is not possible; "
                f"give more than 0 and at most {LONGEST_RUN_MIN:g} min"
            )
        if days > 1 and self.horizon_min != whole:
            raise Refusal(
                f"a horizon of {self.horizon_min:g} min is not that of {days} days; leave it out, or give {whole:g} min"
            )
        self._check_spreads()

    def _check_spreads(self) -> None:
        if not 0.0 <= self.size_spread_pct < 100.0:
            raise Refusal(f"a spread of meals of {self.size_spread_pct:g} % is not possible; give 0 to below 100 %")
        if not 0.0 <= self.time_spread_min < MIN_PER_DAY:
            raise Refusal(
                f"a spread of meal times of {self.time_spread_min:g} min is not possible; "
                f"give 0 to below {MIN_PER_DAY:g} min"
            )
        if len(self.meals) > MOST_MEALS_A_DAY:
            raise Refusal(f"{len(self.meals)} meals a day are too many; give at most {MOST_MEALS_A_DAY}")
        end = self.day_min
        for meal in self.meals:
            if meal.t_min >= end:
                raise Refusal(
                    f"the meal at {meal.t_min:g} min begins after the {'day' if self.days > 1 else 'run'} ends at "
                    f"{end:g} min; move the meal" + ("" if self.days > 1 else " or lengthen the run")
                )
            early, late = meal.t_min - self.time_spread_min, meal.t_min + self.time_spread_min
            if early < 0.0 or late > end:
                raise Refusal(
                    f"the meal at {meal.t_min:g} min can begin at {early if early < 0.0 else late:g} min, which is "
                    f"{'before the start' if early < 0.0 else f'after the end at {end:g} min'}; "
                    f"give a spread of at most {min(meal.t_min, end - meal.t_min):g} min, or move the meal"
                )
            largest = meal.carbs_g * (1.0 + self.size_spread_pct / 100.0)
            if largest > LARGEST_MEAL_G:
                raise Refusal(
                    f"the meal of {meal.carbs_g:g} g can be {largest:g} g; give at most {LARGEST_MEAL_G:g} g "
                    "with its spread"
                )

    @property
    def day_min(self) -> float:
        """Length of the repeated part: a day, or a run of another length."""
        return MIN_PER_DAY if self.days > 1 else self.horizon_min

    @property
    def varies(self) -> bool:
        """Whether meals differ between people."""
        differ = self.own is not None or self.size_spread_pct > 0.0 or self.time_spread_min > 0.0
        return bool(self.meals) and differ

    def nominal(self) -> tuple[Meal, ...]:
        """All meals of the run, without their variation."""
        return tuple(
            dataclasses.replace(meal, t_min=day * MIN_PER_DAY + meal.t_min)
            for day in range(self.days)
            for meal in self.meals
        )


def draw_meals(plan: MealPlan, seed: int, person: npt.ArrayLike) -> Eaten:
    """Draw the meals of given persons.

    Parameters
    ----------
    seed, person
        As for `patients.virtual_people`.

    Returns
    -------
    Eaten
        ``(meals, n)``, day by day. A meal of a person is the same whoever else is drawn, and however many days follow.
        Without a spread all have exactly the plan's own.

    Raises
    ------
    ValueError
        For a seed or a person that does not exist.
    """
    people = checked_people(person)
    checked_counter("seed", seed)
    nominal = plan.nominal()
    if plan.own is None:
        same = eaten(nominal)
        t_min, carbs_g, eating_min = (
            np.repeat(np.asarray(of_meals)[:, None], people.size, axis=1)
            for of_meals in (same.t_min, same.carbs_g, same.eating_min)
        )
    else:
        own = plan.own(seed, people)
        t_min, carbs_g, eating_min = (
            np.tile(np.asarray(of_day), (plan.days, 1)) for of_day in (own.t_min, own.carbs_g, own.eating_min)
        )
        t_min += MIN_PER_DAY * np.repeat(np.arange(plan.days), len(plan.meals))[:, None]
    for row in range(len(nominal)):
        day, which = divmod(row, len(plan.meals))
        index = day * DAY + which
        if plan.time_spread_min > 0.0:
            t_min[row] += plan.time_spread_min * (2.0 * uniforms(seed, "meal time", people, index) - 1.0)
        if plan.size_spread_pct > 0.0:
            carbs_g[row] *= 1.0 + plan.size_spread_pct / 100.0 * (
                2.0 * uniforms(seed, "meal size", people, index) - 1.0
            )
    return Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min)


Array = npt.NDArray[Any]


def counted_g(
    carbs_g: Array, seed: int, person: npt.ArrayLike, *, error_pct: float, bias_pct: float, meals_a_day: int
) -> Array:
    """Carbohydrate of meals as people count it, ``(meals, people)``, from what is eaten day by day.

    Each person's error is drawn for each meal: ``carbs (1 + bias + error z)`` with a standard normal z, from 0 to 1000
    g. The count of a meal is the same whoever else is drawn, and however many days follow.
    """
    counted = np.empty_like(carbs_g, dtype=float)
    for row, true_g in enumerate(carbs_g):
        day, which = divmod(row, meals_a_day)
        z = ndtri(uniforms(seed, "counted carbohydrate", person, day * DAY + which))
        counted[row] = true_g * (1.0 + (bias_pct + error_pct * z) / 100.0)
    return np.clip(counted, 0.0, LARGEST_MEAL_G)


def counted_meals(meals: Sequence[Meal], seed: int, *, error_pct: float, bias_pct: float) -> tuple[Meal, ...]:
    """Meals of one run with the announced carbohydrate of each, counted as by person 0 of a trial of the seed."""
    ordered = in_order(meals)
    true_g = np.array([meal.carbs_g for meal in ordered])[:, None]
    counted = counted_g(
        true_g, seed, np.zeros(1, int), error_pct=error_pct, bias_pct=bias_pct, meals_a_day=max(1, len(ordered))
    )
    return tuple(
        dataclasses.replace(meal, announced_g=float(announced_g))
        for meal, announced_g in zip(ordered, counted[:, 0], strict=True)
    )
