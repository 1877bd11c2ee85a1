"""Events of low glucose, counted as for a continuous sensor.

An event begins when glucose has been below a bound for 15 min, and ends when it has not been for 15 min.

References
----------
T. Battelino et al., "Continuous glucose monitoring and metrics for clinical trials: an international consensus
statement", Lancet Diabetes Endocrinol. 11(1), 2023: level 1 is below 70 mg/dl, level 2 below 54 mg/dl.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree

LEVEL_1_MG_DL: Final = 70.0
LEVEL_2_MG_DL: Final = 54.0
LASTING_MIN: Final = 15.0


@pytree
class LowEvents:
    """Events counted so far; all arrays have the shape of the people."""

    events: jax.Array
    going: jax.Array
    """Indicator, 1 within an event, else 0."""
    lasting: jax.Array
    """Samples in a row on the side of the bound on which the event, or its absence, would end."""

    @classmethod
    def none(cls, like: jax.Array) -> LowEvents:
        """State before the first sample."""
        zero = jnp.zeros_like(like)
        return cls(events=zero, going=zero, lasting=zero)

    def step(self, glucose_mg_dl: jax.Array, bound_mg_dl: float, samples: jax.Array | float) -> LowEvents:
        """Include a sample; `samples` in a row are 15 min."""
        going = self.going > 0.5
        turning = (glucose_mg_dl < bound_mg_dl) != going
        lasting = jnp.where(turning, self.lasting + 1.0, 0.0)
        turned = lasting >= samples
        begun = turned & ~going
        return LowEvents(
            events=self.events + begun.astype(self.events.dtype),
            going=jnp.where(turned, 1.0 - self.going, self.going),
            lasting=jnp.where(turned, 0.0, lasting),
        )


def samples_in_a_row(sample_time_min: float) -> int:
    """Number of samples in 15 min, at least 1."""
    return max(1, round(LASTING_MIN / sample_time_min))


def low_events(glucose_mg_dl: jax.Array, bound_mg_dl: float, samples: jax.Array | float) -> jax.Array:
    """Number of events in a run.

    Parameters
    ----------
    glucose_mg_dl : array, shape (samples, ...)
        Glucose at each sample.
    bound_mg_dl : float
    samples : () array or float
        Number of samples in 15 min; see `samples_in_a_row`.

    Returns
    -------
    Array, shape (...)
    """
    glucose = jnp.asarray(glucose_mg_dl)

    def one(so_far: LowEvents, glucose: jax.Array) -> tuple[LowEvents, None]:
        return so_far.step(glucose, bound_mg_dl, samples), None

    counted: LowEvents = jax.lax.scan(one, LowEvents.none(glucose[0]), glucose)[0]
    return counted.events
