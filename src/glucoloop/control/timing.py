"""Timing of a loop in real time: whether an observation is fresh, and until when a decision holds.

A sensor numbers its readings and gives the time of each; a controller gives the time until which its dose holds. In a
simulation both are on time by definition, so they are not given, and a controller need not use either.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass
from typing import Final

from glucoloop._lazy_jax import jnp
from glucoloop.control.design_case import check_sample_time
from glucoloop.control.protocol import Decision, Observation
from glucoloop.refusal import Refusal

_CLOCK_ERROR_MIN: Final = 0.5
"""Largest difference between the clocks of a sensor and a controller."""


class Arrival(enum.IntEnum):
    """Classification of the arrival of an observation."""

    ON_TIME = 0
    MISSING = 1
    UNTIMED = 2
    FROM_THE_FUTURE = 3
    REPEATED = 4
    OUT_OF_ORDER = 5
    LATE = 6

    @property
    def text(self) -> str:
        """Sentence that a person can act on."""
        return _TEXTS[self]


_TEXTS: Final = {
    Arrival.ON_TIME: "The reading arrived on time.",
    Arrival.MISSING: "No reading arrived; the controller goes on without one. Check the link to the sensor.",
    Arrival.UNTIMED: (
        "The reading does not say its number or when it was taken, so it is not used. Check what the sensor sends."
    ),
    Arrival.FROM_THE_FUTURE: (
        "The reading says that it was taken later than now, so it is not used. Set the clocks of sensor and controller."
    ),
    Arrival.REPEATED: "This reading was received before, so it is not used again. Check the link to the sensor.",
    Arrival.OUT_OF_ORDER: (
        "The reading is older than one that was received before, so it is not used. Check the link to the sensor."
    ),
    Arrival.LATE: ("The reading was taken too long ago to decide on, so it is not used. Check the link to the sensor."),
}


@dataclass(frozen=True)
class Stamp:
    """Number and time of a reading."""

    number: float
    """Number of the reading, up by one for each reading of the sensor."""
    read_t_min: float
    """Time at which the reading was taken."""


@dataclass(frozen=True)
class _Received:
    """A received observation in a form that a controller may use."""

    observation: Observation
    """Observation, valid only if it arrived on time; without its stamp, so that a compiled controller sees one
    structure.
    """
    arrival: Arrival
    last: Stamp | None
    """Newest reading so far, to be passed to `receive` with the next observation."""


def received(
    last: Stamp | None,
    observation: Observation,
    now_min: float,
    *,
    late_after_min: float = 5.0,
    clock_error_min: float = _CLOCK_ERROR_MIN,
) -> Arrival:
    """Classify the arrival of an observation; never raises, for any stamp.

    The answer is the first that applies of: missing, untimed, from the future, repeated, out of order, late; else on
    time. A reading is late beyond an age, of one sample by default, and from the future if it is so by more than the
    clocks may differ. `last` is the newest reading that was received before, and `now_min` the time on the controller's
    clock.
    """
    stamp = _stamp(observation)
    if stamp is None:
        return Arrival.UNTIMED if bool(observation.valid) else Arrival.MISSING
    if not stamp.read_t_min <= now_min + clock_error_min:
        return Arrival.FROM_THE_FUTURE
    if last is not None:
        if stamp.number == last.number:
            return Arrival.REPEATED
        if stamp.number < last.number or stamp.read_t_min <= last.read_t_min:
            return Arrival.OUT_OF_ORDER
    return Arrival.LATE if now_min - stamp.read_t_min > late_after_min else Arrival.ON_TIME


def receive(
    last: Stamp | None,
    observation: Observation,
    now_min: float,
    *,
    late_after_min: float = 5.0,
    clock_error_min: float = _CLOCK_ERROR_MIN,
) -> _Received:
    """Convert an observation for a controller: it is valid only if it arrived on time.

    Parameters are those of `received`. A late reading is not used, but it is remembered as the newest one; one from the
    future is not, so that a wrong clock does not make all that follow old.

    Examples
    --------
    >>> from glucoloop.control.wire import observation
    >>> seen = observation(104, setpoint_mg_dl=100.0, delivered_mU_min=22.3, number=7, read_t_min=35.0)
    >>> first = receive(None, seen, now_min=35.2)
    >>> first.arrival.name, bool(first.observation.valid)
    ('ON_TIME', True)
    >>> again = receive(first.last, seen, now_min=40.2)
    >>> again.arrival.name, bool(again.observation.valid)
    ('REPEATED', False)
    """
    arrival = received(last, observation, now_min, late_after_min=late_after_min, clock_error_min=clock_error_min)
    newest = _stamp(observation) if arrival in (Arrival.ON_TIME, Arrival.LATE) else last
    usable = observation.valid if arrival == Arrival.ON_TIME else jnp.zeros_like(observation.valid)
    return _Received(
        observation=dataclasses.replace(observation, valid=usable, number=None, read_t_min=None),
        arrival=arrival,
        last=newest,
    )


def holding(decision: Decision, now_min: float, *, sample_time_min: float, samples: int = 2) -> Decision:
    """A decision with the time until which it holds: for some samples, of which one may be lost by default."""
    check_sample_time(sample_time_min)
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 1:
        raise Refusal(f"a decision that holds for {samples!r} samples is not possible; give 1 or more")
    return dataclasses.replace(decision, holds_until_min=jnp.asarray(now_min + samples * sample_time_min))


def _stamp(observation: Observation) -> Stamp | None:
    """Number and time of a reading, or None unless both are finite."""
    if observation.number is None or observation.read_t_min is None:
        return None
    number, read = float(observation.number), float(observation.read_t_min)
    return Stamp(number, read) if math.isfinite(number) and math.isfinite(read) else None
