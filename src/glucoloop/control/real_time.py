"""A loop in real time: observations from what arrives, whether they are fresh, and until when a decision holds.

Received values become an observation, whatever they are. A sensor numbers its readings and gives the time of each; a
controller gives the time until which its dose holds. In a simulation both are on time by definition, so they are not
given, and a controller need not use either.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop._lazy_jax import jax, jnp
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
    >>> from glucoloop.control.real_time import observation
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


_SCALARS: Final = (int, float, np.integer, np.floating)
_ARRAYS: Final = (np.ndarray, jax.Array)
_TRUTHS: Final = (bool, np.bool_)


def observation(
    glucose_mg_dl: object,
    *,
    setpoint_mg_dl: object,
    delivered_mU_min: object,
    announced_carbs_g: object = 0.0,
    valid: object = True,
    number: object = None,
    read_t_min: object = None,
    time_of_day_min: object = None,
    announced_in_min: object = None,
) -> Observation:
    """Observation of one person from received values of any kind, as scalars; never raises.

    A number is an int, a float, or a scalar or array of shape () of NumPy or JAX, finite in the arithmetic in use. It
    is accepted without a check of plausibility, which is the task of a guard. A truth value is not a number, nor is a
    text of digits, since a sender of these has changed the format.

    A reading that is not a number is NaN and not valid, as is one with a `valid` that is neither true nor false; a
    setpoint or rate is then NaN, and an announcement, or one below 0, is 0 g. A number or a time, if given, is NaN.
    What each value means is told by `Observation`.

    Examples
    --------
    >>> seen = observation("104", setpoint_mg_dl=100.0, delivered_mU_min=None)
    >>> bool(seen.valid), float(seen.glucose_mg_dl), float(seen.delivered_mU_min)
    (False, nan, nan)
    >>> seen = observation(104, setpoint_mg_dl=100.0, delivered_mU_min=22.3)
    >>> bool(seen.valid), float(seen.glucose_mg_dl)
    (True, 104.0)
    """
    glucose, carbs = _number(glucose_mg_dl), _number(announced_carbs_g)
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose),
        valid=jnp.asarray(not math.isnan(glucose) and _is_true(valid)),
        setpoint_mg_dl=jnp.asarray(_number(setpoint_mg_dl)),
        delivered_mU_min=jnp.asarray(_number(delivered_mU_min)),
        announced_carbs_g=jnp.asarray(carbs if carbs > 0.0 else 0.0),
        number=None if number is None else jnp.asarray(_number(number)),
        read_t_min=None if read_t_min is None else jnp.asarray(_number(read_t_min)),
        time_of_day_min=None if time_of_day_min is None else jnp.asarray(_number(time_of_day_min)),
        announced_in_min=None if announced_in_min is None else jnp.asarray(_number(announced_in_min)),
    )


def _number(value: object) -> float:
    """A finite number, or NaN."""
    kind = type(value)  # and not isinstance, which believes what an object says of itself
    # Whatever goes wrong in somebody else's conversion, the answer is that this is no number.
    with contextlib.suppress(Exception):
        if issubclass(kind, _ARRAYS):
            array = np.asarray(value)
            if array.shape != () or not (
                jnp.issubdtype(array.dtype, jnp.integer) or jnp.issubdtype(array.dtype, jnp.floating)
            ):
                return math.nan
        elif not issubclass(kind, _SCALARS) or issubclass(kind, _TRUTHS):
            return math.nan
        number = float(value)  # type: ignore[arg-type]
        largest = float(jnp.finfo(jnp.result_type(float)).max)
        return number if abs(number) <= largest else math.nan
    return math.nan


def _is_true(value: object) -> bool:
    with contextlib.suppress(Exception):
        if issubclass(type(value), _ARRAYS):
            array = np.asarray(value)
            return array.shape == () and array.dtype == np.bool_ and bool(array)
        return issubclass(type(value), _TRUTHS) and bool(value)
    return False
