"""Nonlinear internal models of a controller: protocols, and the model of a person made from the nominal one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final, Protocol

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree

LAG_MIN: Final = 55.0
"""Dominant lag of glucose behind insulin that is stretched, min: Parker, Doyle and Peppas (1999), Sec. III."""


class Equations(Protocol):
    """Differential equations of a fasting person: a pytree of pure functions of a state vector ``(n,)``."""

    @property
    def sample_time_min(self) -> float:
        """Time between samples."""

    @property
    def state(self) -> jax.Array:
        """Steady state at the operating point."""

    @property
    def insulin_mU_min(self) -> jax.Array:
        """Infusion at the operating point."""

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute."""

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state."""


class NonlinearModel(Equations, Protocol):
    """Internal model of a fasting person, sample by sample."""

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion."""


class FedModel(NonlinearModel, Protocol):
    """The nonlinear model of a controller that takes meals into account."""

    def advance_fed(self, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion, while glucose from meals appears in the gut's blood.

        `appearance_mg_min` is ``(3,)``: the Legendre moments of the rate over the sample, as
        `meals.linear.appearance_moments` defines them. A rate r that is held is ``(r, 0, 0)``.
        """


def advance_with_rough_tangents(
    model: FedModel, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array
) -> jax.Array:
    """State one sample on, as `FedModel.advance_fed` has it, with the derivatives of the model's `roughly`.

    A controller that linearises along a forecast needs no derivatives as accurate as its forecast.
    """
    rough = roughly(model).advance_fed(x, insulin_mU_min, appearance_mg_min)
    fine = model.advance_fed(*jax.lax.stop_gradient((x, insulin_mU_min, appearance_mg_min)))
    return rough + jax.lax.stop_gradient(fine - rough)


def roughly(model: FedModel) -> FedModel:
    """The same model with a less accurate integrator, by its method of this name; itself if it has none."""
    rougher: Callable[[], FedModel] = getattr(model, "roughly", lambda: model)
    return rougher()


def own_reading(model: Equations) -> Callable[[jax.Array], jax.Array] | None:
    """Function from a state to the reading of a sensor without noise, or None where the sensor reads glucose.

    A model whose sensor reads something else has it as a method ``reading_mg_dl``.
    """
    return getattr(model, "reading_mg_dl", None)


def reading_of(model: Equations) -> Callable[[jax.Array], jax.Array]:
    """Function from a state to the reading of a sensor without noise."""
    return own_reading(model) or model.glucose_mg_dl


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
        """Steady state at the basal rate."""
        return jnp.append(self.nominal.state, 0.0)

    def roughly(self) -> IndividualModel:
        """The same person by a less accurate integrator."""
        return dataclasses.replace(self, nominal=roughly(self.nominal))

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
        z = self.sample_time_min / (LAG_MIN * self.lag)
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
    """A model of a person whose basal rate is known, and perhaps gain and lag relative to the nominal person's."""
    return IndividualModel(
        nominal=nominal,
        insulin_mU_min=jnp.asarray(basal_insulin_mU_min, float),
        gain=jnp.asarray(gain, float),
        lag=jnp.asarray(lag, float),
    )
