"""Linear state-space models: linearisation, exact zero-order hold, and their responses.

A model describes deviations from an operating point (x0, u0, y0):

    dx/dt = A x + B u + E d,    y = C x              (`ContinuousModel`)
    x(k+1) = Phi x(k) + Gamma u(k) + Psi d(k)        (`LinearModel`)

One input, the insulin infusion; one output, the glucose concentration; `d`, where there is one, is a disturbance such
as the rate of appearance of a meal. No direct feedthrough: the output is read before the new input acts.

References
----------
C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic Control 23(3), 1978,
395-404.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from glucoloop._pytree import pytree, static
from glucoloop.refusal import Refusal


@pytree
class ContinuousModel:
    """A linear model in continuous time, per min, and the point (x0, u0, y0) about which it holds.

    Its fields have the shapes of those of `LinearModel`.
    """

    A: Array
    B: Array
    C: Array
    E: Array | None = None
    C_reading: Array | None = None
    state: Array
    insulin_mU_min: Array
    glucose_mg_dl: Array


@pytree
class LinearModel:
    """A linear model sampled with a zero-order hold, and the point about which it holds."""

    Phi: Array
    """Transition over one sample, ``(n, n)``."""
    Gamma: Array
    """Effect of an input held over one sample, per mU/min, ``(n,)``."""
    C: Array
    """Output row, ``(n,)``."""
    Psi: Array | None = None
    """Effect of a disturbance held over one sample, ``(n,)``."""
    C_reading: Array | None = None
    """Output row of the sensor, ``(n,)``, or None where it reads glucose."""
    state: Array
    """Operating point x0, ``(n,)``."""
    insulin_mU_min: Array
    """Operating point u0."""
    glucose_mg_dl: Array
    """Operating point y0."""
    sample_time_min: float = static()
    """Sample time of the model."""

    @property
    def reading_row(self) -> Array:
        """Output row ``(n,)`` of the sensor."""
        return self.C if self.C_reading is None else self.C_reading


def linearise(
    derivative: Callable[..., Array],
    output: Callable[[Array], Array],
    state: ArrayLike,
    insulin_mU_min: ArrayLike,
    disturbance: ArrayLike | None = None,
    *,
    reading: Callable[[Array], Array] | None = None,
) -> ContinuousModel:
    """Differentiate a nonlinear model at a point, exactly, by forward-mode differentiation.

    ``A = df/dx``, ``B = df/du``, ``C = dh/dx``, ``E = df/dd``.

    The derivative is ``f(x, u)`` per min, or ``f(x, u, d)`` if a disturbance is given; the output is the glucose
    concentration, and `reading` what the sensor reads in its place. The point need not be a steady state; the drift
    ``f(x0, u0)`` is not part of the model. A controller can linearise again at every sample, since JAX can trace this;
    for a cohort use `jax.vmap`.
    """
    x, u = jnp.asarray(state, dtype=float), jnp.asarray(insulin_mU_min, dtype=float)
    if x.ndim != 1:
        raise Refusal(f"The state must be a vector, but its shape is {x.shape}; use jax.vmap for many people.")
    if u.ndim != 0:
        raise Refusal(f"The insulin infusion must be a scalar, but its shape is {u.shape}.")
    point = (x, u)
    if disturbance is not None:
        d = jnp.asarray(disturbance, dtype=float)
        if d.ndim != 0:
            raise Refusal(f"The disturbance must be a scalar, but its shape is {d.shape}.")
        point = (x, u, d)  # type: ignore[assignment]
    jacobians = jax.jacfwd(derivative, argnums=tuple(range(len(point))))(*point)
    C, y = jax.jacfwd(output)(x), jnp.asarray(output(x))
    if jacobians[0].shape != (x.size, x.size):
        raise Refusal(
            f"The derivative must have the shape {x.shape} of the state, but it has {jacobians[0].shape[:-1]}."
        )
    if y.ndim != 0:
        raise Refusal(f"The output must be a scalar, but its shape is {y.shape}.")
    return ContinuousModel(
        A=jacobians[0],
        B=jacobians[1],
        C=C,
        E=jacobians[2] if disturbance is not None else None,
        C_reading=None if reading is None else jax.jacfwd(reading)(x),
        state=x,
        insulin_mU_min=u,
        glucose_mg_dl=y,
    )


def zero_order_hold(A: ArrayLike, B: ArrayLike, sample_time_min: float) -> tuple[Array, Array]:
    """Sample ``dx/dt = A x + B u`` with `u` held over each sample, exactly; B and Gamma are ``(n,)`` or ``(n, q)``.

    ``exp([[A, B], [0, 0]] T) = [[Phi, Gamma], [0, I]]``; `A` may be singular.
    """
    A, B = jnp.asarray(A, dtype=float), jnp.asarray(B, dtype=float)
    _check_sample_time(sample_time_min)
    if A.ndim != 2 or A.shape[0] != A.shape[1]:
        raise Refusal(f"A must be square, but its shape is {A.shape}.")
    n = A.shape[0]
    if B.ndim not in (1, 2) or B.shape[0] != n:
        raise Refusal(f"B must be ({n},) or ({n}, q) to go with A, but its shape is {B.shape}.")
    columns = B.reshape(n, -1)
    q = columns.shape[1]
    augmented = jnp.zeros((n + q, n + q)).at[:n, :n].set(A).at[:n, n:].set(columns)
    hold = jax.scipy.linalg.expm(augmented * sample_time_min, max_squarings=48)
    return hold[:n, :n], hold[:n, n:].reshape(B.shape)


def discretise(model: ContinuousModel, sample_time_min: float) -> LinearModel:
    """Sample a continuous model with input and disturbance held over each sample, exactly."""
    inputs = model.B[:, None] if model.E is None else jnp.stack([model.B, model.E], axis=1)
    Phi, held = zero_order_hold(model.A, inputs, sample_time_min)
    return LinearModel(
        Phi=Phi,
        Gamma=held[:, 0],
        C=model.C,
        Psi=None if model.E is None else held[:, 1],
        C_reading=model.C_reading,
        state=model.state,
        insulin_mU_min=model.insulin_mU_min,
        glucose_mg_dl=model.glucose_mg_dl,
        sample_time_min=float(sample_time_min),
    )


def impulse_response(model: LinearModel, samples: int) -> Array:
    """Response ``h_i = C Phi^(i-1) Gamma`` to a unit input held over the first sample [mg/dl per mU/min]."""
    if samples < 1:
        raise Refusal(f"A response needs at least 1 sample, but {samples} were asked for.")
    h: Array = _response(model.Phi, model.Gamma, model.C, samples)
    return h


@functools.partial(jax.jit, static_argnames="samples")
def _response(Phi: Array, Gamma: Array, C: Array, samples: int) -> Array:
    _, h = jax.lax.scan(lambda x, _: (Phi @ x, C @ x), Gamma, None, length=samples)
    return h


def step_response(model: LinearModel, samples: int) -> Array:
    """Response ``S_i = h_1 + ... + h_i`` of the output to a unit step of the input [mg/dl per mU/min]."""
    return jnp.cumsum(impulse_response(model, samples))


def _check_sample_time(sample_time_min: float) -> None:
    if not 0.0 < sample_time_min < float("inf"):
        raise Refusal(f"The sample time must be positive and finite, but it is {sample_time_min} min.")
