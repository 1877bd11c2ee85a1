"""Pump that returns to the basal rate by itself when no command arrives: a command expires."""

from __future__ import annotations

from typing import Annotated, Any

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import DATA
from glucoloop.component.setting import About
from glucoloop.pumps.limits import PumpAround
from glucoloop.pumps.protocol import Delivery, deliver


def rate_in_force(
    command_mU_min: jax.Array, holds_until_min: jax.Array, now_min: jax.Array, basal_mU_min: jax.Array
) -> jax.Array:
    """Last commanded rate while it holds on the pump's clock, and the basal rate after it; NaN never holds."""
    return jnp.where(jnp.isfinite(command_mU_min) & (now_min < holds_until_min), command_mU_min, basal_mU_min)


@pytree
class _State:
    inner: Any
    command_mU_min: jax.Array
    """Last command that arrived."""
    unheard: jax.Array
    """Number of samples since then."""
    basal_mU_min: jax.Array


class Expiring(PumpAround, name="expiring"):
    """Returns to the basal rate if no command arrives for some samples.

    It keeps the last command until then; with 2 samples, one lost command changes nothing. NaN means that no command
    arrived. The inner pump keeps its limits on the way back to the basal rate, and the report is what it delivers. A
    bolus is given only at the sample in which it arrives, and never again while its command holds.
    """

    samples: Annotated[
        int, About("Samples for which a command holds, the one in which it arrives included.", at_least=1), DATA
    ] = 2

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _State:
        """State in which the rate that has been delivered for long is the basal rate."""
        return _State(
            inner=self.inner.init(insulin_mU_min, key),
            command_mU_min=insulin_mU_min,
            unheard=jnp.zeros_like(insulin_mU_min),
            basal_mU_min=insulin_mU_min,
        )

    def deliver(
        self, state: _State, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[_State, Delivery]:
        """Deliver the command, the one before while it holds, or the basal rate."""
        heard = jnp.isfinite(command_mU_min)
        unheard = jnp.where(heard, 0.0, state.unheard + 1.0)
        command = jnp.where(heard, command_mU_min, state.command_mU_min)
        rate = rate_in_force(command, jnp.asarray(self.samples), unheard, state.basal_mU_min)
        bolus = None if bolus_mU is None else jnp.where(heard, bolus_mU, 0.0)
        inner, delivery = deliver(self.inner, state.inner, rate, key, bolus)
        return _State(inner=inner, command_mU_min=command, unheard=unheard, basal_mU_min=state.basal_mU_min), delivery
