"""Controller of a loop whose doses come from outside."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.control.protocol import Decision, Observation, Status


@pytree
class ExternalDoses:
    """Controller whose rate and bolus are numbers of its own, which are set before each sample; it has no memory."""

    insulin_mU_min: jax.Array
    bolus_mU: jax.Array | None
    """Bolus, or None where the pump can give none."""
    sample_time_min: float

    heals: ClassVar = True

    @property
    def gives_boluses(self) -> bool:
        """Whether the pump can give boluses."""
        return self.bolus_mU is not None

    def init(self, observation: Observation) -> tuple[()]:
        """State without memory."""
        del observation
        return ()

    def step(self, state: tuple[()], observation: Observation) -> tuple[tuple[()], Decision]:
        """Decision with the dose from outside."""
        del observation
        status = jnp.asarray(int(Status.OK))
        return state, Decision(insulin_mU_min=self.insulin_mU_min, status=status, bolus_mU=self.bolus_mU)
