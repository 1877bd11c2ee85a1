"""Meals of a day, repeated daily, their variation between people and days, and the habits with which they are lived."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.arguments import checked
from glucoloop.meals.habits import HabitComponent, LivedDays
from glucoloop.meals.protocol import Eaten
from glucoloop.meals.scenario import Meal, check_warm_up, eaten, in_order
from glucoloop.refusal import Refusal
from glucoloop.threefry import checked_counter, checked_people
from glucoloop.units import LARGEST_MEAL_G, LONGEST_RUN_MIN, MAX_DAYS, MIN_PER_DAY

MAX_MEALS_A_DAY: Final = 100
Array = npt.NDArray[Any]


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
        Carbohydrate is uniform within this percentage of each meal's own, drawn again for every person and meal.
    time_spread_min : float
        The time of each meal is uniform within these minutes, drawn likewise.
    horizon_min : float, optional
        Length of the run; the days by default. A run of one day may be shorter or longer than 24 h.
    own : callable, optional
        Function of a seed and of persons ``(n,)`` that gives the day of each as `Eaten`, ``(meals, n)`` with as many
        meals as the plan, which then says what is eaten on average.
    habits : iterable of HabitComponent
        Habits that change the meals, one after the other, such as `meals.habits.Skipped`.
    warm_up_min : float
        Time before the start that is simulated and not counted; where days are repeated, it has their meals too.

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
    habits: tuple[HabitComponent, ...]
    warm_up_min: float
    repeated: bool
    """Whether the meals are those of each day, rather than those of a run."""

    def __init__(
        self,
        meals: Iterable[Meal],
        days: int = 1,
        *,
        size_spread_pct: float = 0.0,
        time_spread_min: float = 0.0,
        horizon_min: float | None = None,
        own: Callable[[int, npt.ArrayLike], Eaten] | None = None,
        habits: Iterable[HabitComponent] = (),
        warm_up_min: float = 0.0,
    ) -> None:
        if not 1 <= days <= MAX_DAYS:
            raise Refusal(f"days is {days!r}; give a whole number from 1 to {MAX_DAYS}")
        whole = days * MIN_PER_DAY
        object.__setattr__(self, "meals", in_order(meals))
        object.__setattr__(self, "days", days)
        object.__setattr__(self, "own", own)
        object.__setattr__(self, "size_spread_pct", float(size_spread_pct))
        object.__setattr__(self, "time_spread_min", float(time_spread_min))
        object.__setattr__(self, "horizon_min", whole if horizon_min is None else float(horizon_min))
        object.__setattr__(self, "habits", tuple(habits))
        object.__setattr__(self, "warm_up_min", float(warm_up_min))
        object.__setattr__(self, "repeated", horizon_min is None or self.horizon_min == whole)
        if not 0.0 < self.horizon_min <= LONGEST_RUN_MIN:
            raise Refusal(
                f"a horizon of {self.horizon_min:g} min is not possible; "
                f"give more than 0 and at most {LONGEST_RUN_MIN:g} min"
            )
        if days > 1 and self.horizon_min != whole:
            raise Refusal(
                f"a horizon of {self.horizon_min:g} min is not that of {days} days; leave it out, or give {whole:g} min"
            )
        check_warm_up(self.warm_up_min, self.horizon_min)
        self._check_spreads()
        for habit in self.habits:
            habit.refuse_in(self)

    def _check_spreads(self) -> None:
        if not 0.0 <= self.size_spread_pct < 100.0:
            raise Refusal(f"a spread of meals of {self.size_spread_pct:g} % is not possible; give 0 to below 100 %")
        if not 0.0 <= self.time_spread_min < MIN_PER_DAY:
            raise Refusal(
                f"a spread of meal times of {self.time_spread_min:g} min is not possible; "
                f"give 0 to below {MIN_PER_DAY:g} min"
            )
        if len(self.meals) > MAX_MEALS_A_DAY:
            raise Refusal(f"{len(self.meals)} meals a day are too many; give at most {MAX_MEALS_A_DAY}")
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
        return bool(self.habits) or (bool(self.meals) and differ)

    def same_for_all(self) -> Eaten:
        """Meals ``(meals,)`` of every person, where they do not vary."""
        one = draw_days(self, 0, [0]).eaten
        return Eaten(t_min=one.t_min[:, 0], carbs_g=one.carbs_g[:, 0], eating_min=one.eating_min[:, 0])

    def drawn_days(self) -> npt.NDArray[np.int64]:
        """Numbers of the days that have the meals of the plan; those of the warm-up are below 0."""
        earlier = -math.ceil(self.warm_up_min / MIN_PER_DAY) if self.repeated else 0
        return np.arange(earlier, self.days)

    def starts_min(self) -> Array:
        """Times at which the days begin that lie in the run and in its warm-up."""
        first, last = (math.ceil(minutes / MIN_PER_DAY) for minutes in (self.warm_up_min, self.horizon_min))
        return MIN_PER_DAY * np.arange(-first, last)

    def nominal(self) -> tuple[Meal, ...]:
        """All meals of the run, without their variation."""
        return tuple(
            dataclasses.replace(meal, t_min=day * MIN_PER_DAY + meal.t_min)
            for day in range(self.days)
            for meal in self.meals
        )


def draw_days(plan: MealPlan, seed: int, person: npt.ArrayLike) -> LivedDays:
    """Draw the days of given persons, with their habits and the days of the warm-up.

    Parameters
    ----------
    seed, person
        As for `patients.virtual_people`.

    Returns
    -------
    LivedDays
        Meals ``(meals, n)``, day by day. A meal of a person is the same whoever else is drawn, however many days
        follow, and however long the warm-up is. Without spread and habits all have exactly the plan's own.

    Raises
    ------
    ValueError
        For a seed or a person that does not exist.
    """
    people = checked_people(person)
    checked_counter("seed", seed)
    own = None if plan.own is None else plan.own(seed, people)  # (meals, n)
    meals = eaten(plan.meals) if own is None else own
    numbers, starts_min = plan.drawn_days(), plan.starts_min()

    def rows(of_meals: Any) -> Array:
        of_day = np.asarray(of_meals, float)
        of_day = of_day[:, None] if of_day.ndim == 1 else of_day
        return np.tile(np.broadcast_to(of_day, (len(plan.meals), people.size)), (len(numbers), 1))

    of_numbers = MIN_PER_DAY * np.repeat(numbers, len(plan.meals)).astype(float)
    t_min, carbs_g = rows(meals.t_min) + of_numbers[:, None], rows(meals.carbs_g)
    planned_min = np.tile([meal.t_min for meal in plan.meals], len(numbers)) + of_numbers
    days = LivedDays(
        t_min=t_min,
        carbs_g=carbs_g,
        eating_min=rows(meals.eating_min),
        announced_g=carbs_g,
        announced_min=t_min,
        day=np.repeat(numbers, len(plan.meals)),
        which=np.tile(np.arange(len(plan.meals)), len(numbers)),
        date=np.floor(planned_min / MIN_PER_DAY).astype(int),
        starts_min=starts_min,
        person=people,
        seed=seed,
    )
    if plan.time_spread_min > 0.0:
        drawn = days.named("meal time").uniform()
        days = days.changed(t_min=t_min + plan.time_spread_min * (2.0 * drawn - 1.0))
    if plan.size_spread_pct > 0.0:
        drawn = days.named("meal size").uniform()
        days = days.changed(carbs_g=carbs_g * (1.0 + plan.size_spread_pct / 100.0 * (2.0 * drawn - 1.0)))
    days = days.changed(announced_g=days.carbs_g, announced_min=days.t_min)
    for place, habit in enumerate(plan.habits):
        earlier = sum(other.display_name == habit.display_name for other in plan.habits[:place])
        days = habit.lived(days.named(f"{habit.display_name} {earlier + 1}"))
    return days.since(-plan.warm_up_min) if plan.habits or plan.warm_up_min else days


def draw_meals(plan: MealPlan, seed: int, person: npt.ArrayLike) -> Eaten:
    """Meals of given persons as they are eaten, ``(meals, n)``; see `draw_days`."""
    return draw_days(plan, seed, person).eaten
