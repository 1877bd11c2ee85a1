"""Sensor that carries along what a twin does not explain: the residual of each reading of a record."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class ResidualSensor:
    """Adds to the reading at each sample of a run the residual of that sample."""

    inner: Sensor
    residual_mg_dl: jax.Array
    """``(samples, ...)`` residual at each sample, people trailing."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """Number of the sample, and the state of the sensor inside."""
        return jnp.zeros((), int), self.inner.init(glucose_mg_dl, key)

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Read the inner sensor, and add the residual."""
        sample, inner = state
        inner, reading = self.inner.read(inner, glucose_mg_dl, key)
        glucose = reading.glucose_mg_dl + self.residual_mg_dl[sample]
        return (sample + 1, inner), Reading(glucose_mg_dl=glucose, valid=reading.valid)
