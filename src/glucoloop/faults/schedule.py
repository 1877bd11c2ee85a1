"""Episodes in which a fault of a sensor or a pump is present.

Time is counted in samples: the first reading or command is number 0. All counting is done with floats, which are exact
up to 2**24 samples even in single precision.
"""

from __future__ import annotations

import math
from typing import Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree, static
from glucoloop.refusal import Refusal

LARGEST_KEY: Final = 65535

# Far from the small numbers by which keys are split elsewhere: `jax.random.split` gives the very keys that folding in
# 0 and 1 gives, so that without it a fault of key 0 would draw the numbers of the noise that it is put around.
_FAULTS: Final = 0x4641554C


@pytree
class Episode:
    """State of the episodes of a fault."""

    until: jax.Array
    """Samples until the planned onset; below zero once it is over."""
    age: jax.Array
    """Samples since the fault began, 0 at its first sample; -1 while it is absent."""


@pytree
class Episodes:
    """Planned or random times of a fault; make them with `once`, `recurring`, `always` or `never`.

    All numbers are data: people may differ in them, people trailing.
    """

    earliest: jax.Array | float
    """Number of the first sample at which the planned episode may begin; inf if none is planned."""
    latest: jax.Array | float
    """Last sample of the onset, which is drawn once, uniformly from the whole numbers from `earliest` to `latest`."""
    length: jax.Array | float
    """Number of samples of an episode, 1 or more; inf for an episode that lasts to the end."""
    probability: jax.Array | float = 0.0
    """Probability that an episode begins at a sample without one; used if `random` is set."""
    random: bool = static(default=False)
    key: int = static(default=0)
    """Number that makes the random draws of this fault differ from those of others around the same sensor or pump."""

    def own(self, key: jax.Array) -> jax.Array:
        """Key for random draws of a fault itself; the given key goes on to the inner object."""
        own: jax.Array = jax.random.fold_in(key, _FAULTS + self.key)
        return own

    def init(self, like: jax.Array, key: jax.Array) -> Episode:
        """State before the first sample, with the shape of an array; the onset is drawn from the key."""
        drawn = jax.random.uniform(self.own(key), jnp.shape(like), jnp.result_type(float, like))
        span = jnp.where(self.latest > self.earliest, self.latest - self.earliest, 0.0)
        later = jnp.minimum(jnp.floor(drawn * (span + 1.0)), span)
        return Episode(until=self.earliest + later, age=-jnp.ones_like(drawn))

    def step(self, state: Episode, key: jax.Array) -> tuple[Episode, jax.Array]:
        """Advance to the next sample, and give the age of the fault there: -1 if it is absent."""
        goes_on = (state.age >= 0.0) & (state.age + 1.0 < self.length)
        begins = state.until == 0.0
        if self.random:
            drawn = jax.random.uniform(self.own(key), state.age.shape, state.age.dtype)
            begins = begins | (drawn < self.probability)
        age = jnp.where(goes_on, state.age + 1.0, jnp.where(begins, 0.0, -1.0))
        return Episode(until=state.until - 1.0, age=age), age


def once(start_sample: int, samples: float = math.inf, *, latest_sample: int | None = None, key: int = 0) -> Episodes:
    """Episodes with a single occurrence.

    Parameters
    ----------
    start_sample : int
        Number of the sample at which it begins; the first one is 0.
    samples : int or inf
        Number of samples of the episode; by default it lasts to the end.
    latest_sample : int, optional
        Last possible onset. If given, the onset is drawn uniformly from `start_sample` to this sample, for each person.
    key : int
        Number that makes the random draws of this fault differ from those of others around the same sensor or pump;
        0 to 65535.
    """
    start = _whole("an onset at sample", start_sample, least=0)
    latest = start if latest_sample is None else _whole("a latest onset at sample", latest_sample, least=start_sample)
    return Episodes(earliest=start, latest=latest, length=_length(samples), key=_checked_key(key))


def recurring(probability: float, samples: float = 1, *, key: int = 0) -> Episodes:
    """Episodes that begin at random, repeatedly.

    Parameters
    ----------
    probability : float
        Probability that an episode begins at a sample without one. With episodes of n samples and a probability p, the
        fault is present in a share ``n p / (n p + 1 - p)`` of the samples.
    samples : int or inf
        Number of samples of each episode.
    key : int
        Number as for `once`.
    """
    if isinstance(probability, bool) or not 0.0 <= probability <= 1.0:
        raise Refusal(f"a probability of {probability} per sample is not possible; give a value from 0 to 1")
    return Episodes(
        earliest=math.inf,
        latest=math.inf,
        length=_length(samples),
        probability=float(probability),
        random=True,
        key=_checked_key(key),
    )


def always(*, key: int = 0) -> Episodes:
    """A fault that is present from the first sample to the last."""
    return Episodes(earliest=0.0, latest=0.0, length=math.inf, key=_checked_key(key))


def never(*, key: int = 0) -> Episodes:
    """A fault that is never present: the wrapped object behaves as without it, bit for bit."""
    return Episodes(earliest=math.inf, latest=math.inf, length=math.inf, key=_checked_key(key))


def _whole(what: str, value: float, *, least: int) -> float:
    if isinstance(value, bool) or not math.isfinite(value) or value != math.floor(value) or value < least:
        raise Refusal(f"{what} {value} is not possible; give a whole number of {least} or more")
    return float(value)


def _length(samples: float) -> float:
    if samples == math.inf:
        return math.inf
    if isinstance(samples, bool) or not math.isfinite(samples) or samples != math.floor(samples) or samples < 1:
        raise Refusal(f"an episode of {samples} samples is not possible; give a whole number of 1 or more, or infinity")
    return float(samples)


def _checked_key(key: int) -> int:
    if isinstance(key, bool) or not isinstance(key, int | np.integer) or not 0 <= key <= LARGEST_KEY:
        raise Refusal(f"a key of {key!r} is not possible; give a whole number from 0 to {LARGEST_KEY}")
    return key
