"""Carbohydrate counting with errors: the announced carbohydrate of a meal, where it differs from the true one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from glucoloop.meals.plan import DAY
from glucoloop.meals.scenario import LARGEST_MEAL_G, Meal, in_order
from glucoloop.threefry import uniforms

Array = npt.NDArray[Any]


def counted_g(
    carbs_g: Array, seed: int, person: npt.ArrayLike, *, error_pct: float, bias_pct: float, meals_a_day: int
) -> Array:
    """Carbohydrate of meals as people count it, ``(meals, people)``, from what is eaten day by day.

    Each person's error is drawn for each meal: ``carbs (1 + bias + error z)`` with a standard normal z, from 0 to 1000
    g. The count of a meal is the same whoever else is drawn, and however many days follow.
    """
    told = np.empty_like(carbs_g, dtype=float)
    for row, eaten in enumerate(carbs_g):
        day, which = divmod(row, meals_a_day)
        z = ndtri(uniforms(seed, "counted carbohydrate", person, day * DAY + which))
        told[row] = eaten * (1.0 + (bias_pct + error_pct * z) / 100.0)
    return np.clip(told, 0.0, LARGEST_MEAL_G)


def counted_meals(meals: Sequence[Meal], seed: int, *, error_pct: float, bias_pct: float) -> tuple[Meal, ...]:
    """Meals of one run with the announced carbohydrate of each, counted as by person 0 of a trial of the seed."""
    ordered = in_order(meals)
    eaten = np.array([meal.carbs_g for meal in ordered])[:, None]
    told = counted_g(
        eaten, seed, np.zeros(1, int), error_pct=error_pct, bias_pct=bias_pct, meals_a_day=max(1, len(ordered))
    )
    return tuple(
        dataclasses.replace(meal, announced_g=float(told_g)) for meal, told_g in zip(ordered, told[:, 0], strict=True)
    )
