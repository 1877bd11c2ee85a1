"""Error of a continuous glucose monitor: calibration that changes with time, and noise that lasts.

With ``d`` days since the insertion, or since the last calibration by the person, and ``IG`` glucose at the sensor::

    reading = (a0 + a1 d + a2 d^2) IG + (b0 + b1 d + b2 d^2) + noise
    noise = shape(sum of processes),    e(k) = alpha1 e(k-1) + alpha2 e(k-2) + sigma n(k),    n(k) ~ N(0, 1)

The processes advance on a grid of their own, every `step_min`; between two of its points the noise is on the straight
line from one to the other, so that it is defined at any sample time. An interpolated noise has a smaller variance than
that of the points: of the AR(1) process of Breton and Kovatchev 15 % less in the middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree

_FINEST: Final = 10_000
CANDIDATES: Final = 64
"""Number of sensors that are drawn at once; all are refused with a probability below 1e-36."""


@dataclass(frozen=True)
class Process:
    """Autoregressive process of second order, in mg/dl unless the noise has a shape."""

    alpha1: float
    alpha2: float
    variance: float
    """Variance of its input, ``sigma^2``."""


@dataclass(frozen=True)
class Johnson:
    """Transformation ``xi + lambda sinh((e - gamma) / delta)`` of a normal variable, unbounded system of Johnson."""

    xi: float
    scale: float
    gamma: float
    delta: float

    def __call__(self, e: jax.Array) -> jax.Array:
        """Error in mg/dl of a normal number."""
        return self.xi + self.scale * jnp.sinh((e - self.gamma) / self.delta)


@dataclass(frozen=True)
class Spread:
    """Sensors that differ: ``(a0, a1, a2, b0, alpha1, alpha2, sigma)`` is normal, of those that are taken."""

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    stability_margin: float
    """Minimum distance of ``alpha2`` from ``1 - |alpha1|``."""
    largest_sd_mg_dl: float
    """Largest standard deviation of the noise."""


@dataclass(frozen=True)
class ErrorModel:
    """Constants of the errors of a sensor, as published; the values are part of a compiled loop."""

    gain: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """a0, a1, a2, by powers of a day."""
    offset_mg_dl: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """b0, b1, b2, by powers of a day."""
    processes: tuple[Process, ...] = ()
    shape: Johnson | None = None
    step_min: float = 5.0
    """Time between two points of the processes."""
    spread: Spread | None = None
    """Distribution of sensors that differ; its numbers take the place of those above."""
    calibrated_every_min: float = math.inf
    """Time between two calibrations by the person, at which the days begin again."""
    longest_wear_min: float = math.inf
    """Days for which the errors are known."""
    lag_min: float = 10.0
    """Usual lag of glucose at the sensor behind that of blood."""


@pytree
class Constants:
    """Constants of one sensor; people trail."""

    gain: jax.Array
    """(3, ...) coefficients by powers of a day."""
    offset_mg_dl: jax.Array
    """(3, ...) coefficients by powers of a day."""
    alpha1: jax.Array
    """(processes, ...) weight of the point before."""
    alpha2: jax.Array
    """(processes, ...) weight of the one before that."""
    sigma: jax.Array
    """(processes, ...) standard deviation of the input."""

    @property
    def variance(self) -> jax.Array:
        """Stationary variance of each process, ``(processes, ...)``; no such number if it is not stable."""
        rest = 1.0 - self.alpha2
        return self.sigma**2 * rest / ((1.0 + self.alpha2) * (rest**2 - self.alpha1**2))

    def begin(self, normal: jax.Array) -> jax.Array:
        """Two consecutive points ``(2, processes, ...)`` of the stationary processes, of as many normal numbers."""
        correlation = self.alpha1 / (1.0 - self.alpha2)
        sd = jnp.sqrt(self.variance)
        earlier = sd * normal[0]
        return jnp.stack([earlier, correlation * earlier + sd * jnp.sqrt(1.0 - correlation**2) * normal[1]])

    def advance(self, points: jax.Array, normal: jax.Array) -> jax.Array:
        """The next two points ``(2, processes, ...)``, of normal numbers ``(processes, ...)``."""
        new = self.alpha1 * points[1] + self.alpha2 * points[0] + self.sigma * normal
        return jnp.stack([points[1], new])

    def altered(self, glucose_mg_dl: jax.Array, days: jax.Array) -> jax.Array:
        """Glucose with the error of calibration."""
        a, b = self.gain, self.offset_mg_dl
        return (a[0] + (a[1] + a[2] * days) * days) * glucose_mg_dl + (b[0] + (b[1] + b[2] * days) * days)


def constants_of(model: ErrorModel) -> Constants:
    """Constants of a model all sensors of which are alike."""
    rows = np.array([(of.alpha1, of.alpha2, math.sqrt(of.variance)) for of in model.processes]).reshape(-1, 3)
    return Constants(
        gain=jnp.asarray(model.gain),
        offset_mg_dl=jnp.asarray(model.offset_mg_dl),
        alpha1=jnp.asarray(rows[:, 0]),
        alpha2=jnp.asarray(rows[:, 1]),
        sigma=jnp.asarray(rows[:, 2]),
    )


def _of_theta(theta: jax.Array) -> Constants:
    """Constants of ``(a0, a1, a2, b0, alpha1, alpha2, sigma)``, ``(7, ...)``."""
    none = jnp.zeros_like(theta[3])
    return Constants(
        gain=theta[:3],
        offset_mg_dl=jnp.stack([theta[3], none, none]),
        alpha1=theta[4:5],
        alpha2=theta[5:6],
        sigma=theta[6:7],
    )


def candidate(spread: Spread, normal: jax.Array) -> tuple[Constants, jax.Array]:
    """Sensor of normal numbers ``(7, ...)``, and whether it is taken: its noise is stable and not too large."""
    root = jnp.asarray(np.linalg.cholesky(np.array(spread.covariance)), normal.dtype)
    mean = jnp.asarray(spread.mean, normal.dtype).reshape(-1, *[1] * (normal.ndim - 1))
    result = _of_theta(mean + jnp.tensordot(root, normal, 1))
    alpha1, alpha2 = result.alpha1[0], result.alpha2[0]
    stable = (alpha2 >= -1.0) & (alpha2 <= 1.0 - jnp.abs(alpha1) - spread.stability_margin)
    return result, stable & (result.variance[0] <= spread.largest_sd_mg_dl**2)


def drawn(spread: Spread, normal: jax.Array) -> Constants:
    """The first sensor that is taken, of normal numbers ``(7, candidates, ...)``; the mean one if none is."""
    result, taken = candidate(spread, normal)
    first = jnp.argmax(taken, axis=0)

    def chosen(leaf: jax.Array, mean: jax.Array) -> jax.Array:
        one = jnp.take_along_axis(leaf, jnp.broadcast_to(first, (leaf.shape[0], 1, *first.shape)), axis=1)[:, 0]
        return jnp.where(taken.any(axis=0), one, mean.reshape(-1, *[1] * first.ndim))

    chosen_one: Constants = jax.tree.map(chosen, result, _of_theta(jnp.asarray(spread.mean)))
    return chosen_one


@dataclass(frozen=True)
class Ticks:
    """Ticks of a clock as seen at samples, counted in whole numbers so that nothing is lost by rounding.

    `ahead` of a tick are the parts, `of_tick` to a tick, by which a sample comes after the one before.
    """

    ahead: int
    of_tick: int

    @classmethod
    def seen(cls, sample_time_min: float, tick_min: float) -> Ticks:
        """Ticks for a sample time, whose ratio to them is kept to one part in 10^8."""
        ratio = Fraction(sample_time_min / tick_min).limit_denominator(_FINEST)
        return cls(ratio.numerator, ratio.denominator)
