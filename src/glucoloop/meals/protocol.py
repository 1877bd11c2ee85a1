"""Protocol of a meal model: from eating to the appearance of glucose in the blood.

A meal model is a linear system whose input are jumps::

    s' = A s,    s(t_k) grows by size_k,    appearance = s_0

so that its answer to a jump, at any time after it, is a column of the matrix exponential, which each model writes down
in closed form. Meals superpose by listing all their jumps. The numbers of a model are a person's own.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree

Values = jax.Array | npt.NDArray[np.float64]


@pytree
class Eaten:
    """Meals as arrays ``(meals, ...)``, people trailing. A meal of 0 g counts as no meal."""

    t_min: Values
    """Time at which each meal begins."""
    carbs_g: Values
    """Carbohydrate of each meal."""
    eating_min: Values
    """Time over which each meal is eaten at a constant rate; 0 for a meal that is eaten at once."""


@pytree
class Jumps:
    """Jumps by which meals change the state of a meal model, people trailing."""

    t_min: jax.Array
    """(jumps, ...) time of each jump."""
    size: jax.Array
    """(inputs, jumps, ...) jump of each of the last ``inputs`` states at that time."""


@runtime_checkable
class MealModel(Protocol):
    """Model of a person's gut: a pytree whose numbers are those of one person, or have a trailing axis of people.

    The first state is the rate at which glucose from meals appears in the blood [mg/min]; the second, where there is
    one, is the rate at which the stomach empties into the gut [mg/min].
    """

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of the state due to meals; every meal has the same number of jumps."""

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """``exp(A z)``, ``(states, states, *z.shape)``: the states z >= 0 minutes after a unit of each state."""


def matrix(*rows: tuple[jax.Array | float, ...]) -> jax.Array:
    """Build a matrix from its entries, each a number or an array over people."""
    entries = jnp.broadcast_arrays(*(entry for row in rows for entry in row))
    return jnp.stack(entries).reshape(len(rows), len(rows[0]), *entries[0].shape)
