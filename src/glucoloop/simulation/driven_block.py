"""The exponential integrator's matrices of the driven block (insulin), for many people at once.

With ``X = h A`` they are ``e^X`` and the moments ``m_n = integral of s^n e^(X s) ds over 0 <= s <= 1``, n = 0, 1, 2,
of the path within a step, from which its projection on quadratics follows. Both are summed by Taylor's series for a
step so short that it converges in a few terms, and then doubled: with ``E = e^X`` those of 2 X are ``E E`` and

    m_0' = (m_0 + E m_0) / 2,    m_1' = (m_1 + E (m_0 + m_1)) / 4,    m_2' = (m_2 + E (m_0 + 2 m_1 + m_2)) / 8.

References
----------
C. Moler, C. Van Loan, "Nineteen dubious ways to compute the exponential of a matrix, twenty-five years later",
SIAM Review 45(1), 2003 (scaling and squaring).
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop.native.lower import lower
from glucoloop.native.targets.llvm.kernel import Kernel, compile_kernel
from glucoloop.native.targets.products import FUSED, STRICT
from glucoloop.patients.protocol import SemilinearPatient
from glucoloop.simulation.user_objects import compiled_by_class

Matrix = npt.NDArray[np.float64]

_TERMS: Final = 12
_SHORT: Final = 0.25
"""Largest norm of X at which twelve terms are exact to rounding."""

_AT_A_TIME: Final = 256
"""Number of people whose matrices fit the caches."""

_GAUSS_NODES: Final = (np.polynomial.legendre.leggauss(3)[0] + 1.0) / 2.0
# From monomial moments on [0, 1] to Legendre moments, and from these to the projected path at the Gauss nodes.
_LEGENDRE: Final = np.array([[1.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [1.0, -6.0, 6.0]])
_AT_NODES: Final = np.stack([np.polynomial.polynomial.polyval(_GAUSS_NODES, row) for row in _LEGENDRE], axis=-1)
PATH: Final = _AT_NODES * np.array([1.0, 3.0, 5.0]) @ _LEGENDRE
"""Matrix that makes the projected path at the Gauss nodes of the moments, ``(3, 3)``."""


def doublings_for(single: SemilinearPatient, step_min: float) -> int:
    """Number of doublings for this person and for anyone whose flows are up to four times as fast."""
    z = single.split(single.steady_state(single.basal_insulin_mU_min))[1]
    norm = float(_driven_norm(single, z)) * step_min
    return max(0, math.ceil(math.log2(4.0 * norm / _SHORT)))


@compiled_by_class
def _driven_norm(single: SemilinearPatient, z: jax.Array) -> jax.Array:
    A = jax.jacfwd(lambda z: single.driven_derivative(z, jnp.zeros(())))(z)
    return jnp.abs(A).sum(axis=0).max()


@functools.lru_cache(maxsize=4)
def _kernels(states: int, products: str) -> tuple[Kernel, Kernel]:
    return kept_result(_compiled, states, products)


def _compiled(states: int, products: str) -> tuple[Kernel, Kernel]:
    """One term of the series, and one doubling, of matrices without their last row, which is known."""
    rows, number = np.zeros((states, states + 1)), np.zeros(())

    def whole(rows: Any, last: float) -> Any:
        return jnp.concatenate([rows, jnp.zeros((1, states + 1)).at[0, states].set(last)])

    def term(X: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del own, rng
        power, *sums = carry
        return (power[:, :states] @ X, *(total + c * power for total, c in zip(sums, shared, strict=True))), ()

    def double(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del person, own, shared, rng
        E, m_0, m_1, m_2 = (
            whole(rows, last) for rows, last in zip(carry, (1.0, 1.0, 1.0 / 2.0, 1.0 / 3.0), strict=True)
        )
        doubled = (
            E @ E,
            (m_0 + E @ m_0) / 2.0,
            (m_1 + E @ (m_0 + m_1)) / 4.0,
            (m_2 + E @ (m_0 + 2.0 * m_1 + m_2)) / 8.0,
        )
        return tuple(of_twice[:states] for of_twice in doubled), ()

    portable = products == STRICT
    series = lower(term, rows, (rows,) * 5, (), (number,) * 4, as_written=portable)
    doubling = lower(double, (), (rows,) * 4, (), (), as_written=portable)
    return compile_kernel(series, products=products), compile_kernel(doubling, products=products)


@functools.partial(compiled_by_class, static=(0,))
def rates(patient: SemilinearPatient, states: int) -> jax.Array:
    """A with b beside it and a row of zeros below, ``(d + 1, d + 1, people)``."""
    people = patient.basal_insulin_mU_min.shape[0]
    unit, none = jnp.broadcast_to(jnp.eye(states)[..., None], (states, states, people)), jnp.zeros(people)
    columns = [patient.driven_derivative(unit[k], none) for k in range(states)]
    columns.append(patient.driven_derivative(jnp.zeros((states, people)), jnp.ones(people)))
    A = jnp.stack(columns, axis=1)
    return jnp.concatenate([A, jnp.zeros((1, *A.shape[1:]))])


def driven_matrices(
    patient: SemilinearPatient, step_min: float, *, states: int, doublings: int, products: str = FUSED
) -> tuple[Matrix, Matrix]:
    """Matrices of a step for people whose constants trail, as in `exponential.Matrices`.

    They are ``driven_end``, ``(d, d + 1, people)``, and ``driven_gauss``, ``(3, d, d + 1, people)``, for d states of
    the driven block; for the number of doublings see `doublings_for`.
    """
    series, doubling = _kernels(states, products)
    X = np.asarray(rates(patient, states)) * (step_min / 2**doublings)
    people, size = X.shape[-1], states + 1
    E, path = np.empty((states, size, people)), np.empty((3, states, size, people))
    k = np.arange(_TERMS + 1)
    factorial = np.array([math.factorial(i) for i in k], float)
    terms = np.stack([np.ones(k.size), 1.0 / (k + 1), 1.0 / (k + 2), 1.0 / (k + 3)], axis=1) / factorial[:, None]
    columns = series.padded(min(people, _AT_A_TIME))
    person, carry = np.zeros((states * size, columns)), np.zeros((5 * states * size, columns))
    nothing = np.zeros((max(k.size, doublings), 0, columns))
    for start in range(0, people, columns):
        block = slice(start, min(start + columns, people))
        n = block.stop - start
        person[:, :n] = X[:states, :, block].reshape(-1, n)
        carry[:] = 0.0
        carry[: states * size : size + 1] = 1.0  # the power begins as the identity
        series.run(person, carry, nothing[: k.size], terms, nothing[: k.size])
        result = carry[states * size :]
        doubling.run(person[:0], result, nothing[:doublings], np.zeros((doublings, 0)), nothing[:doublings])
        parts = result[:, :n].reshape(4, states, size, n)
        E[..., block] = parts[0]
        path[..., block] = np.tensordot(PATH, parts[1:], 1)
    return E, path
