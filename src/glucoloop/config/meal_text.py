"""Meals as people write them: ``50g@50min``, ``50@50``, ``50g@1.5h``."""

from __future__ import annotations

import re
from typing import Final

from glucoloop.meals import Meal
from glucoloop.meals.scenario import LARGEST_MEAL_G
from glucoloop.plausible import MEAL
from glucoloop.units import MIN_PER_H

# No two parts in a row can take the same characters: a long text that is no meal is refused as fast as it is read.
_NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_MEAL: Final = re.compile(
    rf"\s*(?P<carbs>{_NUMBER})\s*(?:g\s*)?@\s*(?P<time>{_NUMBER})\s*(?:(?P<unit>min|m|h)\s*)?", re.ASCII
)


def parse_meal(text: str) -> Meal:
    """Meal from its text; grams and minutes may go without their units.

    Raises
    ------
    ValueError
        For a text that is not a meal, or a meal that is not possible.
    """
    match = _MEAL.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a meal; write grams and a time, like 50g@50min or 50g@1.5h")
    carbs_g = float(match["carbs"])
    meant = MEAL.looks_like(carbs_g) if carbs_g > LARGEST_MEAL_G else None
    if meant is not None:
        raise ValueError(f"a meal of {carbs_g:g} g is not possible; {meant}")
    minutes = float(match["time"]) * (MIN_PER_H if match["unit"] == "h" else 1.0)
    return Meal(carbs_g=carbs_g, t_min=minutes)


def names_unit(text: str) -> bool:
    """Whether the text of a meal says in which unit its time is."""
    match = _MEAL.fullmatch(text)
    return match is not None and match["unit"] is not None


def meal_text(meal: Meal) -> str:
    """Text from which the same meal is read, to the last bit."""
    return f"{_shortest(meal.carbs_g)}g@{_shortest(meal.t_min)}min"


def _shortest(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
