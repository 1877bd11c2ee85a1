"""Kalman filters for sensor noise that is correlated and of unknown size.

A reading has white noise of a known variance R and a first-order error e whose standard deviation s is not known::

    y(k) = C x(k) + e(k) + v(k),    e(k+1) = c e(k) + sqrt(1 - c^2) s w(k)

With e as one more state, the steady filter for each s = 0, 1, ..., 6 mg/dl is designed once. At run time the gain is
interpolated at the present estimate of s, which follows the innovations.

Innovations z, in their standard deviations, tell whether s is right: then the mean of z^2 is 1. A meal, a blocked line
and most errors of a model raise glucose above the prediction, and must not be taken for noise. Hence only readings
below the prediction count, which noise makes as often and as large as those above it::

    s <- clip(s + pace (min(z^2, 9) - 1), 0, 6)    where z < 0

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
M. Breton, B. Kovatchev, J. Diabetes Sci. Technol. 2(5), 2008: the error of a continuous glucose monitor.
A. E. Bryson, L. J. Henrikson, "Estimation using sampled data containing sequentially correlated noise", J. Spacecraft
5(6), 1968: the error as a state.
R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE Trans. Autom. Control 15(2), 1970:
noise from innovations.
R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE Trans. Autom. Control 15(2), 1970.
D. T. Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE Trans. Autom. Control 10(4), 1965: a
probability for each value of what is uncertain.
"""

from __future__ import annotations

import dataclasses
from typing import Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt, scipy
from glucoloop._pytree import pytree
from glucoloop.estimation.kalman import steady_state_gain
from glucoloop.refusal import Refusal

Numbers: TypeAlias = "npt.NDArray[np.float64]"

LEVELS_MG_DL: Final = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
"""Standard deviations s for which filters are designed, 1 mg/dl apart."""
CORRELATION: Final = 0.7
"""Correlation c of the error between samples of 5 min, as Breton and Kovatchev (2008) found it."""
_MOST: Final = 9.0
"""Most that the square of an innovation counts."""


@pytree
class SensorError:
    """Estimates of the correlated error of a reading and of its size."""

    error_mg_dl: jax.Array
    """Estimate of the error e."""
    deviation_mg_dl: jax.Array
    """Estimate of its standard deviation s."""

    @property
    def sound(self) -> jax.Array:
        """Whether both are finite."""
        return jnp.isfinite(self.error_mg_dl) & jnp.isfinite(self.deviation_mg_dl)

    def or_none(self, sound: jax.Array) -> SensorError:
        """The estimates where they are sound, and elsewhere those of a sensor without a correlated error."""
        return SensorError(
            error_mg_dl=jnp.where(sound, self.error_mg_dl, 0.0),
            deviation_mg_dl=jnp.where(sound, self.deviation_mg_dl, LEVELS_MG_DL[0]),
        )


def no_error(like: jax.Array) -> SensorError:
    """The estimates before the first reading: no error, and none expected."""
    return SensorError(error_mg_dl=jnp.zeros_like(like), deviation_mg_dl=jnp.full_like(like, LEVELS_MG_DL[0]))


def _check_pace(pace: float) -> None:
    """Refuse a pace that is not possible."""
    if not 0.0 <= pace <= 1.0:
        raise Refusal(f"a pace of {pace:g} mg/dl per innovation is not possible; give 0 to 1")


def learned(deviation_mg_dl: jax.Array, innovation: jax.Array, known: jax.Array, pace: jax.Array | float) -> jax.Array:
    """Estimate of s after an innovation, which is given in its standard deviations."""
    change = pace * (jnp.minimum(innovation**2, _MOST) - 1.0)
    return jnp.clip(
        deviation_mg_dl + jnp.where(known & (innovation < 0.0), change, 0.0), LEVELS_MG_DL[0], LEVELS_MG_DL[-1]
    )


def shares(deviation_mg_dl: jax.Array) -> jax.Array:
    """Share ``(levels,)`` of each of `LEVELS_MG_DL` in a linear interpolation between them."""
    return jnp.maximum(0.0, 1.0 - jnp.abs(deviation_mg_dl - jnp.asarray(LEVELS_MG_DL)))


