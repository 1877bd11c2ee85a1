"""Step-response model: the finite-memory model of a patient that linear predictive control uses.

Parker, Doyle & Peppas, IEEE Trans. Biomed. Eng. 46(2), 148-157, 1999, eq. (1)-(4). The realisation of what comes after
the memory is the "residual dynamics" of J. H. Lee, M. Morari, C. E. Garcia, "State-space interpretation of model
predictive control", Automatica 30(4), 1994, 707-717.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, Self

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.arguments import is_traced
from glucoloop.refusal import Refusal

_ROUNDING: Final = 1e-9


@pytree
class Realisation:
    """State-space realisation of an impulse response after n samples: ``h_(n+j) = c' A^(j-1) b`` for j = 1, 2, ..."""

    transition: jax.Array
    """Matrix A, with eigenvalues within the unit circle, ``(L, L)``."""
    start: jax.Array
    """State b one sample after a unit impulse that the first n coefficients have answered, ``(L,)``."""
    output: jax.Array
    """Output c [mg/dl per mU/min], ``(L,)`` or ``(L, people)``."""
    after: int = static(default=0)
    """Number n of samples after which it begins."""

    @property
    def sum(self) -> jax.Array:
        """Sum of all coefficients after the first n, ``c' (I - A)^-1 b``."""
        still = jnp.eye(self.transition.shape[0]) - self.transition
        return jnp.tensordot(jnp.linalg.solve(still, self.start), self.output, 1)

    def states(self, samples: int) -> Any:
        """States ``b, A b, A^2 b, ..`` from n on, ``(L, samples)``."""
        xp: Any = jnp if is_traced(self.transition, self.start) else np
        states, power = xp.asarray(self.start)[:, None], xp.asarray(self.transition)
        while states.shape[1] < samples:
            states, power = xp.concatenate([states, power @ states], axis=1), power @ power
        return states[:, :samples]

    def advanced(self, after: int) -> Realisation:
        """The same response, realised after a number of samples that is at least n."""
        return dataclasses.replace(self, start=self.states(after - self.after + 1)[:, -1], after=after)


@represented
@pytree
class StepResponseModel:
    """Response of glucose to a unit step of insulin: S_1..S_M, and what comes after M samples.

    ::

        y_k = sum_{i>=1} h_i u_(k-i),    S_i = h_1 + ... + h_i

    where u_k is held from t_k to t_(k+1), so that glucose at t_k depends on insulin up to u_(k-1). Without a
    realisation the response is constant after M samples.
    """

    step_response: jax.Array
    """(M, ...) S_1..S_M [mg/dl per mU/min]; trailing axes, one column per model, are allowed."""
    sample_time_min: float = static()
    """Sample time of the model."""
    realisation: Realisation | None = None
    """Realisation of the response after n <= M samples, for one that outlasts the memory; None for one that ends."""

    @classmethod
    def from_impulse_response(
        cls, impulse_response: jax.typing.ArrayLike, sample_time_min: float, *, realisation: Realisation | None = None
    ) -> Self:
        """Model whose step response is the running sum of an impulse response h_1..h_M [mg/dl per mU/min].

        Raises
        ------
        ValueError
            If the response is empty or not finite, the sample time is not positive, or the realisation is not one of
            this response.
        """
        if not sample_time_min > 0 or not np.isfinite(sample_time_min):
            raise Refusal(f"A sample time of {sample_time_min} min is not above 0: give the minutes between readings.")
        shape = np.shape(impulse_response)
        if not shape or shape[0] == 0:
            raise Refusal(f"An impulse response of shape {shape} has no coefficient: give h_1..h_M, at least one.")
        if not isinstance(impulse_response, jax.core.Tracer):
            finite = np.isfinite(np.asarray(impulse_response, dtype=float))
            if not finite.all():
                raise Refusal(
                    f"{int((~finite).sum())} of {finite.size} impulse-response coefficients are not finite: "
                    "identify the model again from a record without missing readings."
                )
        if realisation is not None and not is_traced(realisation, impulse_response):
            refuse_other_response(realisation, impulse_response)
        xp: Any = jnp if is_traced(impulse_response) else np
        step_response = jnp.asarray(xp.cumsum(xp.asarray(impulse_response, dtype=float), axis=0))
        return cls(step_response=step_response, sample_time_min=float(sample_time_min), realisation=realisation)

    @property
    def impulse_response(self) -> jax.Array:
        """h_1..h_M [mg/dl per mU/min], the increments of the step response; shape (M,)."""
        xp: Any = jnp if is_traced(self.step_response) else np
        steps = xp.asarray(self.step_response)
        return jnp.asarray(xp.diff(steps, axis=0, prepend=xp.zeros_like(steps[:1])))

    @property
    def gain(self) -> jax.Array:
        """Steady change of glucose for a lasting change of insulin [mg/dl per mU/min]: S_M and what comes after it."""
        if self.realisation is None:
            return self.step_response[-1]
        return self.step_response[-1] + self.realisation.advanced(self.memory).sum

    @property
    def memory(self) -> int:
        """Number of samples M after which the response is settled, or has only its realisation."""
        return int(self.step_response.shape[0])

    def delayed(self, samples: int) -> Self:
        """The same patient behind a measurement dead time: leading zeros, same gain, and a longer memory."""
        if isinstance(samples, bool) or not isinstance(samples, int | np.integer) or samples < 0:
            raise Refusal(f"A delay of {samples!r} samples is not a whole number of at least 0.")
        if samples == 0:
            return self
        zeros, later = jnp.zeros((int(samples), *self.step_response.shape[1:])), self.realisation
        if later is not None:
            later = dataclasses.replace(later, after=later.after + int(samples))
        step_response = jnp.concatenate([zeros, self.step_response])
        return dataclasses.replace(self, step_response=step_response, realisation=later)

    def predict(self, insulin_deviation: jax.typing.ArrayLike) -> jax.Array:
        """Glucose deviations y_0..y_N from rest under insulin deviations u_0..u_(N-1), each held over a sample."""
        whole = self
        if self.realisation is not None:
            longer = extended(self.step_response, self.realisation, np.shape(insulin_deviation)[0])
            whole = dataclasses.replace(self, step_response=longer)
        past, response = lagged_inputs(insulin_deviation, whole.memory), whole.impulse_response
        xp: Any = jnp if is_traced(past, response) else np
        return jnp.asarray(xp.asarray(past) @ xp.asarray(response))


