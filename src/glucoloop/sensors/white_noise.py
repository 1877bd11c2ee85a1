"""White noise on a reading, bounded as in Parker, Doyle and Peppas (1999), Sec. V.

The paper's band-limited noise of power .1 at a sample time of .05 min and gain .85 mg/dl has the variance
``.1 / .05 * .85^2 = 1.445``, and its largest deviation is given as 5 mg/dl.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.parts.sensors import WhiteNoiseSettings
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class WhiteNoise:
    """Adds ``N(0, variance)``, clipped to ``+-bound``, to the reading of the inner sensor."""

    inner: Sensor
    variance: jax.Array | float
    bound_mg_dl: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """The state is that of the sensor inside."""
        return self.inner.init(glucose_mg_dl, key)

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Read the inner sensor, with added noise."""
        own, inner = jax.random.split(key)
        state, reading = self.inner.read(state, glucose_mg_dl, inner)
        glucose = reading.glucose_mg_dl
        noise = jnp.sqrt(self.variance) * jax.random.normal(own, glucose.shape, glucose.dtype)
        noise = jnp.clip(noise, -self.bound_mg_dl, self.bound_mg_dl)
        return state, Reading(glucose_mg_dl=glucose + noise, valid=reading.valid)


@checked
def white_noise(variance: float = 1.45, bound_mg_dl: float = 5.0, inner: Sensor | None = None) -> WhiteNoise:
    """Sensor with bounded white noise.

    Parameters
    ----------
    variance : float
        Variance of the noise of each reading, (mg/dl)^2.
    bound_mg_dl : float
        Largest deviation.
    inner : Sensor, optional
        Inner sensor; an ideal one by default.

    Raises
    ------
    ValueError
        For a variance that is negative or not finite, or a bound that is not positive and finite.
    """
    WhiteNoiseSettings(variance, bound_mg_dl)
    return WhiteNoise(inner=inner if inner is not None else IdealSensor(), variance=variance, bound_mg_dl=bound_mg_dl)
