"""Exercise: bouts of a run, how they vary between people and days, and the intensity that a patient gets.

Intensity is the oxygen uptake above that at rest, in percent of a person's largest, and is held constant over each
minute: a bout that begins or ends within one has its mean there. Where bouts overlap, the more intense one counts.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.arguments import ArgumentTypeError, checked, is_traced
from glucoloop.refusal import Refusal
from glucoloop.threefry import checked_people, uniforms
from glucoloop.units import MIN_PER_DAY

LARGEST_INTENSITY_PCT: Final = 100.0
SHORTEST_BOUT_MIN: Final = 1.0
LONGEST_BOUT_MIN: Final = MIN_PER_DAY
MAX_BOUTS: Final = 100
"""Largest number of bouts in a run, and of one day that is repeated."""

Floats = npt.NDArray[np.float64]


@checked
@dataclass(frozen=True)
class Exercise:
    """A bout of exercise at one intensity.

    Parameters
    ----------
    intensity_pct : float
        Oxygen uptake above that at rest, in percent of the largest.
    t_min : float
        Time at which it begins.
    duration_min : float
        Time for which it lasts.

    Raises
    ------
    ValueError
        Unless ``0 < intensity_pct <= 100``, ``t_min >= 0`` and finite, and ``1 <= duration_min <= 1440``.
    """

    intensity_pct: float
    t_min: float
    duration_min: float

    def __post_init__(self) -> None:
        if is_traced(self.intensity_pct, self.t_min, self.duration_min):
            raise ArgumentTypeError(
                "exercise is traced by JAX, but its minutes are computed with NumPy; give plain numbers"
            )
        if not 0.0 < self.intensity_pct <= LARGEST_INTENSITY_PCT:
            raise Refusal(
                f"exercise of {self.intensity_pct:g} % is not possible; give more than 0 and at most "
                f"{LARGEST_INTENSITY_PCT:g} % of the largest oxygen uptake"
            )
        if not 0.0 <= self.t_min < math.inf:
            raise Refusal(f"exercise at {self.t_min:g} min is not possible; give a finite time of 0 min or later")
        if not SHORTEST_BOUT_MIN <= self.duration_min <= LONGEST_BOUT_MIN:
            raise Refusal(
                f"exercise for {self.duration_min:g} min is not possible; give {SHORTEST_BOUT_MIN:g} to "
                f"{LONGEST_BOUT_MIN:g} min"
            )


@dataclass(frozen=True)
class Bouts:
    """Bouts of people, ``(bouts, people)`` each."""

    intensity_pct: Floats
    t_min: Floats
    duration_min: Floats

    def later(self, minutes: float) -> Bouts:
        """The same bouts some time later."""
        return dataclasses.replace(self, t_min=self.t_min + minutes) if minutes else self

    def of(self, column: int) -> tuple[Exercise, ...]:
        """Bouts of one of the people."""
        rows = np.stack([part[:, column] for part in (self.intensity_pct, self.t_min, self.duration_min)], axis=1)
        return tuple(Exercise(*row) for row in rows.tolist())


def exercise_in_order(exercise: Iterable[Exercise], end_min: float) -> tuple[Exercise, ...]:
    """Bouts sorted by time; what is no bout, begins after the end, or is one too many is refused."""
    given = tuple(exercise)
    for bout in given:
        if not isinstance(bout, Exercise):
            raise ArgumentTypeError(
                f"exercise holds {bout!r}, which is no exercise; give bouts such as Exercise(50.0, 120.0, 30.0)"
            )
        if bout.t_min >= end_min:
            raise Refusal(
                f"the exercise at {bout.t_min:g} min begins after the end at {end_min:g} min; move it, or lengthen "
                "the run"
            )
    if len(given) > MAX_BOUTS:
        raise Refusal(f"{len(given)} bouts of exercise are too many; give at most {MAX_BOUTS}")
    return tuple(sorted(given, key=lambda bout: bout.t_min))


def repeated_daily(exercise: Sequence[Exercise], days: int) -> tuple[Exercise, ...]:
    """Bouts of a day on each of several days."""
    return tuple(
        dataclasses.replace(bout, t_min=day * MIN_PER_DAY + bout.t_min) for day in range(days) for bout in exercise
    )


def draw_bouts(
    exercise: Sequence[Exercise],
    seed: int,
    person: npt.ArrayLike,
    *,
    intensity_spread_pct: float = 0.0,
    time_spread_min: float = 0.0,
    a_day: int = 1,
) -> Bouts:
    """Draw the bouts of given persons.

    Intensity is uniform within a percentage of each bout's own, at most 100 %, and time within some minutes, never
    before the start; both are drawn for every bout and person, whoever else is drawn. `a_day` is the number of bouts of
    a day, day by day.
    """
    people = checked_people(person)
    columns = [[getattr(bout, field.name) for bout in exercise] for field in dataclasses.fields(Bouts)]
    intensity_pct, t_min, duration_min = (
        np.repeat(np.asarray(column, float)[:, None], people.size, axis=1) for column in columns
    )
    for row in range(len(exercise)):
        day, which = divmod(row, a_day)
        index = day * MAX_BOUTS + which
        if intensity_spread_pct > 0.0:
            away = intensity_spread_pct / 100.0 * (2.0 * uniforms(seed, "exercise intensity", people, index) - 1.0)
            intensity_pct[row] = np.minimum(intensity_pct[row] * (1.0 + away), LARGEST_INTENSITY_PCT)
        if time_spread_min > 0.0:
            away = time_spread_min * (2.0 * uniforms(seed, "exercise time", people, index) - 1.0)
            t_min[row] = np.maximum(t_min[row] + away, 0.0)
    return Bouts(intensity_pct=intensity_pct, t_min=t_min, duration_min=duration_min)


def mean_intensity_pct(bouts: Bouts, edges_min: npt.ArrayLike) -> Floats:
    """Mean intensity ``(n, people)`` of people between consecutive times ``(n + 1,)``."""
    edges = np.asarray(edges_min, float)
    result = np.zeros((edges.size - 1, bouts.t_min.shape[1]))
    for intensity_pct, begins, lasts in zip(bouts.intensity_pct, bouts.t_min, bouts.duration_min, strict=True):
        first = max(0, int(np.searchsorted(edges, begins.min(), side="right")) - 1)
        there = slice(first, int(np.searchsorted(edges, (begins + lasts).max())))
        start, end = edges[:-1][there, None], edges[1:][there, None]
        share = np.clip((np.minimum(begins + lasts, end) - np.maximum(begins, start)) / (end - start), 0.0, 1.0)
        np.maximum(result[there], share * intensity_pct, out=result[there])
    return result


def bouts_of_one(exercise: Sequence[Exercise]) -> Bouts:
    """Bouts of one person, ``(bouts, 1)``."""
    return Bouts(
        **{
            field.name: np.array([[getattr(bout, field.name)] for bout in exercise], float).reshape(-1, 1)
            for field in dataclasses.fields(Bouts)
        }
    )


def refuse_exercise(patient: Any, called: str = "") -> None:
    """Refuse exercise of a patient whose equations have none."""
    if not getattr(patient, "takes_exercise", False):
        raise Refusal(
            f"the equations of {called or type(patient).__name__} have no exercise, so it would change nothing; leave "
            "it out, or take a patient that has it, such as roy-parker-2007 or mcgill-2020"
        )
