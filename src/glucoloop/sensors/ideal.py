"""Sensor without error or delay."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.sensors.protocol import Reading


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
