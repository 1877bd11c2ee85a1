"""Innovations of a filter while the size of the sensor's correlated error is uncertain.

A steady filter is designed for one size of the error, and the readings may have another. Its innovations are then
larger or smaller than it expects, and no longer independent: each has a variance S and a correlation rho with the one
before, which follow from the covariance P of the error of its predictions::

    P = A P A' + Q + R (Phi K) (Phi K)',    A = Phi (I - K C)
    S = C P C' + R,    rho = (C A P C' - R C Phi K) / S

where Phi, C and Q are those of the size that is true, and K is the gain that is used. Given the innovation before, v',
one is normal with the mean rho v' and the variance S (1 - rho^2), so that a size is judged by what it does to a row of
innovations, beside every other explanation of the same readings.

References
----------
R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE Trans. Autom. Control 15(2), 1970.
D. T. Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE Trans. Autom. Control 10(4), 1965: a
probability for each value of what is uncertain.
"""

from __future__ import annotations

import dataclasses

from glucoloop._lazy_jax import jax, jnp, np, npt, scipy
from glucoloop._pytree import pytree
from glucoloop.estimation.noise_level import LEVELS_MG_DL, NoisyFilters, Numbers, shares, with_error


@pytree
class Innovations:
    """Innovations of the filters for each of `LEVELS_MG_DL`, first axis, where each is the true size, second axis."""

    variance: jax.Array
    correlation: jax.Array
    """Correlation with the innovation before."""

    def fixed(self, variance: jax.Array) -> Innovations:
        """Innovations of a filter for the size that is true: independent, with one variance."""
        return dataclasses.replace(
            self,
            variance=jnp.broadcast_to(variance, self.variance.shape),
            correlation=jnp.zeros_like(self.correlation),
        )

    def likelihood(
        self, deviation_mg_dl: jax.Array, innovation: jax.Array, before: jax.Array, stray: float
    ) -> jax.Array:
        """Likelihood ``(levels, ...)`` of each size for innovations of the filter at an estimate of it.

        `stray` is added to each density, as a share of its greatest value, so that an innovation far from all of them
        does not tell them apart.
        """
        share = shares(deviation_mg_dl)
        correlation = jnp.expand_dims(share @ self.correlation, -1)
        variance = jnp.expand_dims(share @ self.variance, -1) * (1.0 - correlation**2)
        left = innovation - correlation * before
        return (jnp.exp(-0.5 * left**2 / variance) + stray) / jnp.sqrt(variance)


def mean_size(probability: jax.Array) -> jax.Array:
    """Mean size, mg/dl, by the probabilities ``(levels, ...)`` of each of them with whatever else is uncertain."""
    return jnp.asarray(LEVELS_MG_DL) @ jnp.sum(probability, axis=-1)


def drifting(probability_of_change: float) -> Numbers:
    """Matrix ``(levels, levels)`` that passes probabilities on where a size may change by 1 mg/dl in a sample."""
    either = np.full(len(LEVELS_MG_DL) - 1, probability_of_change / 2.0)
    changes: Numbers = np.diag(either, 1) + np.diag(either, -1)
    return changes + np.diag(1.0 - changes.sum(axis=0))


def innovations_of(
    filters: NoisyFilters, Phi: npt.ArrayLike, C: npt.ArrayLike, Q: npt.ArrayLike, R: float
) -> Innovations:
    """Innovations of filters that were designed for the same model."""
    Phi, C, Q = (np.asarray(a, float) for a in (Phi, C, Q))
    worlds = [with_error(Phi, C, Q, deviation, float(filters.correlation)) for deviation in LEVELS_MG_DL]
    table = np.array([[_innovation(gain, *world, R) for world in worlds] for gain in np.asarray(filters.gain)])
    return Innovations(variance=jnp.asarray(table[..., 0]), correlation=jnp.asarray(table[..., 1]))


def _innovation(gain: Numbers, Phi: Numbers, C: Numbers, Q: Numbers, R: float) -> tuple[float, float]:
    """Variance of an innovation, and its correlation with the one before."""
    enters = Phi @ gain
    A = Phi - np.outer(enters, C)
    P = scipy.linalg.solve_discrete_lyapunov(A, Q + R * np.outer(enters, enters))
    S = float(C @ P @ C + R)
    return S, float(C @ A @ P @ C - R * (C @ enters)) / S
