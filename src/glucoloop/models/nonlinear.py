"""Protocols of a nonlinear internal model of a controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import jax


class NonlinearModel(Protocol):
    """Internal model of a fasting person: a pytree of pure functions of a state vector ``(n,)``."""

    @property
    def sample_time_min(self) -> float:
        """Time between samples."""

    @property
    def state(self) -> jax.Array:
        """State at rest at the operating point."""

    @property
    def insulin_mU_min(self) -> jax.Array:
        """Infusion at the operating point."""

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute."""

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion."""

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state."""


class FedModel(NonlinearModel, Protocol):
    """The nonlinear model of a controller that takes meals into account."""

    def advance_fed(self, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion, while glucose from meals appears in the gut's blood.

        `appearance_mg_min` is ``(3,)``: the Legendre moments of the rate over the sample, as
        `meals.absorption.appearance_moments` defines them. A rate r that is held is ``(r, 0, 0)``.
        """


def own_reading(model: NonlinearModel) -> Callable[[jax.Array], jax.Array] | None:
    """Function from a state to the reading of a sensor without noise, or None where the sensor reads glucose.

    A model whose sensor reads something else has it as a method ``reading_mg_dl``.
    """
    return getattr(model, "reading_mg_dl", None)


def reading_of(model: NonlinearModel) -> Callable[[jax.Array], jax.Array]:
    """Function from a state to the reading of a sensor without noise."""
    return own_reading(model) or model.glucose_mg_dl
