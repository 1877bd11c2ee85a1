"""Error of the readings about a twin: a slow part that is correlated over time, and a part of each reading alone.

The slow part is an Ornstein-Uhlenbeck process, which holds the drift of the sensor and what the model does not know of
the person; without it the intervals of the parameters would be far too narrow. Readings with gaps between them are made
independent by a Kalman filter of the process (innovations), which is linear in what is given, so that derivatives of
predictions go through it too.

The three numbers are found by maximum likelihood, with a weak prior, of the readings about the linearised prediction
with the parameters integrated out. By the residuals of a fit alone, they would be too small.

References
----------
A. Facchinetti, S. Del Favero, G. Sparacino, J. R. Castle, W. K. Ward, C. Cobelli, "Modeling the glucose sensor error",
IEEE Trans. Biomed. Eng. 61(3), 2014, 620-629 (slow and fast part of the error of a sensor).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.optimize

Values = npt.NDArray[np.float64]

_DEFAULT_LOG: Final = np.log([10.0, 60.0, 2.5])
_WEAK_SD: Final = 1.0
_STEPS: Final = 40
_MIN_MG_DL: Final = 0.3
"""Minimum part of each reading alone: readings are whole numbers."""


@dataclass(frozen=True)
class Noise:
    """Error of readings."""

    slow_sd_mg_dl: float = 10.0
    """Standard deviation of the correlated part."""
    time_constant_min: float = 60.0
    """Time after which its correlation has fallen to 1/e."""
    own_sd_mg_dl: float = 2.5
    """Standard deviation of the part of each reading alone."""

    @property
    def sd_mg_dl(self) -> float:
        """Standard deviation of a reading about the twin."""
        return float(np.hypot(self.slow_sd_mg_dl, self.own_sd_mg_dl))

    @property
    def _logarithms(self) -> Values:
        return np.log([self.slow_sd_mg_dl, self.time_constant_min, self.own_sd_mg_dl])

    def independent(self, t_min: Values, columns: Values) -> Values:
        """Residuals ``(readings, columns)`` at increasing times, made independent and of unit variance."""
        white, _ = _innovations(jnp.asarray(self._logarithms), jnp.asarray(t_min), jnp.asarray(columns))
        return np.asarray(white)

    def drawn(self, t_min: Values, number: int, rng: np.random.Generator) -> Values:
        """Errors ``(number, readings)`` at increasing times."""
        keep = np.exp(-np.diff(t_min, prepend=t_min[0]) / self.time_constant_min)
        fresh = rng.standard_normal((t_min.size, number))
        slow = np.empty_like(fresh)
        slow[0] = fresh[0]
        for k in range(1, t_min.size):
            slow[k] = keep[k] * slow[k - 1] + np.sqrt(1.0 - keep[k] ** 2) * fresh[k]
        own = rng.standard_normal((number, t_min.size))
        return self.slow_sd_mg_dl * slow.T + self.own_sd_mg_dl * own

    def learned(self, t_min: Values, residual: Values, jacobian: Values) -> Noise:
        """Noise of most likelihood, started from this one.

        Parameters
        ----------
        t_min : (readings,) array
            Times, increasing.
        residual : (readings,) array
            Readings minus the prediction of the prior mean, by the linearisation.
        jacobian : (readings, coordinates) array
            Change of the prediction by the coordinates, of which each is standard normal before.
        """
        columns = jnp.asarray(np.column_stack([residual, jacobian]))

        def cost(logarithms: Values) -> tuple[float, Values]:
            value, slope = _evidence(jnp.asarray(logarithms), jnp.asarray(t_min), columns)
            return float(value), np.asarray(slope, float)

        result = scipy.optimize.minimize(
            cost, self._logarithms, jac=True, method="L-BFGS-B", bounds=_BOUNDS, options={"maxiter": _STEPS}
        )
        slow, time_constant, own = np.exp(result.x)
        return Noise(float(slow), float(time_constant), float(own))


_BOUNDS: Final = [(np.log(0.1), np.log(200.0)), (np.log(5.0), np.log(720.0)), (np.log(_MIN_MG_DL), np.log(50.0))]


@jax.jit
def _innovations(logarithms: jax.Array, t_min: jax.Array, columns: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Independent columns of unit variance, and the sum of the logarithms of the variances of the innovations."""
    slow, time_constant, own = jnp.exp(logarithms)
    since = jnp.diff(t_min, prepend=t_min[:1])

    def step(carry: Any, entry: Any) -> Any:
        mean, variance = carry
        elapsed, values = entry
        keep = jnp.exp(-elapsed / time_constant)
        mean, variance = keep * mean, keep**2 * variance + (1.0 - keep**2) * slow**2
        total = variance + own**2
        innovation = values - mean
        mean, variance = mean + variance / total * innovation, variance * own**2 / total
        return (mean, variance), (innovation / jnp.sqrt(total), jnp.log(total))

    start = jnp.zeros(columns.shape[1]), slow**2
    _, (white, log_variance) = jax.lax.scan(step, start, (since, columns))
    return white, jnp.sum(log_variance)


@jax.jit
@jax.value_and_grad
def _evidence(logarithms: jax.Array, t_min: jax.Array, columns: jax.Array) -> jax.Array:
    """Minus the logarithm of the evidence of readings, with the weak prior of the noise, but for a constant."""
    white, log_variance = _innovations(logarithms, t_min, columns)
    residual, jacobian = white[:, 0], white[:, 1:]
    information = jnp.eye(jacobian.shape[1]) + jacobian.T @ jacobian
    along = jacobian.T @ residual
    factor = jnp.linalg.cholesky(information)
    explained = jax.scipy.linalg.solve_triangular(factor, along, lower=True)
    misfit = residual @ residual - explained @ explained
    of_information = 2.0 * jnp.sum(jnp.log(jnp.diagonal(factor)))
    weak = jnp.sum(((logarithms - jnp.asarray(_DEFAULT_LOG)) / _WEAK_SD) ** 2)
    cost: jax.Array = 0.5 * (misfit + log_variance + of_information + weak)
    return cost
