"""Conversion of received values to an observation for a real-time loop, defined for any input."""

from __future__ import annotations

import contextlib
import math
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control.protocol import Observation

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
