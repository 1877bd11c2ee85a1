"""Protocol of a glucose sensor in the loop, and a sensor without error or delay."""

from __future__ import annotations

import math
from typing import Any, Protocol

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.refusal import Refusal


@pytree
class Reading:
    """One reading of a sensor, with its validity."""

    glucose_mg_dl: jax.Array
    valid: jax.Array
    """False where the sensor reports that it has no reading."""


class Sensor(Protocol):
    """Turns the patient's glucose into readings. The state is any pytree; randomness comes from the key alone."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """State of a sensor that has read the given glucose for a long time."""

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Read once per sample, with a key of its own."""


def site_of(sensor: Sensor) -> str | None:
    """Site of a sensor, that of the innermost of nested sensors; None is where glucose is controlled."""
    inner: Any = sensor
    while hasattr(inner, "inner"):
        inner = inner.inner
    site: str | None = getattr(inner, "site", None)
    return site


@pytree
class IdealSensor:
    """Reads glucose without noise or delay."""

    site: str | None = static(default=None)
    """Site of the sensor, one of the patient's `capabilities.sites`; None is where glucose is controlled."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[()]:
        """Empty state, since the sensor has no memory."""
        return ()

    def read(self, state: tuple[()], glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[tuple[()], Reading]:
        """Read the true glucose of this moment."""
        return state, Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.isfinite(glucose_mg_dl))


def or_ideal(inner: Sensor | None) -> Sensor:
    """The given sensor, or the ideal one for None."""
    return IdealSensor() if inner is None else inner


def checked_sample_time(sample_time_min: float) -> float:
    """A sample time, refused unless it is positive and finite."""
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")
    return float(sample_time_min)
