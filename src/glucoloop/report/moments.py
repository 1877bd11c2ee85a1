"""Moments of a run in words: minutes up to a day, and day and clock in longer runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from glucoloop.units import MIN_PER_DAY, MIN_PER_H

_MAX_PERIODS: Final = 3


def moment_text(t_min: float, end_min: float | None = None, start_min: float = 0.0) -> str:
    """A moment of a run that ends at `end_min`: ``45 min``, or ``day 10, 17:30`` if the run is longer than a day.

    Without the end, the moment itself says whether it is. The run starts on day 1, `start_min` after midnight.
    """
    if (t_min if end_min is None else end_min) <= MIN_PER_DAY:
        return f"{t_min:g} min"
    day, of_day = divmod(round(start_min + t_min), round(MIN_PER_DAY))
    hour, minute = divmod(of_day, round(MIN_PER_H))
    return f"day {day + 1}, {hour:02d}:{minute:02d}"


def period_text(first_min: float, last_min: float, end_min: float | None = None, start_min: float = 0.0) -> str:
    """A period of a run, in a phrase: ``at 45 min``, ``from 45 to 60 min``, ``from day 2, 07:00 to day 2, 07:45``."""
    end_min = last_min if end_min is None else end_min
    first, last = (moment_text(t_min, end_min, start_min) for t_min in (first_min, last_min))
    if first_min == last_min:
        return f"at {last}"
    return f"from {first.removesuffix(' min')} to {last}"


def periods_text(periods: Sequence[tuple[float, float]], end_min: float, start_min: float = 0.0) -> str:
    """The first periods, and how many there are besides: ``from 10 to 20 min and at 35 min``."""
    phrases = [period_text(first, last, end_min, start_min) for first, last in periods]
    if len(phrases) > _MAX_PERIODS:
        phrases = [*phrases[: _MAX_PERIODS - 1], f"in {len(phrases) - _MAX_PERIODS + 1} later periods"]
    return phrases[0] if len(phrases) == 1 else f"{', '.join(phrases[:-1])} and {phrases[-1]}"
