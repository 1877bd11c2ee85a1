"""Step-response model: the finite-memory model of a patient that linear predictive control uses.

Parker, Doyle & Peppas, IEEE Trans. Biomed. Eng. 46(2), 148-157, 1999, eq. (1)-(4).
"""

from __future__ import annotations

from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from glucoloop._pytree import pytree, static


@pytree
class StepResponseModel:
    """Response of glucose to a unit step of insulin, S_1..S_M, constant after M samples.

    ::

        y_k = sum_{i=1..M} h_i u_(k-i),    S_i = h_1 + ... + h_i

    where u_k is held from t_k to t_(k+1), so that glucose at t_k depends on insulin up to u_(k-1).

    Attributes
    ----------
    step_response : Array, shape (M,)
        S_1..S_M [mg/dl per mU/min]. Trailing axes, one column per model, are allowed.
    sample_time_min : float
        Sample time [min].
    """

    step_response: Array
    sample_time_min: float = static()

    @classmethod
    def from_impulse_response(cls, impulse_response: ArrayLike, sample_time_min: float) -> Self:
        """Model whose step response is the running sum of an impulse response.

        Parameters
        ----------
        impulse_response : array_like, shape (M,)
            h_1..h_M [mg/dl per mU/min].
        sample_time_min : float
            Sample time [min].

        Raises
        ------
        ValueError
            If the response is empty or not finite, or the sample time is not positive.
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
        step_response = jnp.cumsum(jnp.asarray(impulse_response, dtype=float), axis=0)
        return cls(step_response=step_response, sample_time_min=float(sample_time_min))

    @property
    def impulse_response(self) -> Array:
        """h_1..h_M [mg/dl per mU/min], the increments of the step response; shape (M,)."""
        return jnp.diff(self.step_response, axis=0, prepend=jnp.zeros_like(self.step_response[:1]))

    @property
    def gain(self) -> Array:
        """Steady change of glucose for a lasting change of insulin, S_M [mg/dl per mU/min]."""
        return self.step_response[-1]

    @property
    def memory(self) -> int:
        """Number of samples M after which the response is taken as settled."""
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
        delayed = jnp.concatenate([zeros, self.step_response])
        return type(self)(step_response=delayed, sample_time_min=self.sample_time_min)

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
        return lagged_inputs(insulin_deviation, self.memory) @ self.impulse_response


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
