"""Rates within bounds that minimise one-sided costs of outputs linear in the rates, in a fixed number of steps.

The objective, in the rates u and with the outputs ``e = e_0 + A (u - u_0)`` and ``c = c_0 + A (u - u_0)``::

    sum_i w_i [ h(e_i) + b/2 max(0, -e_i)^2 + f/2 max(0, -c_i)^2 ] + 1/2 sum_j r_j (u_j - p_j)^2,    l <= u <= m

where h is Huber's function of ``max(0, e)``: half its square up to a limit and straight beyond. It is convex, and
quadratic in pieces. Each round minimises the quadratic with the curvature that each output has where it lies, within
the bounds by coordinate descent, and goes to the best of some points on the way there. Nothing branches.

References
----------
O. L. Mangasarian, A finite Newton method for classification, Optim. Methods Softw. 17(5), 2002, 913-929.
P. Tseng, Convergence of a block coordinate descent method, J. Optim. Theory Appl. 109, 2001, 475-494.
"""

from __future__ import annotations

from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree

ROUNDS: Final = 4
_SWEEPS: Final = 5
_MIN_BEND: Final = 1e-12
_ON_THE_WAY: Final = (1.0, 0.5, 0.2, 0.05)


@pytree
class OneSided:
    """Costs of the outputs ``(p,)``."""

    weight: Any
    """Weight w of each output, ``(p,)``."""
    straight_beyond: Any
    """Size of an output above 0 beyond which its cost is straight."""
    below: Any
    """b, how many times as dear an output below 0 is."""
    floor: Any
    """f, the same for the second outputs."""

    def cost(self, e: jax.Array, c: jax.Array) -> jax.Array:
        """Cost of outputs."""
        up, limit = jnp.maximum(e, 0.0), self.straight_beyond
        near = jnp.minimum(up, limit)
        low, short = jnp.minimum(e, 0.0), jnp.minimum(c, 0.0)
        return jnp.sum(self.weight * (near * (up - 0.5 * near) + 0.5 * (self.below * low**2 + self.floor * short**2)))

    def slopes(self, e: jax.Array, c: jax.Array) -> tuple[jax.Array, jax.Array]:
        """First derivative by a common change of both outputs, and a curvature that is never below the second."""
        up, limit = jnp.maximum(e, 0.0), self.straight_beyond
        slope = jnp.minimum(up, limit) + self.below * jnp.minimum(e, 0.0) + self.floor * jnp.minimum(c, 0.0)
        bend = jnp.where(e > limit, limit / jnp.maximum(up, limit), jnp.where(e > 0.0, 1.0, self.below))
        return self.weight * slope, self.weight * (bend + jnp.where(c < 0.0, self.floor, 0.0))


def minimise_rates(
    costs: OneSided,
    e: jax.Array,
    c: jax.Array,
    A: jax.Array,
    start: jax.Array,
    preferred: jax.Array,
    preference: jax.Array,
    least: jax.Array,
    most: jax.Array,
) -> jax.Array:
    """Rates ``(m,)`` within bounds from rates to start with, at which the outputs are e and c.

    `preferred` are p and `preference` r, ``(m,)``.
    """

    def one(carry: tuple[jax.Array, jax.Array], _: None) -> tuple[tuple[jax.Array, jax.Array], None]:
        u, moved = carry
        slope, bend = costs.slopes(e + moved, c + moved)
        gradient = A.T @ slope + preference * (u - preferred)
        step = _descend(A.T @ (bend[:, None] * A) + jnp.diag(preference), gradient, least - u, most - u)
        along = A @ step

        def objective(share: float) -> jax.Array:
            there, away = moved + share * along, u + share * step - preferred
            return costs.cost(e + there, c + there) + 0.5 * jnp.sum(preference * away**2)

        best, lowest = jnp.zeros(()), objective(0.0)
        for share in _ON_THE_WAY:
            value = objective(share)
            best, lowest = jnp.where(value < lowest, share, best), jnp.minimum(value, lowest)
        return (u + best * step, moved + best * along), None

    u = jnp.clip(start, least, most)
    return jax.lax.scan(one, (u, A @ (u - start)), None, length=ROUNDS)[0][0]


def _descend(H: jax.Array, gradient: jax.Array, least: jax.Array, most: jax.Array) -> jax.Array:
    """Step within bounds that brings ``g' d + d' H d / 2`` down, coordinate by coordinate."""

    def sweep(carry: tuple[jax.Array, jax.Array], _: None) -> tuple[Any, None]:
        d, slope = carry
        steps = list(d)
        for j in range(len(steps)):
            wanted = jnp.clip(steps[j] - slope[j] / jnp.maximum(H[j, j], _MIN_BEND), least[j], most[j])
            slope, steps[j] = slope + H[:, j] * (wanted - steps[j]), wanted
        return (jnp.stack(steps), slope), None

    return jax.lax.scan(sweep, (jnp.zeros_like(gradient), gradient), None, length=_SWEEPS)[0][0]