def extended(step_response: Any, realisation: Realisation | None, samples: int) -> Any:
    """Step response S_1..S_N of at least the given length, constant after S_M or going on with its realisation."""
    memory = step_response.shape[0]
    missing = samples - memory
    if missing <= 0:
        return step_response
    xp: Any = jnp if is_traced(step_response, realisation) else np
    step_response = xp.asarray(step_response)
    after = xp.repeat(step_response[-1:], missing, axis=0)
    if realisation is not None:
        states = realisation.advanced(memory).states(missing)
        after = after + xp.cumsum(xp.tensordot(states.T, xp.asarray(realisation.output), 1), axis=0)
    return xp.concatenate([step_response, after])


def refuse_other_response(realisation: Realisation, impulse_response: jax.typing.ArrayLike) -> None:
    """Refuse a realisation that is not one of this impulse response, or does not decay after it."""
    h = np.asarray(impulse_response, dtype=float)
    if realisation.after > h.shape[0]:
        raise Refusal(
            f"a realisation of the response after {realisation.after} samples does not tell what comes after the "
            f"memory of {h.shape[0]}: give one that begins there or before"
        )
    transition = np.asarray(realisation.transition, float)
    largest = np.max(np.abs(np.linalg.eigvals(transition))) if np.isfinite(transition).all() else np.inf
    if not largest < 1.0:
        raise Refusal(
            f"a realisation with an eigenvalue of magnitude {largest:.4g} does not decay: give one whose eigenvalues "
            "are less than 1, or None for a response that ends after its memory"
        )
    known = h[realisation.after :]
    apart = np.abs(realisation.states(len(known)).T @ np.asarray(realisation.output) - known)
    if not np.all(apart <= _ROUNDING * np.abs(h).max()):
        raise Refusal(
            f"a realisation that differs from the impulse response by {np.max(apart):.3g} mg/dl per mU/min within its "
            "memory: give one that begins later, or the response that it generates"
        )


def lagged_inputs(insulin_deviation: jax.typing.ArrayLike, memory: int) -> jax.Array:
    """Past inputs on which each reading depends: row k is u_(k-1), ..., u_(k-M), with zeros before the record."""
    xp: Any = jnp if is_traced(insulin_deviation) else np
    insulin = xp.asarray(insulin_deviation, dtype=float)
    if insulin.ndim != 1:
        raise Refusal(
            f"An insulin sequence of shape {insulin.shape} is not one-dimensional: "
            "give one value per sample, and use jax.vmap for several sequences."
        )
    padded = xp.concatenate([np.zeros(memory), insulin])
    reading = np.arange(insulin.shape[0] + 1)[:, None]
    lag = np.arange(1, memory + 1)[None, :]
    past: jax.Array = jnp.asarray(padded[memory + reading - lag])
    return past