@pytree
class NoisyFilters:
    """Steady filters for each size of the correlated error; see `noisy_filters`."""

    gain: jax.Array
    """(levels, n + 1) gain of the states, and last that of the error, for each of `LEVELS_MG_DL`."""
    innovation_variance: jax.Array
    """(levels,) variance S of an innovation."""
    correlation: jax.Array | float
    pace: jax.Array | float
    """Change of s by an innovation that is larger or smaller than expected by its variance, mg/dl."""

    def at(self, deviation_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Gain ``(n + 1,)`` and innovation variance at an estimate of s, by linear interpolation."""
        share = shares(deviation_mg_dl)
        return jnp.sum(share[:, None] * self.gain, axis=0), jnp.sum(share * self.innovation_variance)

    def fixed(self, deviation_mg_dl: float) -> NoisyFilters:
        """The same filters if s is known."""
        gain, variance = self.at(jnp.asarray(deviation_mg_dl))
        return NoisyFilters(
            gain=jnp.broadcast_to(gain, self.gain.shape),
            innovation_variance=jnp.broadcast_to(variance, self.innovation_variance.shape),
            correlation=self.correlation,
            pace=jnp.zeros(()),
        )

    def learn(self, deviation_mg_dl: jax.Array, innovation: jax.Array, known: jax.Array) -> jax.Array:
        """Estimate of s after an innovation, which is given in its standard deviations."""
        return learned(deviation_mg_dl, innovation, known, self.pace)


def noisy_filters(
    Phi: npt.ArrayLike,
    C: npt.ArrayLike,
    Q: npt.ArrayLike,
    R: float,
    *,
    correlation: float = CORRELATION,
    pace: float = 0.2,
) -> NoisyFilters:
    """Design the filters for a model with process noise Q and white noise of variance R, (mg/dl)^2.

    The error has the correlation c, and the pace is that of s in mg/dl per innovation; 0: the noise is as designed.
    """
    if not 0.0 <= correlation < 1.0:
        raise Refusal(f"a correlation of {correlation:g} is not possible; give 0 or more and less than 1")
    _check_pace(pace)
    Phi, C, Q = (np.asarray(a, float) for a in (Phi, C, Q))
    without = steady_state_gain(Phi, C, Q, R)
    gains, variances = [np.append(without.gain, 0.0)], [float(without.innovation_covariance)]
    for deviation in LEVELS_MG_DL[1:]:
        steady = steady_state_gain(*_with_error(Phi, C, Q, deviation, correlation), R)
        gains.append(np.asarray(steady.gain))
        variances.append(float(steady.innovation_covariance))
    return NoisyFilters(
        gain=jnp.asarray(np.stack(gains)),
        innovation_variance=jnp.asarray(variances),
        correlation=correlation,
        pace=pace,
    )


def _with_error(
    Phi: Numbers, C: Numbers, Q: Numbers, deviation_mg_dl: float, correlation: float
) -> tuple[Numbers, Numbers, Numbers]:
    """The matrices of a model whose last state is an error of the sensor with a standard deviation."""
    drives = (1.0 - correlation**2) * deviation_mg_dl**2
    return scipy.linalg.block_diag(Phi, correlation), np.append(C, 1.0), scipy.linalg.block_diag(Q, drives)


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

        `stray` is added to each density, as a share of its maximum value, so that an innovation far from all of them
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
    worlds = [_with_error(Phi, C, Q, deviation, float(filters.correlation)) for deviation in LEVELS_MG_DL]
    table = np.array([[_innovation(gain, *world, R) for world in worlds] for gain in np.asarray(filters.gain)])
    return Innovations(variance=jnp.asarray(table[..., 0]), correlation=jnp.asarray(table[..., 1]))


def _innovation(gain: Numbers, Phi: Numbers, C: Numbers, Q: Numbers, R: float) -> tuple[float, float]:
    """Variance of an innovation, and its correlation with the one before."""
    enters = Phi @ gain
    A = Phi - np.outer(enters, C)
    P = scipy.linalg.solve_discrete_lyapunov(A, Q + R * np.outer(enters, enters))
    S = float(C @ P @ C + R)
    return S, float(C @ A @ P @ C - R * (C @ enters)) / S
