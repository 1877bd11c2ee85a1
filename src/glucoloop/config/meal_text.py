"""Text of a meal: ``50g@50min``, ``50@50``, ``50g@1.5h``, or ``50g@50min/15min`` if eating takes 15 min."""

from __future__ import annotations

import re
from typing import Final

from glucoloop.meals import Meal
from glucoloop.meals.scenario import LARGEST_MEAL_G
from glucoloop.plausible import MEAL
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_H

# No two parts in a row can take the same characters: a long text that is no meal is refused as fast as it is read.
_NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_MEAL: Final = re.compile(
    rf"\s*(?P<carbs>{_NUMBER})\s*(?:g\s*)?@\s*(?P<time>{_NUMBER})\s*(?:(?P<unit>min|m|h)\s*)?"
    rf"(?:/\s*(?P<eating>{_NUMBER})\s*(?:(?P<eating_unit>min|m|h)\s*)?)?",
    re.ASCII,
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
        raise Refusal(
            f"{text!r} is not a meal; write grams and a time, like 50g@50min or 50g@1.5h, "
            "and after a slash how long eating takes, like 50g@50min/15min"
        )
    carbs_g = float(match["carbs"])
    meant = MEAL.looks_like(carbs_g) if carbs_g > LARGEST_MEAL_G else None
    if meant is not None:
        raise Refusal(f"a meal of {carbs_g:g} g is not possible; {meant}")
    eating_min = 0.0 if match["eating"] is None else _minutes(match["eating"], match["eating_unit"])
    return Meal(carbs_g=carbs_g, t_min=_minutes(match["time"], match["unit"]), eating_min=eating_min)


def names_unit(text: str) -> bool:
    """Whether the text of a meal says in which unit its time is."""
    match = _MEAL.fullmatch(text)
    return match is not None and match["unit"] is not None


def meal_text(meal: Meal) -> str:
    """Text from which the same meal is read, to the last bit."""
    eating = f"/{_shortest(meal.eating_min)}min" if meal.eating_min else ""
    return f"{_shortest(meal.carbs_g)}g@{_shortest(meal.t_min)}min{eating}"


def _minutes(number: str, unit: str | None) -> float:
    return float(number) * (MIN_PER_H if unit == "h" else 1.0)


def _shortest(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
