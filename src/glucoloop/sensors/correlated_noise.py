"""Noise on a reading that is correlated from sample to sample: a first-order autoregressive process.

The error of a continuous glucose monitor lasts longer than a sample: M. Breton, B. Kovatchev, "Analysis, modeling, and
simulation of the accuracy of continuous glucose sensors", J. Diabetes Sci. Technol. 2(5), 2008, found a first-order
process with a correlation of about .7 between samples.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.parts.sensors import CorrelatedNoiseSettings
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class _State:
    inner: Any
    error: jax.Array
    """Error of the latest reading, in standard deviations."""


@pytree
class CorrelatedNoise:
    """Adds a stationary first-order process to the reading of the inner sensor.

    With ``w`` independent and normal with variance 1::

        e(k) = c e(k-1) + sqrt(1 - c^2) w(k),    reading = glucose + sqrt(variance) e(k)
    """

    inner: Sensor
    variance: jax.Array | float
    correlation: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first reading; its error is drawn from the stationary distribution."""
        own, inner = jax.random.split(key)
        error = jax.random.normal(own, jnp.shape(glucose_mg_dl), jnp.result_type(float, glucose_mg_dl))
        return _State(inner=self.inner.init(glucose_mg_dl, inner), error=error)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, with added noise."""
        own, inner = jax.random.split(key)
        held, reading = self.inner.read(state.inner, glucose_mg_dl, inner)
        new = jax.random.normal(own, state.error.shape, state.error.dtype)
        error = self.correlation * state.error + jnp.sqrt(1.0 - self.correlation**2) * new
        told = reading.glucose_mg_dl + jnp.sqrt(self.variance) * error
        return _State(inner=held, error=error), Reading(glucose_mg_dl=told, valid=reading.valid)


@checked
def correlated_noise(variance: float = 9.0, correlation: float = 0.7, inner: Sensor | None = None) -> CorrelatedNoise:
    """Sensor with first-order correlated noise.

    Parameters
    ----------
    variance : float
        Variance of the error of a reading, (mg/dl)^2.
    correlation : float
        Correlation of the errors of two consecutive readings, 0 or more and below 1.
    inner : Sensor, optional
        Inner sensor; an ideal one by default.

    Raises
    ------
    ValueError
        For a variance that is negative or not finite, or a correlation outside its bounds.
    """
    CorrelatedNoiseSettings(variance, correlation)
    return CorrelatedNoise(
        inner=inner if inner is not None else IdealSensor(), variance=variance, correlation=correlation
    )
