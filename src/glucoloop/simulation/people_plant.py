"""The exponential integrator for people whose constants differ.

The exponentials of the slow block are those of the nominal patient without its slow couplings, and so the same for all;
what differs in a person enters with the nonlinear part, at the same order. Insulin has matrices of the person's own.

For the driven block (insulin), with ``X = h A`` they are ``e^X`` and the moments ``m_n = integral of s^n e^(X s) ds
over 0 <= s <= 1``, n = 0, 1, 2, of the path within a step, from which its projection on quadratics follows. Both are
summed by Taylor's series for a step so short that it converges in a few terms, and then doubled: with ``E = e^X`` those
of 2 X are ``E E`` and

    m_0' = (m_0 + E m_0) / 2,    m_1' = (m_1 + E (m_0 + m_1)) / 4,    m_2' = (m_2 + E (m_0 + 2 m_1 + m_2)) / 8.

References
----------
C. Moler, C. Van Loan, "Nineteen dubious ways to compute the exponential of a matrix, twenty-five years later",
SIAM Review 45(1), 2003 (scaling and squaring).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop._pytree import varying
from glucoloop.native.lower import lower
from glucoloop.native.targets import FUSED, STRICT
from glucoloop.native.targets.llvm.kernel import Kernel, compile_kernel
from glucoloop.patients.protocol import SemilinearPatient
from glucoloop.refusal import Refusal
from glucoloop.simulation.exponential import (
    ExponentialPlant,
    Matrices,
    design,
    substeps_for,
    substeps_of,
    working_state,
)
from glucoloop.simulation.plant import SampleGrid
from glucoloop.simulation.user_objects import compiled_by_class, refuse_two_patients

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


PER_NOMINAL: Final = 2
"""Steps of the people's exponential integrator for each that the nominal patient needs."""


class PeoplePlant:
    """Plants of people of one kind, with an integrator that is made about the nominal patient.

    `varied` are some people, to show which constants vary: those that have one axis more than the nominal patient's.
    Products are rounded in the matrices of people as `glucoloop.native.targets` says.
    """

    def __init__(
        self,
        nominal: SemilinearPatient,
        varied: SemilinearPatient,
        grid: SampleGrid,
        substeps: int | None = None,
        products: str = FUSED,
    ) -> None:
        refuse_two_patients(nominal)
        self._products = products
        self.substeps = PER_NOMINAL * substeps_for(grid.sample_time_min) if substeps is None else substeps
        self.step_min, dense = substeps_of(grid, self.substeps)
        state = working_state(nominal)
        matrices = design(nominal, self.step_min, dense, state, nominal.stiff_couplings())
        patient_varies = varying(varied, nominal)
        y, z = nominal.split(state)
        if _depends(lambda p: p.transport(y), nominal, patient_varies):
            matrices = dataclasses.replace(matrices, transport=_transport(nominal, y))
        if _depends(lambda p: p.glucose_mg_dl(p.join(y, z)), nominal, patient_varies):
            matrices = dataclasses.replace(matrices, probe=_probe(nominal, varied))
        self._driven_varies = _depends(lambda p: p.driven_derivative(z, jnp.zeros(())), nominal, patient_varies)
        self._doublings = doublings_for(nominal, self.step_min)
        self.single = ExponentialPlant(patient=nominal, matrices=matrices)
        self.varies = [*patient_varies, *self._matrices_vary()]

    def _matrices_vary(self) -> list[bool]:
        varies: list[bool] = []
        for field in dataclasses.fields(Matrices):
            numbers = len(jax.tree.leaves(getattr(self.single.matrices, field.name)))
            varies += [self._driven_varies and field.name.startswith("driven")] * numbers
        return varies

    def of(self, patient: SemilinearPatient) -> ExponentialPlant:
        """Plants of people, numbers trailing."""
        matrices = self.single.matrices
        if self._driven_varies:
            end, gauss = driven_matrices(
                patient,
                self.step_min,
                states=matrices.driven_end.shape[0],
                doublings=self._doublings,
                products=self._products,
            )
            matrices = dataclasses.replace(matrices, driven_end=jnp.asarray(end), driven_gauss=jnp.asarray(gauss))
        return ExponentialPlant(patient=patient, matrices=matrices)


@compiled_by_class
def _transport(patient: SemilinearPatient, y: jax.Array) -> jax.Array:
    matrix: jax.Array = jax.jacfwd(patient.transport)(y)
    return matrix


def _probe(nominal: SemilinearPatient, varied: SemilinearPatient) -> jax.Array:
    """Slow block at which the nominal patient's glucose is 1 mg/dl; other people's glucose there is their scale.

    Refused if their glucose is not proportional to the nominal patient's in every state: readings inside a step would
    then be wrong.
    """
    y, z = nominal.split(working_state(nominal))
    blocks = np.eye(y.size)
    row = np.array([float(nominal.glucose_mg_dl(nominal.join(jnp.asarray(block), 0.0 * z))) for block in blocks])
    probe = row / (row @ row)
    people = np.shape(varied.basal_insulin_mU_min)

    def read(block: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        slow = jnp.broadcast_to(jnp.asarray(block).reshape(-1, *[1] * len(people)), (block.size, *people))
        glucose = varied.glucose_mg_dl(varied.join(slow, jnp.zeros((z.size, *people))))
        return np.broadcast_to(np.asarray(glucose, float), people)

    scale = read(probe)
    for block, of_nominal in zip(blocks, row, strict=True):
        if not np.allclose(read(block), of_nominal * scale, rtol=1e-9, atol=0.0):
            raise Refusal(
                "glucose of these people is not in proportion to that of the nominal patient in the same state, so it "
                "cannot be read between samples; write the patient's slow block as concentrations"
            )
    return jnp.asarray(probe)


def _depends(function: Callable[[Any], jax.Array], single: Any, varies: Sequence[bool]) -> bool:
    """Whether a function of a person depends on any of the varying leaves."""
    leaves, tree = jax.tree.flatten(single)
    jaxpr = jax.make_jaxpr(lambda *leaves: function(jax.tree.unflatten(tree, leaves)))(*leaves).jaxpr
    used = {id(atom) for equation in jaxpr.eqns for atom in equation.invars}
    return any(differs and id(variable) in used for differs, variable in zip(varies, jaxpr.invars, strict=True))
