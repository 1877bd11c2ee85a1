"""Moments and periods of a run in words, and the periods in which the patient's model is not valid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.units import MIN_PER_DAY, MIN_PER_H

if TYPE_CHECKING:
    from glucoloop.simulation import Trace

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


def stretches(there: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First place of each stretch in which something is there, and the place after its last one."""
    first, after = np.flatnonzero(np.diff(there.astype(int), prepend=0, append=0)).reshape(-1, 2).T.tolist()
    return list(zip(first, after, strict=True))


def periods_below(
    t_min: npt.ArrayLike, glucose_mg_dl: npt.ArrayLike, limit_mg_dl: npt.ArrayLike
) -> list[tuple[float, float]]:
    """First and last moment of each period in which the glucose of one person is below a limit; NaN is not."""
    t, below = np.asarray(t_min, float), np.asarray(glucose_mg_dl, float) < np.asarray(limit_mg_dl, float)
    return [(float(t[first]), float(t[after - 1])) for first, after in stretches(below)]


def concentrations(glucose_mg_dl: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Glucose to be shown: NaN below 0, which is no concentration; the valid range of the model ended above it."""
    return np.where(glucose_mg_dl < 0.0, np.nan, glucose_mg_dl)


def validity(trace: Trace) -> dict[str, Any]:
    """Plain values for JSON: the limit of one patient's model, and the periods below it."""
    periods = periods_below(trace.fine_t_min, trace.fine_glucose_mg_dl, trace.lowest_valid_mg_dl)
    return {
        "lowest_valid_mg_dl": float(trace.lowest_valid_mg_dl),
        "periods_below_min": [list(period) for period in periods],
    }


def validity_note(trace: Trace, start_min: float = 0.0) -> str | None:
    """Warning about a run in which glucose was below the range in which the model is valid, or None."""
    return validity_sentence(trace.fine_t_min, trace.fine_glucose_mg_dl, float(trace.lowest_valid_mg_dl), start_min)


def validity_sentence(
    t_min: npt.ArrayLike, glucose_mg_dl: npt.ArrayLike, limit_mg_dl: float, start_min: float = 0.0
) -> str | None:
    """The same warning for glucose at given times and the limit of the model; arguments as for `periods_below`.

    The run starts `start_min` after midnight.
    """
    periods = periods_below(t_min, glucose_mg_dl, limit_mg_dl)
    if not periods:
        return None
    when = periods_text(periods, float(np.asarray(t_min)[-1]), start_min)
    return (
        f"Glucose was below {limit_mg_dl:.1f} mg/dl {when}: the patient's model is not valid there. Read these values "
        "as severe hypoglycemia; their depth means nothing."
    )
