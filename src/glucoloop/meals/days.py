"""Days of some people: the meals of each person, when and how large, and what the controller is told of them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._lazy_jax import scipy
from glucoloop.meals.protocol import Eaten
from glucoloop.meals.scenario import Meal
from glucoloop.threefry import uniforms
from glucoloop.units import LARGEST_MEAL_G, MIN_PER_DAY

Array = npt.NDArray[Any]
DAY: Final = 1 << 16
"""Random numbers of one day; those of a day before the start are counted back from the last ones."""
_ADDED: Final = 1 << 10
"""Number of the first meal of a day that is added to the plan."""
_DAYS_A_WEEK: Final = 7


@dataclass(frozen=True)
class LivedDays:
    """Meals of people ``(meals, people)``, day by day; a meal of 0 g is none. `meals.habits` change them."""

    t_min: Array
    """Time at which each meal begins, from the start; before 0 in a warm-up."""
    carbs_g: Array
    eating_min: Array
    announced_g: Array
    """Carbohydrate that the controller is told, 0 for nothing."""
    announced_min: Array
    """Time at which it is told."""
    day: npt.NDArray[np.int64]
    """(meals,) day to which each meal belongs, 0 for the first one."""
    which: npt.NDArray[np.int64]
    """(meals,) number of each meal in its day, from 0."""
    date: npt.NDArray[np.int64]
    """(meals,) number of the 24 h in which each meal is planned; the day, unless a plan is longer than a day."""
    starts_min: Array
    """(days,) times at which the days of the run begin."""
    person: npt.NDArray[np.int64]
    """(people,) numbers of the persons."""
    seed: int
    name: str = ""
    """Name under which is drawn."""

    def changed(self, **arrays: Any) -> LivedDays:
        """The days with other arrays."""
        return dataclasses.replace(self, **arrays)

    def named(self, name: str) -> LivedDays:
        """The days under a name for what is drawn."""
        return dataclasses.replace(self, name=name)

    def uniform(self, what: str = "") -> Array:
        """Numbers ``(meals, people)`` between 0 and 1, functions of seed, name, person, day and meal alone."""
        index = np.repeat(self.day % DAY * DAY + self.which, self.person.size)
        people = np.tile(self.person, self.day.size)
        return uniforms(self.seed, f"{self.name} {what}".strip(), people, index).reshape(self.t_min.shape)

    def happens(self, probability: float, meal: int = 0) -> Array:
        """1 where something happens, else 0: to the meal of a number in its day, from 1, or for 0 to any."""
        there = (self.which == meal - 1) if meal else np.ones(self.which.shape, bool)
        drawn = self.uniform() < probability if 0.0 < probability < 1.0 else probability >= 1.0
        return (there[:, None] & drawn & np.ones(self.t_min.shape, bool)).astype(float)

    def on_weekdays(self, first: int, last: int) -> Array:
        """1 on days of the week from one to another, else 0, ``(meals, 1)``; the first day of a run is a Monday, 1."""
        return (((self.date + 1 - first) % _DAYS_A_WEEK) <= ((last - first) % _DAYS_A_WEEK)).astype(float)[:, None]

    def added(self, time_min: float, carbs_g: float) -> LivedDays:
        """A meal on each day, by itself, with numbers of its own; see `with_added`."""
        days = np.round(self.starts_min / MIN_PER_DAY).astype(int)
        number = max(_ADDED, int(self.which.max(initial=0)) + 1)
        t_min = np.repeat((self.starts_min + time_min)[:, None], self.person.size, axis=1)
        size = np.full_like(t_min, carbs_g)
        return self.changed(
            t_min=t_min,
            carbs_g=size,
            eating_min=np.zeros_like(t_min),
            announced_g=size,
            announced_min=t_min,
            day=days,
            date=days,
            which=np.full(days.shape, number),
        )

    def with_added(self, others: LivedDays) -> LivedDays:
        """The days with the meals of others."""
        names = ("t_min", "carbs_g", "eating_min", "announced_g", "announced_min", "day", "which", "date")
        return self.changed(**{name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in names})

    def counted(self, error_pct: float, bias_pct: float) -> LivedDays:
        """The days with carbohydrate as people count it: ``carbs (1 + bias + error z)``, a standard normal z, each.

        It is from 0 to 1000 g.
        """
        z = scipy.special.ndtri(self.named("counted carbohydrate").uniform())
        announced_g = self.announced_g * (1.0 + (bias_pct + error_pct * z) / 100.0)
        return self.changed(announced_g=np.clip(announced_g, 0.0, LARGEST_MEAL_G))

    def announced_before(self, minutes: float) -> LivedDays:
        """The days with announcements that come so many minutes earlier."""
        return self.changed(announced_min=self.announced_min - minutes)

    def since(self, earliest_min: float) -> LivedDays:
        """The days without the meals that begin before a time."""
        begun = self.t_min >= earliest_min
        return self.changed(
            carbs_g=np.where(begun, self.carbs_g, 0.0), announced_g=np.where(begun, self.announced_g, 0.0)
        )

    def first_min(self) -> Array:
        """Time of the first meal of each person from the start on, ``(people,)``; 0 for none."""
        eaten = (self.t_min >= 0.0) & (self.carbs_g > 0.0)
        first = np.min(np.where(eaten, self.t_min, np.inf), axis=0, initial=np.inf)
        return np.where(np.isfinite(first), first, 0.0)

    @property
    def eaten(self) -> Eaten:
        """Meals as they are eaten, ``(meals, people)``."""
        return Eaten(t_min=self.t_min, carbs_g=self.carbs_g, eating_min=self.eating_min)

    def meals_of(self, column: int, end_min: float) -> tuple[Meal, ...]:
        """Meals of one of the people that begin before the end."""
        columns = (self.carbs_g, self.t_min, self.eating_min, self.announced_g, self.announced_min)
        rows = np.stack([part[:, column] for part in columns], axis=1)
        return tuple(Meal(*row) for row in rows.tolist() if row[0] > 0.0 and row[1] < end_min)
