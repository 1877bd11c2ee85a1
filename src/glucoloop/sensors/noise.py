"""Noise on a reading: white and bounded, or correlated from sample to sample."""

from __future__ import annotations

from typing import Any

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.sensors.protocol import Reading, Sensor, or_ideal
from glucoloop.sensors.settings import CorrelatedNoiseSettings, WhiteNoiseSettings


@pytree
class WhiteNoise:
    """Adds ``N(0, variance)``, clipped to ``+-bound``, to the reading of the inner sensor.

    It is the noise of Parker, Doyle and Peppas (1999), Sec. V: of power .1 at a sample time of .05 min and gain .85
    mg/dl, it has the variance ``.1 / .05 * .85^2 = 1.445``, and its largest deviation is given as 5 mg/dl.
    """

    inner: Sensor
    variance: jax.Array | float
    bound_mg_dl: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """The state is that of the sensor inside."""
        return self.inner.init(glucose_mg_dl, key)

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Read the inner sensor, with added noise."""
        noise_key, inner_key = jax.random.split(key)
        state, reading = self.inner.read(state, glucose_mg_dl, inner_key)
        glucose = reading.glucose_mg_dl
        noise = jnp.sqrt(self.variance) * jax.random.normal(noise_key, glucose.shape, glucose.dtype)
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

    Raises
    ------
    ValueError
        For a variance that is negative or not finite, or a bound that is not positive and finite.
    """
    WhiteNoiseSettings(variance, bound_mg_dl)
    return WhiteNoise(inner=or_ideal(inner), variance=variance, bound_mg_dl=bound_mg_dl)


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

    The error of a continuous glucose monitor lasts longer than a sample: M. Breton, B. Kovatchev, "Analysis, modeling,
    and simulation of the accuracy of continuous glucose sensors", J. Diabetes Sci. Technol. 2(5), 2008, found a
    first-order process with a correlation of about .7 between samples.
    """

    inner: Sensor
    variance: jax.Array | float
    correlation: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first reading; its error is drawn from the stationary distribution."""
        noise_key, inner = jax.random.split(key)
        error = jax.random.normal(noise_key, jnp.shape(glucose_mg_dl), jnp.result_type(float, glucose_mg_dl))
        return _State(inner=self.inner.init(glucose_mg_dl, inner), error=error)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, with added noise."""
        noise_key, inner = jax.random.split(key)
        inner_state, reading = self.inner.read(state.inner, glucose_mg_dl, inner)
        new = jax.random.normal(noise_key, state.error.shape, state.error.dtype)
        error = self.correlation * state.error + jnp.sqrt(1.0 - self.correlation**2) * new
        reported = reading.glucose_mg_dl + jnp.sqrt(self.variance) * error
        return _State(inner=inner_state, error=error), Reading(glucose_mg_dl=reported, valid=reading.valid)


@checked
def correlated_noise(variance: float = 9.0, correlation: float = 0.7, inner: Sensor | None = None) -> CorrelatedNoise:
    """Sensor with first-order correlated noise.

    Parameters
    ----------
    variance : float
        Variance of the error of a reading, (mg/dl)^2.
    correlation : float
        Correlation of the errors of two consecutive readings, 0 or more and below 1.

    Raises
    ------
    ValueError
        For a variance that is negative or not finite, or a correlation outside its bounds.
    """
    CorrelatedNoiseSettings(variance, correlation)
    return CorrelatedNoise(inner=or_ideal(inner), variance=variance, correlation=correlation)
