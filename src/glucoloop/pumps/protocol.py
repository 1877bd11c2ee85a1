"""What the loop asks of a pump."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree


@pytree
class Delivery:
    """What a pump did with a command."""

    insulin_mU_min: jax.Array
    """Rate that reaches the patient until the next command."""
    reported_mU_min: jax.Array
    """Rate that the pump says it delivered, which is all that a controller learns; not a number if it says nothing."""


class Pump(Protocol):
    """Turns a commanded rate into a delivered one. The state is any pytree; randomness comes from the key alone."""

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Any:
        """State of a pump that has long been delivering the given rate."""
        ...

    def deliver(self, state: Any, command_mU_min: jax.Array, key: jax.Array) -> tuple[Any, Delivery]:
        """What is delivered until the next command, with a key of its own; never raises, whatever the command."""
        ...
