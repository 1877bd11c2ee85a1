"""Checks shared by this layer; values that JAX traces are not checked."""

from __future__ import annotations

import jax
import numpy as np
from jax.typing import ArrayLike
from numpy.typing import NDArray

from glucoloop.refusal import Refusal


def whole_number(name: str, value: object, least: int) -> int:
    """`value` as an int, refused unless it is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise Refusal(f"{name} is {value!r}: it must be a whole number of at least {least}.")
    return int(value)


def positive(name: str, value: float, unit: str) -> float:
    """`value` as a float, refused unless it is finite and above zero."""
    if not np.isfinite(value) or value <= 0:
        raise Refusal(f"{name} is {value} {unit}: it must be a finite number above 0 {unit}.")
    return float(value)


def concrete(value: ArrayLike) -> NDArray[np.float64] | None:
    """The numbers of an array, or None while JAX traces it."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value, dtype=float)


def finite(name: str, value: ArrayLike, mend: str) -> None:
    """Refuse an array that holds NaN or infinity."""
    numbers = concrete(value)
    if numbers is not None and not np.isfinite(numbers).all():
        where = int(np.flatnonzero(~np.isfinite(numbers).reshape(len(numbers), -1).all(axis=1))[0])
        raise Refusal(f"{name} are not finite at sample {where}: {mend}.")


def input_and_readings(insulin: ArrayLike, glucose: ArrayLike) -> None:
    """Refuse an input of N samples that does not come with its N + 1 readings, all finite."""
    shape, readings = np.shape(insulin), np.shape(glucose)
    if len(shape) != 1 or shape[0] == 0:
        raise Refusal(f"An insulin sequence of shape {shape} is not a one-dimensional one of at least 1 sample.")
    if not readings or readings[0] != shape[0] + 1:
        raise Refusal(
            f"{shape[0]} insulin samples need {shape[0] + 1} glucose readings, one at either end of each sample, "
            f"but the readings have shape {readings}: add the reading at the end of the last sample, "
            "or leave out the last insulin sample."
        )
    finite("The insulin rates", insulin, "give the rate that was infused")
    finite("The glucose readings", glucose, "use record_from_samples, which fills short gaps")
