"""Gain and lag of a person's response to insulin, relative to a person whose response is known.

The person responds as the known one would to another rate: the person's own rate, times the gain, through the lag of
`models.nonlinear.IndividualModel`. Two numbers can be found in a record in which a whole step response would be lost
in noise; a prior about (1, 1) keeps them where the record says little.

The fit is Levenberg and Marquardt's, in the logarithms of the two: K. Levenberg, Q. Appl. Math. 2, 1944; D. W.
Marquardt, J. SIAM 11(2), 1963.
"""

from __future__ import annotations

import functools
import math
from typing import Final

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from glucoloop._pytree import pytree
from glucoloop.identification import _check
from glucoloop.models.nonlinear import LAG_MIN
from glucoloop.refusal import Refusal

GAIN_SPREAD: Final = 0.35
"""Standard deviation of the logarithm of the gain over the people of parker2000, about."""
LAG_SPREAD: Final = 0.2
"""Standard deviation of the logarithm of the lag over the people of parker2000, about."""
FARTHEST: Final = math.log(5.0)
"""Largest absolute logarithm of an accepted gain or lag: five times the known one's, or a fifth of it."""
_ITERATIONS: Final = 30


@pytree
class GainAndLag:
    """Identified gain and lag; people trailing."""

    gain: jax.Array
    """Gain of insulin, relative to the known person's."""
    lag: jax.Array
    """Lag of insulin, relative to the known person's."""
    gain_error: jax.Array
    """Standard error of the gain, from record and prior together."""
    lag_error: jax.Array
    residual_rms_mg_dl: jax.Array
    """Root mean square of the residuals of the fit."""


def identify_gain_and_lag(
    insulin_deviation_mU_min: ArrayLike,
    glucose_deviation_mg_dl: ArrayLike,
    impulse_response: ArrayLike,
    *,
    sample_time_min: float = 5.0,
    noise_variance: float = 1.45,
    gain_spread: float = GAIN_SPREAD,
    lag_spread: float = LAG_SPREAD,
) -> GainAndLag:
    """Gain and lag by least squares over a record, with a weak prior.

    The gain a and the lag b are the minimum of::

        sum over k of  (y_k - a sum over i of h_i v_(k-i))^2 / R  +  (log a / s_a)^2  +  (log b / s_b)^2
        v = w + (u - w) / b,    55 b w' = u - w

    Insulin u is ``(N,)`` or ``(N, people)``, less the basal rate, and glucose y has N + 1 readings, less the setpoint,
    of a person who was at steady state; a reading that is not finite counts for nothing. The response h_1..h_M of the
    known person is left out after M samples, so M is best as long as the record. Where the fit leaves more than the
    noise variance R, in (mg/dl)^2, the standard errors are as much larger.
    """
    sample_time_min = _check.positive("The sample time", sample_time_min, "min")
    noise_variance = _check.positive("The noise variance", noise_variance, "(mg/dl)^2")
    spreads = (
        _check.positive("The spread of the gain", gain_spread, ""),
        _check.positive("The spread of the lag", lag_spread, ""),
    )
    insulin, glucose, response = (
        jnp.asarray(a, float) for a in (insulin_deviation_mU_min, glucose_deviation_mg_dl, impulse_response)
    )
    if response.ndim != 1 or not response.size:
        raise Refusal(f"An impulse response of shape {response.shape} is not one of a person: give h_1..h_M.")
    if insulin.ndim not in (1, 2) or glucose.shape != (insulin.shape[0] + 1, *insulin.shape[1:]):
        raise Refusal(
            f"Rates of shape {insulin.shape} do not go with readings of shape {glucose.shape}: give N rates and N + 1 "
            "readings, one at either end of each sample, and as many people of both."
        )
    _check.finite("The insulin rates", insulin, "give the rate that was infused")
    _check.finite("The impulse response", response, "identify it again from a record without missing readings")
    fit = functools.partial(
        _fit, response=response, sample_time_min=sample_time_min, noise_variance=noise_variance, spreads=spreads
    )
    of_all = fit if insulin.ndim == 1 else jax.vmap(fit, in_axes=-1, out_axes=-1)
    result: GainAndLag = of_all(insulin, glucose)
    return result


def _answer(
    insulin_deviation_mU_min: jax.Array,
    impulse_response: jax.Array,
    gain: jax.Array | float,
    lag: jax.Array | float,
    sample_time_min: float,
) -> jax.Array:
    """Glucose deviation ``(N + 1,)`` from steady state of a person with a gain and a lag, under rates ``(N,)``."""
    z = sample_time_min / (LAG_MIN * lag)

    def sample(w: jax.Array, away: jax.Array) -> tuple[jax.Array, jax.Array]:
        mean = away + (w - away) * -jnp.expm1(-z) / z
        return away + (w - away) * jnp.exp(-z), mean + (away - mean) / lag

    _, given = jax.lax.scan(sample, jnp.zeros(()), insulin_deviation_mU_min)
    answered = jnp.convolve(given, impulse_response)[: given.size]
    return gain * jnp.append(0.0, answered)


@functools.partial(jax.jit, static_argnames="sample_time_min")
def _fit(
    insulin: jax.Array,
    glucose: jax.Array,
    *,
    response: jax.Array,
    sample_time_min: float,
    noise_variance: jax.Array | float,
    spreads: tuple[jax.Array | float, jax.Array | float],
) -> GainAndLag:
    known = jnp.isfinite(glucose)
    precision = 1.0 / jnp.square(jnp.stack(jnp.asarray(spreads)))

    def lacking(theta: jax.Array) -> jax.Array:
        gain, lag = jnp.exp(theta)
        return jnp.where(known, glucose - _answer(insulin, response, gain, lag, sample_time_min), 0.0)

    def cost(theta: jax.Array) -> jax.Array:
        return jnp.sum(lacking(theta) ** 2) / noise_variance + jnp.sum(precision * theta**2)

    def curvature(theta: jax.Array, variance: jax.Array | float) -> tuple[jax.Array, jax.Array]:
        J = jax.jacfwd(lacking)(theta)
        return J.T @ J / variance + jnp.diag(precision), J

    def step(carry: tuple[jax.Array, jax.Array], _: None) -> tuple[tuple[jax.Array, jax.Array], None]:
        theta, damping = carry
        H, J = curvature(theta, noise_variance)
        slope = J.T @ lacking(theta) / noise_variance + precision * theta
        trial = theta - jnp.linalg.solve(H + damping * jnp.diag(jnp.diag(H)), slope)
        trial = jnp.clip(trial, -FARTHEST, FARTHEST)
        better = cost(trial) < cost(theta)
        return (jnp.where(better, trial, theta), jnp.where(better, damping / 5.0, damping * 5.0)), None

    (theta, _), _ = jax.lax.scan(step, (jnp.zeros(2), jnp.asarray(1e-2)), None, length=_ITERATIONS)
    left, number = lacking(theta), jnp.maximum(jnp.sum(known), 1)
    variance = jnp.maximum(noise_variance, jnp.sum(left**2) / jnp.maximum(number - 2, 1))
    H, _ = curvature(theta, variance)
    result = jnp.exp(theta)
    error = result * jnp.sqrt(jnp.diag(jnp.linalg.inv(H)))
    return GainAndLag(
        gain=result[0],
        lag=result[1],
        gain_error=error[0],
        lag_error=error[1],
        residual_rms_mg_dl=jnp.sqrt(jnp.sum(left**2) / number),
    )
