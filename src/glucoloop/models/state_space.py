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

import math
from collections.abc import Callable

from glucoloop._lazy_jax import jax, jit, jnp
from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.refusal import Refusal


@pytree
class ContinuousModel:
    """A linear model in continuous time, per min, and the point (x0, u0, y0) about which it holds.

    Its fields have the shapes of those of `LinearModel`.
    """

    A: jax.Array
    B: jax.Array
    C: jax.Array
    E: jax.Array | None = None
    C_reading: jax.Array | None = None
    state: jax.Array
    insulin_mU_min: jax.Array
    glucose_mg_dl: jax.Array


@represented
@pytree
class LinearModel:
    """A linear model sampled with a zero-order hold, and the point about which it holds."""

    Phi: jax.Array
    """Transition over one sample, ``(n, n)``."""
    Gamma: jax.Array
    """Effect of an input held over one sample, per mU/min, ``(n,)``."""
    C: jax.Array
    """Output row, ``(n,)``."""
    Psi: jax.Array | None = None
    """Effect of a disturbance held over one sample, ``(n,)``."""
    C_reading: jax.Array | None = None
    """Output row of the sensor, ``(n,)``, or None where it reads glucose."""
    state: jax.Array
    """Operating point x0, ``(n,)``."""
    insulin_mU_min: jax.Array
    """Operating point u0."""
    glucose_mg_dl: jax.Array
    """Operating point y0."""
    sample_time_min: float = static()
    """Sample time of the model."""

    @property
    def reading_row(self) -> jax.Array:
        """Output row ``(n,)`` of the sensor."""
        return self.C if self.C_reading is None else self.C_reading


def linearise(
    derivative: Callable[..., jax.Array],
    output: Callable[[jax.Array], jax.Array],
    state: jax.typing.ArrayLike,
    insulin_mU_min: jax.typing.ArrayLike,
    disturbance: jax.typing.ArrayLike | None = None,
    *,
    reading: Callable[[jax.Array], jax.Array] | None = None,
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


def zero_order_hold(
    A: jax.typing.ArrayLike, B: jax.typing.ArrayLike, sample_time_min: float
) -> tuple[jax.Array, jax.Array]:
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
    hold = jax.scipy.linalg.expm(_augmented(A, B.reshape(n, -1)) * sample_time_min, max_squarings=48)
    return hold[:n, :n], hold[:n, n:].reshape(B.shape)


def _exponential(M: jax.Array, halvings: int) -> jax.Array:
    """Matrix exponential by a series of fixed length, of a matrix halved so often, and squared as often.

    Without a solve, for a program that has none. The series ends at the power 8. A mode that decays by
    ``exp(-z N)``, with N = 2^halvings, has an error near ``N exp(-(N - 1) z) z^9 / 9!``, at most 1e-9 with 4 halvings
    and 4e-13 with 5; for the modes to stay stable z is at most 3, as `halvings_of` takes care.
    """
    first = M * 0.5**halvings
    second = first @ first
    third, fourth = second @ first, second @ second
    total = fourth / math.factorial(8)
    powers = (jnp.eye(M.shape[0], dtype=M.dtype), first, second, third)
    for block in (4, 0):
        total = total + sum(power / math.factorial(block + i) for i, power in enumerate(powers))
        total = total @ fourth if block else total
    return jax.lax.scan(lambda root, _: (root @ root, None), total, None, length=halvings)[0]


def halvings_of(model: ContinuousModel, sample_time_min: float) -> int:
    """Halvings that `_exponential` needs to sample a model, so that the 1-norm of what is left is at most 3."""
    size = float(jnp.abs(_augmented(model.A, _inputs(model))).sum(axis=0).max()) * sample_time_min
    return max(4, math.ceil(math.log2(max(size, 1e-9) / 3.0)))


def _inputs(model: ContinuousModel) -> jax.Array:
    return model.B[:, None] if model.E is None else jnp.stack([model.B, model.E], axis=1)


def _augmented(A: jax.Array, columns: jax.Array) -> jax.Array:
    """``[[A, B], [0, 0]]``, whose exponential holds the inputs."""
    n, q = columns.shape
    return jnp.zeros((n + q, n + q)).at[:n, :n].set(A).at[:n, n:].set(columns)


def discretise(model: ContinuousModel, sample_time_min: float, halvings: int | None = None) -> LinearModel:
    """Sample a continuous model with input and disturbance held over each sample, exactly.

    With a number of halvings the matrix exponential is `_exponential`, which is exact to its error, and else JAX's.
    """
    inputs = _inputs(model)
    if halvings is None:
        Phi, integrals = zero_order_hold(model.A, inputs, sample_time_min)
    else:
        n = model.A.shape[0]
        hold = _exponential(_augmented(model.A, inputs) * sample_time_min, halvings)
        Phi, integrals = hold[:n, :n], hold[:n, n:]
    return LinearModel(
        Phi=Phi,
        Gamma=integrals[:, 0],
        C=model.C,
        Psi=None if model.E is None else integrals[:, 1],
        C_reading=model.C_reading,
        state=model.state,
        insulin_mU_min=model.insulin_mU_min,
        glucose_mg_dl=model.glucose_mg_dl,
        sample_time_min=float(sample_time_min),
    )


def impulse_response(model: LinearModel, samples: int) -> jax.Array:
    """Response ``h_i = C Phi^(i-1) Gamma`` to a unit input held over the first sample [mg/dl per mU/min]."""
    if samples < 1:
        raise Refusal(f"A response needs at least 1 sample, but {samples} were asked for.")
    h: jax.Array = _response(model.Phi, model.Gamma, model.C, samples)
    return h


@jit(static_argnames="samples")
def _response(Phi: jax.Array, Gamma: jax.Array, C: jax.Array, samples: int) -> jax.Array:
    _, h = jax.lax.scan(lambda x, _: (Phi @ x, C @ x), Gamma, None, length=samples)
    return h


def step_response(model: LinearModel, samples: int) -> jax.Array:
    """Response ``S_i = h_1 + ... + h_i`` of the output to a unit step of the input [mg/dl per mU/min]."""
    return jnp.cumsum(impulse_response(model, samples))


def _check_sample_time(sample_time_min: float) -> None:
    if not 0.0 < sample_time_min < float("inf"):
        raise Refusal(f"The sample time must be positive and finite, but it is {sample_time_min} min.")
