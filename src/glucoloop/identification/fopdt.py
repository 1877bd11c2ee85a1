"""First order plus dead time: the three numbers by which a process engineer knows a step response."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import NDArray

from glucoloop._pytree import pytree
from glucoloop.refusal import Refusal

Floats = NDArray[np.float64]


@pytree
class FirstOrderModel:
    """First-order lag behind a dead time.

    ::

        y(t) = K (1 - exp(-(t - d)/tau)) step   for t > d, else 0

    """

    gain: float
    """Gain K [mg/dl per mU/min]."""
    tau_min: float
    delay_min: float
    residual_rms_mg_dl: float
    """Root mean square of what the fit leaves."""

    def response(self, t_min: ArrayLike, step_mU_min: float) -> Array:
        """Glucose deviation [mg/dl] at `t_min` after a step of insulin at time 0."""
        since = jnp.maximum(jnp.asarray(t_min, dtype=float) - self.delay_min, 0.0)
        return -self.gain * step_mU_min * jnp.expm1(-since / self.tau_min)


def fit_first_order(
    t_min: ArrayLike, response_deviation: ArrayLike, step: float, delay_min: float | None = 5.0
) -> FirstOrderModel:
    """Least-squares gain, time constant and, if asked, dead time of a step response.

    Parameters
    ----------
    t_min : array_like, shape (N,)
        Times since the step, increasing [min].
    response_deviation : array_like, shape (N,)
        Glucose deviation from the steady state before the step [mg/dl].
    step : float
        Size of the step of insulin, not zero [mU/min].
    delay_min : float or None
        Dead time, taken as known [min]; None fits it as well.

    Raises
    ------
    ValueError
        If the data aren't finite or too few, the step is zero, the delay is negative, or the response isn't one whose
        time constant can be told: flat, settled between two readings, or far from settled at the last.
    """
    times, response = np.asarray(t_min, dtype=float), np.asarray(response_deviation, dtype=float)
    if times.ndim != 1 or times.shape != response.shape:
        raise Refusal(
            f"Times of shape {times.shape} and a response of shape {response.shape} do not pair up: "
            "give one-dimensional arrays of one length."
        )
    if not (np.isfinite(times).all() and np.isfinite(response).all()):
        raise Refusal("The step response holds a time or a value that is not finite: leave those rows out.")
    if (np.diff(times) <= 0).any():
        raise Refusal(f"Times are not increasing at row {int(np.argmax(np.diff(times) <= 0)) + 1}: sort them.")
    if not np.isfinite(step) or step == 0:
        raise Refusal(f"A step of {step} mU/min moves nothing: give the size of the step, not 0.")
    if delay_min is not None and not (np.isfinite(delay_min) and delay_min >= 0):
        raise Refusal(f"A delay of {delay_min} min is not a finite number of at least 0 min.")
    needed = 3 if delay_min is not None else 4
    if (moving := int((times > (delay_min or 0.0)).sum())) < needed:
        raise Refusal(
            f"Only {moving} readings lie after the delay of {delay_min or 0:g} min, and a fit needs {needed}: "
            "lengthen the record."
        )
    if not response[times > (delay_min or 0.0)].any():
        raise Refusal("The response is flat at 0 mg/dl, so it has no time constant: use a larger step.")

    from scipy import optimize

    # The gain is closed form given the other two; a scan over those keeps the search out of local minima.
    shortest, longest = float(np.diff(times).min()) / 20, 20 * float(times[-1] - (delay_min or 0.0))
    taus = np.geomspace(shortest, longest, 100)
    delays = np.array([delay_min]) if delay_min is not None else np.linspace(0.0, times[-4], 50)
    costs = np.array([[_best_gain(times, response, step, tau, delay)[1] for tau in taus] for delay in delays])
    at_delay, at_tau = np.unravel_index(int(np.argmin(costs)), costs.shape)
    if at_tau == 0:
        raise Refusal(
            f"The response settles within {shortest:.3g} min, faster than the readings can show: "
            "sample more often or shorten the delay."
        )
    if at_tau == len(taus) - 1:
        raise Refusal(
            f"The response does not level off within {times[-1]:g} min, so gain and time constant cannot be found "
            "apart: lengthen the record."
        )

    free = 2 if delay_min is not None else 3

    def residuals(x: Floats) -> Floats:
        delay = delay_min if delay_min is not None else x[2]
        left: Floats = step * x[0] * _rise(times, np.exp(x[1]), delay) - response
        return left

    def slopes(x: Floats) -> Floats:
        tau = np.exp(x[1])
        delay = delay_min if delay_min is not None else x[2]
        since = np.maximum(times - delay, 0.0)
        decay = x[0] * np.exp(-since / tau) * (since > 0)
        return step * np.column_stack([_rise(times, tau, delay), -decay * since / tau, -decay / tau])[:, :free]

    tau, delay = taus[at_tau], delays[at_delay]
    start = np.array([_best_gain(times, response, step, tau, delay)[0], np.log(tau), delay])[:free]
    lowest = np.array([-np.inf, -np.inf, 0.0])[:free]
    fit = optimize.least_squares(
        residuals, start, jac=slopes, bounds=(lowest, np.inf), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    return FirstOrderModel(
        gain=float(fit.x[0]),
        tau_min=float(np.exp(fit.x[1])),
        delay_min=float(delay_min if delay_min is not None else fit.x[2]),
        residual_rms_mg_dl=float(np.sqrt(np.mean(fit.fun**2))),
    )


def _rise(times: Floats, tau: float, delay: float) -> Floats:
    """Unit-gain response, from 0 to 1."""
    rise: Floats = -np.expm1(-np.maximum(times - delay, 0.0) / tau)
    return rise


def _best_gain(times: Floats, response: Floats, step: float, tau: float, delay: float) -> tuple[float, float]:
    """Least-squares gain for a time constant and dead time, and the sum of squares it leaves."""
    rise = step * _rise(times, tau, delay)
    gain = float(rise @ response / (rise @ rise))
    return gain, float(np.sum((response - gain * rise) ** 2))
