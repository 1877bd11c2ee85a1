"""Texts of meals and of bouts of exercise: 50g@50min, 50g@1.5h/15min if eating takes 15 min, and 50%@14h/30min."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from glucoloop.meals import Meal
from glucoloop.physiology.exercise import Exercise
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import CONFIRM_OPTION, MEAL, refuse_unusual
from glucoloop.units import HOURS_PER_DAY, LARGEST_MEAL_G, MIN_PER_DAY, NUMBER, UNITS_OF_TIME

_UNIT: Final = "|".join(UNITS_OF_TIME)
_MEAL: Final = re.compile(
    rf"\s*(?P<carbs>{NUMBER})\s*(?P<of_carbs>g\s*)?@\s*(?P<time>{NUMBER})\s*(?:(?P<unit>{_UNIT})\s*)?"
    rf"(?:/\s*(?P<eating>{NUMBER})\s*(?:(?P<eating_unit>{_UNIT})\s*)?)?",
    re.ASCII,
)


def parse_meal(text: str) -> Meal:
    """Meal from its text; `refuse_unusual_meals` refuses one without any unit.

    Raises
    ------
    ValueError
        For a text that is not a meal, or a meal that is not possible.
    """
    match = _MEAL.fullmatch(text)
    if match is None:
        raise Refusal(
            f"{text!r} is not a meal; write grams and a time, like 50g@50min or 50g@1.5h, "
            "and after a slash how long eating takes, like 50g@50min/15min; own for each person's own day"
        )
    carbs_g = float(match["carbs"])
    meant = MEAL.looks_like(carbs_g) if carbs_g > LARGEST_MEAL_G else None
    if meant is not None:
        raise Refusal(f"a meal of {carbs_g:g} g is not possible; {meant}")
    t_min = float(match["time"]) * UNITS_OF_TIME[match["unit"] or "min"]
    if t_min < 0.0:
        raise Refusal(f"a meal at {t_min:g} min is not possible; give a finite time of 0 min or later")
    eating_min = float(match["eating"] or 0.0) * UNITS_OF_TIME[match["eating_unit"] or "min"]
    return Meal(carbs_g=carbs_g, t_min=t_min, eating_min=eating_min)


def meal_text(meal: Meal) -> str:
    """Text from which the same meal is read, to the last bit."""
    carbs, time, eating = (
        repr(float(value)).removesuffix(".0") for value in (meal.carbs_g, meal.t_min, meal.eating_min)
    )
    return f"{carbs}g@{time}min{f'/{eating}min' if meal.eating_min else ''}"


OWN: Final = "own"
"""Text in place of meals: each person's own day."""


def same_meals(texts: Iterable[str]) -> tuple[str, ...]:
    """Texts of the same meals, each written in grams and minutes; ``own`` stands alone and stays."""
    texts = tuple(texts)
    if OWN in texts:
        if texts != (OWN,):
            raise Refusal("the meals are each person's own day, and others are given too; give one of the two")
        return texts
    return tuple(meal_text(parse_meal(text)) for text in texts)


def refuse_unusual_meals(texts: Iterable[str], horizon_min: float) -> None:
    """Refuse meals of unusual size or without any unit, and one like ``45g@7`` where hours were probably meant.

    They were probably meant in a run of a day or longer.
    """
    for text in texts:
        if text == OWN:
            continue
        meal, match = parse_meal(text), _MEAL.fullmatch(text)
        if match is None or not (match["of_carbs"] or match["unit"]):
            raise Refusal(
                f"the meal {text!r} names no unit",
                f"write {meal_text(meal)}",
                f"{CONFIRM_OPTION} if that is meant",
            )
        refuse_unusual(meal.carbs_g, MEAL, f"the size of the meal at {meal.t_min:g} min", CONFIRM_OPTION)
        if horizon_min >= MIN_PER_DAY and not match["unit"] and 0.0 < meal.t_min < HOURS_PER_DAY:
            size, time = f"{meal.carbs_g:g}g", f"{meal.t_min:g}"
            eating = f"/{meal.eating_min:g}min" if meal.eating_min else ""
            raise Refusal(
                f"the meal {text!r} begins {time} min after the start; that looks like hours. "
                f"Write {size}@{time}h{eating}, or {size}@{time}min{eating} if minutes are meant"
            )


_EXERCISE: Final = re.compile(
    rf"\s*(?P<intensity>{NUMBER})\s*%\s*@\s*(?P<time>{NUMBER})\s*(?P<unit>{_UNIT})\s*"
    rf"/\s*(?P<duration>{NUMBER})\s*(?P<duration_unit>{_UNIT})\s*",
    re.ASCII,
)


def parse_exercise(text: str) -> Exercise:
    """Bout of exercise from its text.

    Raises
    ------
    ValueError
        For a text that is not exercise, lacks a unit, or is of exercise that is not possible.
    """
    match = _EXERCISE.fullmatch(text)
    if match is None:
        raise Refusal(
            f"{text!r} is not exercise; write its intensity in percent of the largest oxygen uptake above rest, a time "
            "and a duration, each with its unit, like 50%@14h/30min"
        )
    return Exercise(
        intensity_pct=float(match["intensity"]),
        t_min=float(match["time"]) * UNITS_OF_TIME[match["unit"]],
        duration_min=float(match["duration"]) * UNITS_OF_TIME[match["duration_unit"]],
    )


def exercise_text(bout: Exercise) -> str:
    """Text from which the same bout is read, to the last bit."""
    intensity, time, duration = (
        repr(float(value)).removesuffix(".0") for value in (bout.intensity_pct, bout.t_min, bout.duration_min)
    )
    return f"{intensity}%@{time}min/{duration}min"


def same_exercise(texts: Iterable[str]) -> tuple[str, ...]:
    """Texts of the same bouts, each written in percent and minutes."""
    return tuple(exercise_text(parse_exercise(text)) for text in texts)
