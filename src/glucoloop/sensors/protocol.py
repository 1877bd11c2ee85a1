"""What the loop asks of a glucose sensor."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree


@pytree
class Reading:
    """One answer of a sensor."""

    glucose_mg_dl: jax.Array
    valid: jax.Array
    """False where the sensor knows that it has nothing to say."""


class Sensor(Protocol):
    """Turns the patient's glucose into readings. The state is any pytree; randomness comes from the key alone."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """State of a sensor that has long been seeing the given glucose."""
        ...

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Read once per sample, with a key of its own."""
        ...


def site_of(sensor: Sensor) -> str | None:
    """Where a sensor sits: as the innermost of nested sensors tells; None: where glucose is controlled."""
    inner: Any = sensor
    while hasattr(inner, "inner"):
        inner = inner.inner
    site: str | None = getattr(inner, "site", None)
    return site
