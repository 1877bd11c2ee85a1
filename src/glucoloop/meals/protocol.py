"""Protocols of a meal model: from eating to the appearance of glucose in the blood.

A meal model is upstream of the body: it depends on what is eaten alone, and the numbers of a model are a person's own.
There are two kinds. A linear one is a system whose input are jumps::

    s' = A s,    s(t_k) grows by size_k,    appearance = s_0

so that its answer to a jump, at any time after it, is a column of the matrix exponential, which each model writes down
in closed form; meals superpose by listing all their jumps. The other kind is any differential equation, which may
remember the meal: ``s' = f(s, rate of eating)``, with a jump of what it remembers at the start of each minute.
"""

from __future__ import annotations

from typing import Final, Protocol, TypeAlias, runtime_checkable

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.units import MG_PER_G

Values: TypeAlias = "jax.Array | npt.NDArray[np.float64]"


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
class LinearMealModel(Protocol):
    """Linear model of a person's gut: a pytree whose numbers are those of one person, or trail for many people.

    The first state is the rate at which glucose from meals appears in the blood [mg/min]; the second, where there is
    one, is the rate at which the stomach empties into the gut [mg/min].
    """

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of the state due to meals; every meal has the same number of jumps."""

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """``exp(A z)``, ``(states, states, *z.shape)``: the states z >= 0 minutes after a unit of each state."""


@runtime_checkable
class OdeMealModel(Protocol):
    """Model of a person's gut by its equations: a pytree whose numbers are one person's, or trail for many people.

    Time is cut into the points of the fine grid of a loop, each of about one minute. What is eaten within a point is
    eaten evenly over it, and a meal that begins within a point begins with it. A meal takes at least one minute, also
    one that is eaten at once.
    """

    def init(self) -> jax.Array:
        """State ``(states, ...)`` of somebody who has eaten nothing; what it remembers of a meal is part of it."""

    def at_point(self, state: jax.Array, eaten_mg: jax.Array, begins: jax.Array) -> jax.Array:
        """State after its jump at the start of a point, in which so much is eaten, and a meal begins or not."""

    def derivative(self, state: jax.Array, eating_mg_min: jax.Array) -> jax.Array:
        """Rate of change per minute at a rate of eating; zero for what changes by jumps only."""

    def appearance_mg_min(self, state: jax.Array) -> jax.Array:
        """Rate at which glucose from meals appears in the blood."""

    def emptying_mg_min(self, state: jax.Array) -> jax.Array:
        """Rate at which the stomach empties into the gut."""


MealModel = LinearMealModel | OdeMealModel
"""Model of a person's gut, of either kind."""


def matrix(*rows: tuple[jax.Array | float, ...]) -> jax.Array:
    """Build a matrix from its entries, each a number or an array over people."""
    entries = jnp.broadcast_arrays(*(entry for row in rows for entry in row))
    return jnp.stack(entries).reshape(len(rows), len(rows[0]), *entries[0].shape)


SHORTEST_EATING_MIN: Final = 1.0
"""Shortest time over which a meal is eaten, apart from a meal that is eaten at once."""


@pytree
class Ingestion:
    """The rate of eating itself, the only state [mg/min]; implements `MealModel`.

    Since a rate has to be finite, a meal takes at least one minute here, also one that is eaten at once.
    """

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of the rate of eating, ``2 * meals``."""
        dose_mg = jnp.asarray(eaten.carbs_g, float) * MG_PER_G
        eating_min = jnp.maximum(eaten.eating_min, SHORTEST_EATING_MIN)
        rate = dose_mg / eating_min
        begin = jnp.asarray(eaten.t_min, float) + jnp.zeros_like(rate)
        people = rate.shape[1:]
        return Jumps(
            t_min=jnp.stack([begin, begin + eating_min]).reshape(-1, *people),
            size=jnp.stack([rate, -rate]).reshape(1, -1, *people),
        )

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """Matrix exponential of a rate that stays constant between jumps."""
        return jnp.ones((1, 1, *jnp.shape(z_min)))
