"""What a controller may ask of a nonlinear internal model."""

from __future__ import annotations

from typing import Protocol

import jax


class NonlinearModel(Protocol):
    """A fasting person as a controller imagines him: a pytree of pure functions of a state vector ``(n,)``."""

    @property
    def sample_time_min(self) -> float:
        """Time between samples."""
        ...

    @property
    def state(self) -> jax.Array:
        """State at rest at the operating point."""
        ...

    @property
    def insulin_mU_min(self) -> jax.Array:
        """Infusion at the operating point."""
        ...

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the state, per minute."""
        ...

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """State one sample on, under a held infusion."""
        ...

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state."""
        ...
