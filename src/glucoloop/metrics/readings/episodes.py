"""Episodes of low and high glucose, as the consensus counts them with a continuous sensor.

An episode begins with the first of readings that are beyond a bound for 15 min, and ends with the first of readings
that are not for 15 min; readings at equal steps are interpolated over at most 45 min, and a longer gap ends it. n
readings in a row last n steps, so that 15 min are three readings of 5 min. `metrics.glycemia.LowEvents` counts alike.

References
----------
T. Battelino et al., "Continuous glucose monitoring and metrics for clinical trials: an international consensus
statement", Lancet Diabetes Endocrinol. 11(1), 42-57, 2023: level 1 is below 70 or above 180 mg/dl, level 2 below 54 or
above 250 mg/dl; extended hypoglycemia lasts more than 120 min; the night is from 0 to 6 h.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.metrics.readings.series import Floats, Readings, stretches
from glucoloop.units import MIN_PER_DAY

BOUNDS_MG_DL: Final = {"very_low": 54.0, "low": 70.0, "high": 180.0, "very_high": 250.0}
LASTING_MIN: Final = 15.0
EXTENDED_MIN: Final = 120.0
NIGHT_ENDS_MIN: Final = 360.0


class GlucoseEpisode(NamedTuple):
    """One episode of low or high glucose."""

    kind: str
    """One of `BOUNDS_MG_DL`."""
    t_min: float
    """Time of its first reading."""
    duration_min: float
    """Time from its first reading to the first one after it, or to the gap in which it ends."""
    extreme_mg_dl: float
    """Minimum or maximum glucose."""
    clock_min: float
    """Time on the wall at its first reading, after midnight of day 0."""

    @property
    def extended(self) -> bool:
        """Whether glucose was below 70 mg/dl for more than 120 min."""
        return self.kind == "low" and self.duration_min > EXTENDED_MIN

    @property
    def nocturnal(self) -> bool:
        """Whether it began from 0 to 6 h."""
        return self.clock_min % MIN_PER_DAY < NIGHT_ENDS_MIN


def glucose_episodes(readings: Readings, kind: str) -> list[GlucoseEpisode]:
    """Episodes beyond one of `BOUNDS_MG_DL`, in the order of time."""
    bound = BOUNDS_MG_DL[kind]
    grid = readings.grid
    in_a_row = math.ceil(LASTING_MIN / grid.step_min - 1e-9)
    result = []
    for segment in grid.segments():
        glucose = segment.glucose_mg_dl
        beyond = glucose < bound if bound < 100.0 else glucose > bound
        if not beyond.any():
            continue
        for begin, end in _spans(beyond, in_a_row):
            inside: Floats = glucose[begin:end]
            extreme = inside.min() if bound < 100.0 else inside.max()
            start, duration = grid.step_min * (segment.first + begin), grid.step_min * (end - begin)
            clock_min = readings.clock_at(float(start))
            result.append(GlucoseEpisode(kind, float(start), float(duration), float(extreme), clock_min))
    return result


def _spans(beyond: npt.NDArray[np.bool_], in_a_row: int) -> Iterator[tuple[int, int]]:
    """First place of each episode, and the first place after it."""
    begin, last = None, 0
    for low, high in stretches(beyond):
        if begin is not None and low - last >= in_a_row:
            yield begin, last
            begin = None
        if begin is None and high - low >= in_a_row:
            begin = low
        last = high
    if begin is not None:
        yield begin, last if beyond.size - last >= in_a_row else beyond.size


def episode_counts(readings: Readings) -> Mapping[str, float]:
    """Numbers of episodes of each level, of extended ones, and of those below 70 mg/dl that began at night."""
    low = glucose_episodes(readings, "low")
    return {
        **{f"{kind}_events": float(len(glucose_episodes(readings, kind))) for kind in BOUNDS_MG_DL},
        "extended_low_events": float(sum(one.extended for one in low)),
        "nocturnal_low_events": float(sum(one.nocturnal for one in low)),
    }
