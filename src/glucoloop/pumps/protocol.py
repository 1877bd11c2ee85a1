"""What the loop asks of a pump."""

from __future__ import annotations

from typing import Any, Protocol

import jax


class Pump(Protocol):
    """Turns a commanded rate into a delivered one. The state is any pytree."""

    def init(self, insulin_mU_min: jax.Array) -> Any:
        """State of a pump that has long been delivering the given rate."""
        ...

    def deliver(self, state: Any, command_mU_min: jax.Array) -> tuple[Any, jax.Array]:
        """Rate delivered until the next command; never raises, whatever the command."""
        ...
