"""Noise on a reading: white and bounded, or correlated from sample to sample."""

from __future__ import annotations

from typing import Annotated, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.effects import Need
from glucoloop.component.setting import About
from glucoloop.sensors.protocol import Reading, SensorAround
from glucoloop.unit_guess import NOISE_BOUND, NOISE_VARIANCE

_NOISE: Final = Need("the variance of the noise is 0")


class WhiteNoise(SensorAround, name="white-noise"):
    """Bounded white noise on each reading.

    ``N(0, variance)``, clipped to ``+-bound``. It is the noise of Parker, Doyle and Peppas (1999), Sec. V: of power .1
    at a sample time of .05 min and gain .85 mg/dl, it has the variance ``.1 / .05 * .85^2 = 1.445``, and its largest
    deviation is given as 5 mg/dl.
    """

    variance: Annotated[
        float, About("Variance of the noise of each reading.", at_least=0.0, at_most=10_000.0, quantity=NOISE_VARIANCE)
    ] = 1.45
    bound_mg_dl: Annotated[
        float,
        About("Largest deviation of a reading.", above=0.0, at_most=1000.0, quantity=NOISE_BOUND, needs=(_NOISE,)),
    ] = 5.0

    def uses(self) -> frozenset[Need]:
        """Noise, if there is any to bound."""
        return frozenset({_NOISE} if self.variance else ())

    def recorded(self) -> None:
        """Leave the noise out: a record has its own."""

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


@pytree
class _State:
    inner: Any
    error: jax.Array
    """Error of the latest reading, in standard deviations."""


class CorrelatedNoise(SensorAround, name="correlated-noise"):
    """Noise that is correlated from sample to sample, a first-order process.

    It is stationary; with ``w`` independent and normal with variance 1::

        e(k) = c e(k-1) + sqrt(1 - c^2) w(k),    reading = glucose + sqrt(variance) e(k)

    The error of a continuous glucose monitor lasts longer than a sample: M. Breton, B. Kovatchev, "Analysis, modeling,
    and simulation of the accuracy of continuous glucose sensors", J. Diabetes Sci. Technol. 2(5), 2008, found a
    first-order process with a correlation of about .7 between samples.
    """

    sources = ("breton2008",)
    variance: Annotated[
        float, About("Variance of the error of each reading.", at_least=0.0, quantity=NOISE_VARIANCE)
    ] = 9.0
    correlation: Annotated[
        float, About("Correlation of the errors of two consecutive readings.", at_least=0.0, below=1.0)
    ] = 0.7

    def recorded(self) -> None:
        """Leave the noise out: a record has its own."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first reading; its error is drawn from the stationary distribution."""
        noise_key, inner_key = jax.random.split(key)
        error = jax.random.normal(noise_key, jnp.shape(glucose_mg_dl), jnp.result_type(float, glucose_mg_dl))
        return _State(inner=self.inner.init(glucose_mg_dl, inner_key), error=error)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, with added noise."""
        noise_key, inner_key = jax.random.split(key)
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, inner_key)
        new = jax.random.normal(noise_key, state.error.shape, state.error.dtype)
        error = self.correlation * state.error + jnp.sqrt(1.0 - self.correlation**2) * new
        reported = reading.glucose_mg_dl + jnp.sqrt(self.variance) * error
        return _State(inner=inner, error=error), Reading(glucose_mg_dl=reported, valid=reading.valid)


white_noise = WhiteNoise
"""The class under the name that it has as a function."""
