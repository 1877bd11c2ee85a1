"""Step-response model: the finite-memory model of a patient that linear predictive control uses.

Parker, Doyle & Peppas, IEEE Trans. Biomed. Eng. 46(2), 148-157, 1999, eq. (1)-(4). The geometric tail is the "residual
dynamics" of J. H. Lee, M. Morari, C. E. Garcia, "State-space interpretation of model predictive control", Automatica
30(4), 1994, 707-717.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from glucoloop._pytree import pytree, static
from glucoloop.arguments import is_traced


@pytree
class StepResponseModel:
    """Response of glucose to a unit step of insulin: S_1..S_M, and what comes after M samples.

    ::

        y_k = sum_{i>=1} h_i u_(k-i),    S_i = h_1 + ... + h_i,    h_(M+j) = p^j h_M

    where u_k is held from t_k to t_(k+1), so that glucose at t_k depends on insulin up to u_(k-1). Without a pole p the
    response is constant after M samples.

    Attributes
    ----------
    step_response : Array, shape (M,)
        S_1..S_M [mg/dl per mU/min]. Trailing axes, one column per model, are allowed.
    sample_time_min : float
        Sample time [min].
    tail_pole : Array, shape (), or None
        p, ratio of the increments after M samples, from 0 to less than 1; None for a response that ends there.
    """

    step_response: Array
    sample_time_min: float = static()
    tail_pole: Array | None = None

    @classmethod
    def from_impulse_response(
        cls, impulse_response: ArrayLike, sample_time_min: float, *, tail_pole: ArrayLike | None = None
    ) -> Self:
        """Model whose step response is the running sum of an impulse response.

        Parameters
        ----------
        impulse_response : array_like, shape (M,)
            h_1..h_M [mg/dl per mU/min].
        sample_time_min : float
            Sample time [min].
        tail_pole : float, optional
            p, by which the increments fall from sample to sample after the last of these.

        Raises
        ------
        ValueError
            If the response is empty or not finite, the sample time is not positive, or the pole is not at least 0 and
            less than 1.
        """
        if not sample_time_min > 0 or not np.isfinite(sample_time_min):
            raise ValueError(
                f"A sample time of {sample_time_min} min is not above 0: give the minutes between readings."
            )
        shape = np.shape(impulse_response)
        if not shape or shape[0] == 0:
            raise ValueError(f"An impulse response of shape {shape} has no coefficient: give h_1..h_M, at least one.")
        if not isinstance(impulse_response, jax.core.Tracer):
            finite = np.isfinite(np.asarray(impulse_response, dtype=float))
            if not finite.all():
                raise ValueError(
                    f"{int((~finite).sum())} of {finite.size} impulse-response coefficients are not finite: "
                    "identify the model again from a record without missing readings."
                )
        if (
            tail_pole is not None
            and not is_traced(tail_pole)
            and not 0.0 <= np.min(tail_pole) <= np.max(tail_pole) < 1.0
        ):
            raise ValueError(
                f"A pole of {tail_pole} at the end of the step response is not possible: give one of at least 0 and "
                "less than 1, or None for a response that ends there."
            )
        step_response = jnp.cumsum(jnp.asarray(impulse_response, dtype=float), axis=0)
        return cls(
            step_response=step_response,
            sample_time_min=float(sample_time_min),
            tail_pole=None if tail_pole is None else jnp.asarray(tail_pole, dtype=float),
        )

    @property
    def impulse_response(self) -> Array:
        """h_1..h_M [mg/dl per mU/min], the increments of the step response; shape (M,)."""
        return jnp.diff(self.step_response, axis=0, prepend=jnp.zeros_like(self.step_response[:1]))

    @property
    def gain(self) -> Array:
        """Steady change of glucose for a lasting change of insulin [mg/dl per mU/min]: S_M and the tail after it."""
        if self.tail_pole is None:
            return self.step_response[-1]
        return self.step_response[-1] + self.impulse_response[-1] * self.tail_pole / (1.0 - self.tail_pole)

    @property
    def memory(self) -> int:
        """Number of samples M after which the response is settled, or has only its tail."""
        return int(self.step_response.shape[0])

    def delayed(self, samples: int) -> Self:
        """The same patient behind a measurement dead time: leading zeros, same gain.

        Parameters
        ----------
        samples : int
            Dead time in samples, 0 or more; the memory grows by as many.

        Raises
        ------
        ValueError
            If `samples` is negative or not a whole number.
        """
        if isinstance(samples, bool) or not isinstance(samples, int | np.integer) or samples < 0:
            raise ValueError(f"A delay of {samples!r} samples is not a whole number of at least 0.")
        zeros = jnp.zeros((int(samples), *self.step_response.shape[1:]))
        return dataclasses.replace(self, step_response=jnp.concatenate([zeros, self.step_response]))

    def predict(self, insulin_deviation: ArrayLike) -> Array:
        """Glucose deviation that answers an insulin sequence, starting from rest.

        Parameters
        ----------
        insulin_deviation : array_like, shape (N,)
            u_0..u_(N-1), each held over one sample [mU/min from the steady rate].

        Returns
        -------
        Array, shape (N + 1,)
            y_0..y_N [mg/dl from the steady glucose]; y_0 is 0.

        Raises
        ------
        ValueError
            If the sequence isn't one-dimensional.
        """
        if self.tail_pole is None:
            return lagged_inputs(insulin_deviation, self.memory) @ self.impulse_response
        longer = extended(self.step_response, self.tail_pole, np.shape(insulin_deviation)[0])
        whole = dataclasses.replace(self, step_response=longer)
        return lagged_inputs(insulin_deviation, whole.memory) @ whole.impulse_response


def extended(step_response: Any, tail_pole: Any, samples: int) -> Any:
    """Step response S_1..S_N of at least the given length: constant after S_M, or with its geometric tail.

    Parameters
    ----------
    step_response : Array, shape (M, ...)
    tail_pole : Array, shape (...), or None
        Ratio p of the increments after M samples; None for none.
    samples : int
        Least number N of samples; a response of as many or more is unchanged.
    """
    xp: Any = jnp if is_traced(step_response, tail_pole) or isinstance(step_response, Array) else np
    missing = max(0, samples - step_response.shape[0])
    after = xp.repeat(step_response[-1:], missing, axis=0)
    if tail_pole is not None and missing:
        last = step_response[-1] - (step_response[-2] if step_response.shape[0] > 1 else 0.0)
        order = xp.arange(1, missing + 1).reshape(-1, *[1] * (step_response.ndim - 1))
        after = after + last * xp.cumsum(tail_pole**order, axis=0)
    return xp.concatenate([step_response, after])


def lagged_inputs(insulin_deviation: ArrayLike, memory: int) -> Array:
    """Past inputs on which each reading depends, one row per reading; the record starts from rest.

    Parameters
    ----------
    insulin_deviation : array_like, shape (N,)
        u_0..u_(N-1) [mU/min from the steady rate].
    memory : int
        Number M of past inputs kept.

    Returns
    -------
    Array, shape (N + 1, M)
        Row k is u_(k-1), ..., u_(k-M), with zeros before the record.

    Raises
    ------
    ValueError
        If the sequence isn't one-dimensional.
    """
    insulin = jnp.asarray(insulin_deviation, dtype=float)
    if insulin.ndim != 1:
        raise ValueError(
            f"An insulin sequence of shape {insulin.shape} is not one-dimensional: "
            "give one value per sample, and use jax.vmap for several sequences."
        )
    padded = jnp.concatenate([jnp.zeros(memory), insulin])
    reading = jnp.arange(insulin.shape[0] + 1)[:, None]
    lag = jnp.arange(1, memory + 1)[None, :]
    return padded[memory + reading - lag]
