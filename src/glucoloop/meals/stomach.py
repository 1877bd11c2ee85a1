"""Digestion sample by sample, for an observer to whom the size of a meal is unknown: Lehmann and Deutsch (1992).

`lehmann_deutsch` gives the rate of appearance of a meal whose beginning and size are known. Here the same meal is
described sample by sample. As long as a meal lasts it is *served*, and a meal of D mg lasts D / 360 min. The stomach
empties at 360 mg/min times the share of the last 30 min in which food was served: a ramp, a plateau and a ramp::

    E(t) = 360 s(t),    s(t) = mean of what was served over [t - 30, t],    q' = E - q / 60,    appearance = q / 60

So a meal is two events, its beginning and its end, and the second tells its size.

This is the trapezoid of `lehmann_deutsch` exactly where meals begin and end at samples. A beginning within a sample is
spread over it. A meal of less than 10.8 g, whose ramps are shorter there, empties more evenly here.
"""

from __future__ import annotations

from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.meals.lehmann_deutsch import GUT_TIME_CONSTANT_MIN, PLATEAU_MG_MIN, RAMP_MIN
from glucoloop.units import MG_PER_G

SERVED_G_PER_MIN: Final = PLATEAU_MG_MIN / MG_PER_G
FAST_GUT_MIN: Final = 30.0
"""Time constant of a fast gut; that of Lehmann and Deutsch is 60 min."""


@pytree
class Stomach:
    """Carbohydrate that has been eaten and has not appeared yet; people trailing."""

    served: jax.Array
    """(n, ...) share of each of the last n samples, which make 30 min, in which a meal was served; the oldest first."""
    gut_mg: jax.Array
    """(...) present content of the gut q."""

    @property
    def emptying_mg_min(self) -> jax.Array:
        """(...) present rate of emptying E."""
        return _emptying_mg_min(self.served, 0.0)


@pytree
class Gut:
    """Speed of stomach and gut; see `gut_of`."""

    time_constant_min: Any
    fast: Any
    """0 for the ramps of Lehmann and Deutsch, 1 for ramps of half their length; between them the mean."""
    keeps: Any
    """Share of its content that is left after a sample in which nothing is added."""
    keeps_half: Any
    """The same after half a sample."""


def gut_of(time_constant_min: jax.typing.ArrayLike, sample_time_min: float) -> Gut:
    """Stomach and gut of a time constant T of 30 to 60 min, so that ``q' = E - q / T``; the ramps shorten with it."""
    # NumPy computes once what is known when the program is made.
    xp: Any = jnp if isinstance(time_constant_min, jax.Array) else np
    return Gut(
        time_constant_min=time_constant_min,
        fast=(GUT_TIME_CONSTANT_MIN - time_constant_min) / (GUT_TIME_CONSTANT_MIN - FAST_GUT_MIN),
        keeps=xp.exp(-sample_time_min / time_constant_min),
        keeps_half=xp.exp(-sample_time_min / 2.0 / time_constant_min),
    )


def ramp_samples(sample_time_min: float) -> int:
    """Number of samples of a ramp of the emptying, at least one."""
    return max(1, round(RAMP_MIN / sample_time_min))


def empty_stomach(like: jax.Array, sample_time_min: float) -> Stomach:
    """Stomach and gut of a person who has eaten nothing."""
    nothing = jnp.zeros_like(like)
    return Stomach(served=jnp.zeros((ramp_samples(sample_time_min), *nothing.shape)), gut_mg=nothing)


def digest(
    stomach: Stomach, served: jax.Array, sample_time_min: float, gut: Gut | None = None
) -> tuple[Stomach, jax.Array]:
    """Digestion over one sample: the state at its end, and Legendre moments ``(3, ...)`` of the appearance [mg/min].

    `served` is the share of the sample in which a meal is served, more than 1 where meals overlap. The moments are
    those of the parabola through beginning, middle and end of the sample. The usual gut is that of Lehmann and Deutsch,
    of 60 min.
    """
    gut = gut_of(GUT_TIME_CONSTANT_MIN, sample_time_min) if gut is None else gut
    h, T = sample_time_min, gut.time_constant_min
    E = _emptying_mg_min(stomach.served, gut.fast)
    later = jnp.concatenate([stomach.served[1:], jnp.broadcast_to(served, E.shape)[None]])
    to = _emptying_mg_min(later, gut.fast)
    slope = (to - E) / h
    fading = stomach.gut_mg - T * E + T * T * slope  # q = T (E + slope t) - T^2 slope + fading e^(-t/T)
    middle = T * (E + slope * h / 2.0) - T * T * slope + fading * gut.keeps_half
    end = T * to - T * T * slope + fading * gut.keeps
    a, b, c = stomach.gut_mg / T, middle / T, end / T
    moments = jnp.stack([(a + 4.0 * b + c) / 6.0, (c - a) / 6.0, (a + c - 2.0 * b) / 15.0])
    return Stomach(served=later, gut_mg=end), moments


def _emptying_mg_min(served: jax.Array, fast: jax.Array | float) -> jax.Array:
    """Rate of emptying after ``(n, ...)`` shares of the last samples: their mean, or if fast that of the later half."""
    half = served.shape[0] // 2
    before, late = jnp.sum(served[:half], axis=0), jnp.sum(served[half:], axis=0)
    usual = (before + late) / served.shape[0]
    return PLATEAU_MG_MIN * (usual + fast * (late / (served.shape[0] - half) - usual))


def steadily(appearance_mg_min: jax.Array) -> jax.Array:
    """Legendre moments ``(3, ...)`` of a rate of appearance that is held."""
    none = jnp.zeros_like(appearance_mg_min)
    return jnp.stack([appearance_mg_min, none, none])


MEALS: Final = 4
"""Largest number of announced meals under way at once; a further one is added to the one that ends first."""


@pytree
class Announced:
    """Remainder of the announced meals; people trailing."""

    remaining_min: jax.Array
    """(MEALS, ...) time for which each is still served."""


def nothing_announced(like: jax.Array) -> Announced:
    """State without any announced meal."""
    return Announced(remaining_min=jnp.zeros((MEALS, *jnp.shape(like))))


def announce(announced: Announced, carbs_g: jax.Array) -> Announced:
    """Begin a meal; an amount that is not positive and finite is ignored."""
    carbs = jnp.where((carbs_g > 0.0) & jnp.isfinite(carbs_g), carbs_g, 0.0)
    first = jnp.argmin(announced.remaining_min, axis=0)
    free = jnp.arange(MEALS).reshape(MEALS, *(1,) * jnp.ndim(first)) == first
    return Announced(remaining_min=announced.remaining_min + jnp.where(free, carbs / SERVED_G_PER_MIN, 0.0))


def serve(announced: Announced, sample_time_min: float) -> tuple[Announced, jax.Array]:
    """Advance by one sample: the remainder, and the served share of the sample, added over meals."""
    served_min = jnp.minimum(announced.remaining_min, sample_time_min)
    remaining = Announced(remaining_min=announced.remaining_min - served_min)
    return remaining, jnp.sum(served_min, axis=0) / sample_time_min
