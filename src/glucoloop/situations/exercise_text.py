"""Text of a bout of exercise: ``50%@14h/30min``, intensity, time and duration."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from glucoloop.component.number_text import NUMBER, UNITS_OF_TIME
from glucoloop.physiology.exercise import Exercise
from glucoloop.refusal import Refusal

_UNIT: Final = "|".join(UNITS_OF_TIME)
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
