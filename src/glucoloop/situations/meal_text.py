"""Text of a meal: ``50g@50min``, ``50g@50``, ``50g@1.5h``, or ``50g@50min/15min`` if eating takes 15 min."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from glucoloop.meals import Meal
from glucoloop.meals.scenario import LARGEST_MEAL_G
from glucoloop.parts.number_text import NUMBER, UNIT_OF_TIME, UNITS_OF_TIME
from glucoloop.plausible import CONFIRM_OPTION, MEAL, ask
from glucoloop.refusal import Refusal
from glucoloop.units import HOURS_PER_DAY, MIN_PER_DAY

_MEAL: Final = re.compile(
    rf"\s*(?P<carbs>{NUMBER})\s*(?P<of_carbs>g\s*)?@\s*(?P<time>{NUMBER})\s*(?:(?P<unit>{UNIT_OF_TIME})\s*)?"
    rf"(?:/\s*(?P<eating>{NUMBER})\s*(?:(?P<eating_unit>{UNIT_OF_TIME})\s*)?)?",
    re.ASCII,
)


def parse_meal(text: str) -> Meal:
    """Meal from its text; `ask_about_meals` asks about one without any unit.

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


def names_units(text: str) -> tuple[bool, bool]:
    """Whether the text of a meal says in which unit its carbohydrate is, and its time."""
    match = _MEAL.fullmatch(text)
    return (False, False) if match is None else (match["of_carbs"] is not None, match["unit"] is not None)


def meal_text(meal: Meal) -> str:
    """Text from which the same meal is read, to the last bit."""
    eating = f"/{_shortest(meal.eating_min)}min" if meal.eating_min else ""
    return f"{_shortest(meal.carbs_g)}g@{_shortest(meal.t_min)}min{eating}"


def ask_about_meals(texts: Iterable[str]) -> None:
    """Ask for confirmation of meals of unusual size, or without any unit."""
    for text in texts:
        meal = parse_meal(text)
        if not any(names_units(text)):
            raise Refusal(
                f"the meal {text!r} names no unit; write {meal_text(meal)}, or {CONFIRM_OPTION} if that is meant"
            )
        ask(meal.carbs_g, MEAL, f"the size of the meal at {meal.t_min:g} min", CONFIRM_OPTION)


def ask_about_clock(texts: Iterable[str], horizon_min: float) -> None:
    """Ask about a meal like ``45g@7`` in a run of a day or longer, where hours were probably meant."""
    if horizon_min < MIN_PER_DAY:
        return
    for text in texts:
        meal = parse_meal(text)
        if not names_units(text)[1] and 0.0 < meal.t_min < HOURS_PER_DAY:
            size, time = f"{meal.carbs_g:g}g", f"{meal.t_min:g}"
            eating = f"/{meal.eating_min:g}min" if meal.eating_min else ""
            raise Refusal(
                f"the meal {text!r} begins {time} min after the start; that looks like hours. "
                f"Write {size}@{time}h{eating}, or {size}@{time}min{eating} if minutes are meant"
            )


def _minutes(number: str, unit: str | None) -> float:
    return float(number) * UNITS_OF_TIME[unit or "min"]


def _shortest(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
