"""Model of a person made from the nominal model, with another basal rate, gain and lag of insulin."""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.models.nonlinear import FedModel, reading_of

LAG_MIN: Final = 55.0
"""Dominant lag of glucose behind insulin that is stretched, min: Parker, Doyle and Peppas (1999), Sec. III."""


@pytree
class IndividualModel:
    """The nominal person under a rate that is transformed by gain and lag; implements `FedModel`.

    The nominal model gets, in place of u::

        u0 + gain v,    v = w + (u - basal - w) / lag,    55 lag w' = u - basal - w

    v lags behind u by one time constant more and one less, so that a lag of ``55 lag`` min takes the place of one of 55
    min. With a gain and a lag of 1 only the basal rate differs. The state is the nominal one, then w.
    """

    nominal: FedModel
    insulin_mU_min: jax.Array
    """Basal rate of the person."""
    gain: jax.Array
    """Gain of insulin, relative to the nominal person's."""
    lag: jax.Array
    """Lag of insulin, relative to the nominal person's."""

    @property
    def sample_time_min(self) -> float:
        """Time between samples, that of the nominal model."""
        return self.nominal.sample_time_min

    @property
    def state(self) -> jax.Array:
        """State at rest at the basal rate."""
        return jnp.append(self.nominal.state, 0.0)

    def _forget(self) -> jax.Array:
        return self.sample_time_min / (LAG_MIN * self.lag)

    def _given(self, w: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        away = insulin_mU_min - self.insulin_mU_min
        return self.nominal.insulin_mU_min + self.gain * (w + (away - w) / self.lag)

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute, under the transformed rate."""
        w = x[-1]
        lagging = (insulin_mU_min - self.insulin_mU_min - w) / (LAG_MIN * self.lag)
        return jnp.append(self.nominal.derivative(x[:-1], self._given(w, insulin_mU_min)), lagging)

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion."""
        return self.advance_fed(x, insulin_mU_min, jnp.zeros(3))

    def advance_fed(self, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array) -> jax.Array:
        """State one sample on with glucose from meals; the nominal model gets the mean of v over the sample."""
        w, away = x[-1], insulin_mU_min - self.insulin_mU_min
        z = self._forget()
        mean = away + (w - away) * -jnp.expm1(-z) / z
        later = away + (w - away) * jnp.exp(-z)
        given = self._given(mean, insulin_mU_min)
        return jnp.append(self.nominal.advance_fed(x[:-1], given, appearance_mg_min), later)

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state, by the nominal model."""
        return self.nominal.glucose_mg_dl(x[:-1])

    def reading_mg_dl(self, x: jax.Array) -> jax.Array:
        """Reading of a sensor without noise, by the nominal model."""
        return reading_of(self.nominal)(x[:-1])


def individual_model(
    nominal: FedModel, basal_insulin_mU_min: jax.Array, gain: jax.Array | float = 1.0, lag: jax.Array | float = 1.0
) -> IndividualModel:
    """A model of a person whose basal rate is known, and perhaps the gain and lag of insulin.

    Parameters
    ----------
    basal_insulin_mU_min : () array
    gain, lag : () array
        Gain and lag of insulin relative to the nominal person's, above 0.
    """
    return IndividualModel(
        nominal=nominal,
        insulin_mU_min=jnp.asarray(basal_insulin_mU_min, float),
        gain=jnp.asarray(gain, float),
        lag=jnp.asarray(lag, float),
    )
