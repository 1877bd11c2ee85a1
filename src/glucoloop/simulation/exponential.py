"""Exponential integrator of a semilinear patient: linear transport exactly, one step per sample.

Over a step of length h the infusion is constant. The driven block (insulin) is propagated by its matrix exponential.
Its effects on the slow block are taken at three Gauss nodes of its path, that path first being projected on quadratics,
so that each effect enters as a quadratic in time with the right moments, however fast insulin moves within the step.
The meal enters as the quadratic with its exact moments. The slow block is linearised at the patient's working
state, its linear part is propagated exactly, and what is left, which is small near that state, is treated by the
fourth-order exponential Runge-Kutta method of Krogstad (2005). Between samples the same quadratics give the glucose at
any moment.

References
----------
S. Krogstad, "Generalized integrating factor methods for stiff PDEs", J. Comput. Phys. 203, 2005.
M. Hochbruck, A. Ostermann, "Exponential integrators", Acta Numerica 19, 2010.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop._lazy_jax import scipy
from glucoloop._pytree import pytree, static
from glucoloop.arguments import ArgumentTypeError, at_once, checked, is_traced
from glucoloop.meals.absorption import Absorption
from glucoloop.meals.moments import at_start_middle_end
from glucoloop.patients.protocol import Patient, SemilinearPatient
from glucoloop.refusal import Refusal
from glucoloop.simulation.plant import Exogenous, SampleGrid
from glucoloop.simulation.user_objects import Content, compiled_by_class, refuse_two_patients

Matrix = npt.NDArray[np.float64]

_FINE_NODES, _FINE_WEIGHTS = np.polynomial.legendre.leggauss(32)  # for moments of the driven path; exact to rounding
_GAUSS_NODES: Final = np.polynomial.legendre.leggauss(3)[0]


def _legendre(x: Matrix) -> Matrix:
    """Values of P_0, P_1, P_2 at points of [-1, 1], as columns."""
    return np.stack([np.ones_like(x), x, (3.0 * x * x - 1.0) / 2.0], axis=-1)


# A quadratic over the step is carried by its values at the start, the middle and the end.
_FROM_GAUSS: Final = _legendre(np.array([-1.0, 0.0, 1.0])) @ np.linalg.inv(_legendre(_GAUSS_NODES))
_MEAN_OF_GAUSS: Final = np.polynomial.legendre.leggauss(3)[1] / 2.0
_PROJECT_ON_GAUSS: Final = (
    _legendre(_GAUSS_NODES) * np.array([1.0, 3.0, 5.0]) @ (_legendre(_FINE_NODES) * _FINE_WEIGHTS[:, None] / 2.0).T
)


def _phi(M: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """``phi_0 .. phi_3`` of a square matrix, from one augmented exponential."""
    n = M.shape[0]
    augmented = np.zeros((4 * n, 4 * n))
    augmented[:n, :n] = M
    augmented[: 3 * n, n:] += np.eye(3 * n)
    E = scipy.linalg.expm(augmented)
    return E[:n, :n], E[:n, n : 2 * n], E[:n, 2 * n : 3 * n], E[:n, 3 * n :]


@pytree
class Matrices:
    """Matrices of a step, computed once per patient and step length."""

    driven_end: jax.Array
    """(d, d + 1) the driven block at the end of the step, from its start and the infusion."""
    driven_gauss: jax.Array
    """(3, d, d + 1) projected path of the driven block at the Gauss nodes."""
    beyond_transport: jax.Array
    """(n, n) part of the slow block in the exponentials beyond its transport, ``L - T``."""
    half: jax.Array
    """(3, n, n) half step: exponential, ``h/2 phi_1``, ``h phi_2``."""
    full: jax.Array
    """(3, n, n) full step: exponential, ``h phi_1``, ``2 h phi_2``."""
    end: jax.Array
    """(3, n, n) weights of a quadratic source, by its values at start, middle and end."""
    dense: jax.Array
    """(substeps, times, 4, n) rows that read glucose at the moments inside each substep, padded with zeros."""
    wanted: jax.Array
    """(points,) indices of those among the ``substeps * times`` readings that are not padding."""
    transport: jax.Array | None = None
    """(n, n) T, if it is not the patient's own; the difference is left to the nonlinear part."""
    probe: jax.Array | None = None
    """(n,) slow block whose glucose by `dense` is 1 mg/dl, if the patient's own state reads glucose in another way."""


def _quadratic_weights(L: Matrix, h: float, theta: float) -> Matrix:
    """``E, W_0, W_m, W_1`` with ``y(theta h) = E y + W_0 s_0 + W_m s_m + W_1 s_1``, stacked.

    The source is the quadratic through s_0, s_m, s_1 at the start, the middle and the end of the step.
    """
    phi_0, phi_1, phi_2, phi_3 = _phi(theta * h * L)
    a, b, c = h * theta * phi_1, h * theta**2 * phi_2, 2.0 * h * theta**3 * phi_3
    return np.stack([phi_0, a - 3.0 * b + 2.0 * c, 4.0 * b - 4.0 * c, -b + 2.0 * c])


@compiled_by_class
def _linearisation(patient: SemilinearPatient, x: jax.Array) -> tuple[jax.Array, ...]:
    """Transport T, Jacobian of the kinetics at x, A, b, and the row that reads glucose from the slow block."""
    y, z = patient.split(x)
    none = jnp.zeros(())
    T = jax.jacfwd(patient.transport)(y)
    K = jax.jacfwd(lambda y: patient.kinetics(y, patient.effects(z), none))(y)
    A = jax.jacfwd(lambda z: patient.driven_derivative(z, none))(z)
    b = patient.driven_derivative(jnp.zeros_like(z), jnp.ones(()))
    row = jax.grad(lambda y: patient.glucose_mg_dl(patient.join(y, z)))(y)
    return T, K, A, b, row


def design(
    patient: SemilinearPatient,
    step_min: float,
    dense_times_min: Sequence[Matrix],
    state: jax.Array,
    contained: npt.NDArray[np.bool_] | None = None,
) -> Matrices:
    """Compute the matrices of one step of one person, whose slow block is linearised at a state.

    `dense_times_min` are the moments inside each substep of a sample, counted from its start, at which glucose is
    wanted. `contained` are the entries of the Jacobian of the kinetics, ``(n, n)``, that the exponentials contain, all
    of them by default; the others are left to the Runge-Kutta method, at the same order.
    """
    T, K, A, b, row = (np.asarray(part) for part in kept_result(_linearisation, patient, state))
    K = K if contained is None else np.where(contained, K, 0.0)
    return _design(Content((T, K, A, b, row)), step_min, Content(tuple(dense_times_min)))


def working_state(patient: SemilinearPatient) -> jax.Array:
    """The patient's `working_state`, which is kept, since its dozen small operations take longer to load than to do."""
    return kept_result(_working_state, patient)


def _working_state(patient: SemilinearPatient) -> jax.Array:
    return patient.working_state()


@functools.lru_cache(maxsize=64)
def _design(linearisation: Content, h: float, dense_times_min: Content) -> Matrices:
    """Cached design of the same patient, since matrix exponentials cost more than a day of closed loop."""
    arrays = kept_result(_arrays, *linearisation.tree, h, dense_times_min.tree)
    return Matrices(**jax.device_put(arrays))  # jnp.asarray compiles a program for each shape


def _arrays(
    T: Matrix, K: Matrix, A: Matrix, b: Matrix, row: Matrix, h: float, dense_times: tuple[Matrix, ...]
) -> dict[str, npt.NDArray[Any]]:
    """Matrices of a step by their names."""
    L = T + K
    d = A.shape[0]
    augmented = np.zeros((d + 1, d + 1))
    augmented[:d, :d], augmented[:d, d] = A, b

    path = scipy.linalg.expm(((_FINE_NODES + 1.0) / 2.0 * h)[:, None, None] * augmented)[:, :d]
    half_0, half_1, half_2, _ = _phi(h / 2.0 * L)
    full_0, full_1, full_2, _ = _phi(h * L)
    most = max(times.size for times in dense_times)
    dense = np.zeros((len(dense_times), most, 4, L.shape[0]))
    for rows, times in zip(dense, dense_times, strict=True):
        for position, t in enumerate(times):
            rows[position] = row @ _quadratic_weights(L, h, t / h)
    wanted = [i * most + position for i, times in enumerate(dense_times) for position in range(times.size)]
    return {
        "driven_end": scipy.linalg.expm(h * augmented)[:d],
        "driven_gauss": np.einsum("gf,fij->gij", _PROJECT_ON_GAUSS, path),
        "beyond_transport": K,
        "half": np.stack([half_0, h / 2.0 * half_1, h * half_2]),
        "full": np.stack([full_0, h * full_1, 2.0 * h * full_2]),
        "end": _quadratic_weights(L, h, 1.0)[1:],
        "dense": dense,
        "wanted": np.asarray(wanted),
    }


def step(
    patient: SemilinearPatient,
    matrices: Matrices,
    dense: jax.Array,
    x: jax.Array,
    insulin_mU_min: jax.Array,
    moments: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Advance the state ``(states, ...)`` by one step, and read glucose at the moments inside it, ``(times, ...)``.

    `dense` are the rows ``(times, 4, n)`` that read glucose inside the step, and `moments` the Legendre moments of
    the meal's appearance, ``(3, ...)`` [mg/min]. The infusion is held over the step.
    """
    y, z = patient.split(x)
    drive, path = _driven(patient, matrices, z, insulin_mU_min)
    effects_0, effects_m, effects_1 = jnp.tensordot(jnp.asarray(_FROM_GAUSS, path.dtype), path, 1)
    meal_0, meal_m, meal_1 = at_start_middle_end(moments)

    s_0 = _source(patient, matrices, y, effects_0, meal_0)
    base = matrices.half[0] @ y + matrices.half[1] @ s_0
    s_a = _source(patient, matrices, base, effects_m, meal_m)
    s_b = _source(patient, matrices, base + matrices.half[2] @ (s_a - s_0), effects_m, meal_m)
    base = matrices.full[0] @ y
    y_1 = base + matrices.full[1] @ s_0 + matrices.full[2] @ (s_b - s_0)
    s_1 = _source(patient, matrices, y_1, effects_1, meal_1)
    s_m = (s_a + s_b) / 2.0
    y_end = base + matrices.end[0] @ s_0 + matrices.end[1] @ s_m + matrices.end[2] @ s_1
    glucose = _read(patient, matrices, dense, x, (s_0, s_m, s_1))
    return patient.join(y_end, matrices.driven_end @ drive), glucose


def _rough_step(
    patient: SemilinearPatient,
    matrices: Matrices,
    dense: jax.Array,
    x: jax.Array,
    insulin_mU_min: jax.Array,
    moments: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """`step` with one stage in place of four, the exponential Euler method: for derivatives of forecasts.

    The source stays as it is at the start, under the means of effects and meal over the step.
    """
    y, z = patient.split(x)
    drive, path = _driven(patient, matrices, z, insulin_mU_min)
    s = _source(patient, matrices, y, jnp.tensordot(jnp.asarray(_MEAN_OF_GAUSS, path.dtype), path, 1), moments[0])
    y_end = matrices.full[0] @ y + matrices.full[1] @ s
    return patient.join(y_end, matrices.driven_end @ drive), _read(patient, matrices, dense, x, (s, s, s))


def _driven(
    patient: SemilinearPatient, matrices: Matrices, z: jax.Array, insulin_mU_min: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """State and rate ``(d + 1, ...)`` of the driven block, and its effects ``(3, effects, ...)`` at the Gauss nodes."""
    drive = jnp.concatenate([z, insulin_mU_min[None]])
    return drive, jnp.stack([patient.effects(at_node @ drive) for at_node in matrices.driven_gauss])


def _source(
    patient: SemilinearPatient, matrices: Matrices, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array
) -> jax.Array:
    """Rate of change of the slow block beyond what the exponentials contain."""
    rest = patient.kinetics(y, effects, meal_mg_min) - matrices.beyond_transport @ y
    return rest if matrices.transport is None else rest + patient.transport(y) - matrices.transport @ y


def _read(
    patient: SemilinearPatient, matrices: Matrices, dense: jax.Array, x: jax.Array, source: tuple[jax.Array, ...]
) -> jax.Array:
    """Glucose inside a step that begins at x, of a source at its start, middle and end."""
    y, z = patient.split(x)
    glucose = dense[:, 0] @ y
    for i, s in enumerate(source, start=1):
        glucose = glucose + dense[:, i] @ s
    if matrices.probe is not None:
        glucose = glucose * patient.glucose_mg_dl(patient.join(matrices.probe, jnp.zeros_like(z)))
    return glucose


@pytree
class ExponentialPlant:
    """A patient with the matrices of one sample; implements `Plant`."""

    patient: SemilinearPatient
    matrices: Matrices
    rough: bool = static(default=False)
    """Whether it goes by `_rough_step`."""

    def roughly(self) -> ExponentialPlant:
        """The same plant by `_rough_step`."""
        return dataclasses.replace(self, rough=True)

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Exogenous) -> tuple[jax.Array, jax.Array]:
        """State after one sample, and glucose on the fine grid inside it."""
        dense, moments = self.matrices.dense, exogenous.moments
        assert moments is not None
        if exogenous.minute_inputs.names:
            raise Refusal(
                "the exponential integrator has matrices for a patient whose constants stay, and knows no exercise; "
                "leave the integrator out, or take Explicit() or Adaptive()"
            )
        one = _rough_step if self.rough else step
        if dense.shape[0] == 1:
            return one(self.patient, self.matrices, dense[0], x, insulin_mU_min, moments[0])

        def substep(x: jax.Array, entry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            rows, moments = entry
            return one(self.patient, self.matrices, rows, x, insulin_mU_min, moments)

        x, inside = jax.lax.scan(substep, x, (dense, moments))
        return x, inside.reshape(-1, *inside.shape[2:])[self.matrices.wanted]


def substeps_of(grid: SampleGrid, substeps: int) -> tuple[float, list[Matrix]]:
    """Length of a step, and the moments of the fine grid inside each step of a sample, counted from its start."""
    h = grid.sample_time_min / substeps
    index = np.minimum((grid.inside_min / h - 1e-9).astype(int), substeps - 1)
    return h, [grid.inside_min[index == i] - i * h for i in range(substeps)]


_DEFAULT_STEP_MIN: Final = 5.0
DEFAULT_ACCURACY_MG_DL: Final = 0.06
"""Largest error of glucose with steps of 5 min, under the roughest insulin that the paper's pump can give."""
_ROUGH_ORDER: Final = 2.4
"""Exponent with which that error grows with the step. It is less than four, since insulin that jumps moves within a
minute."""


def substeps_for(sample_time_min: float, accuracy_mg_dl: float = DEFAULT_ACCURACY_MG_DL) -> int:
    """Steps of one sample for an accuracy, by the measured error of rough insulin.

    Smooth insulin has a much smaller error. With steps of h min and insulin that jumps at every sample, the largest
    error of glucose in a day is at most about ``0.06 (h / 5)^2.4`` mg/dl. The page of the integrator compares this with
    measured errors.
    """
    if not 0.0 < accuracy_mg_dl < math.inf:
        raise Refusal(f"accuracy_mg_dl of {accuracy_mg_dl:g} is not possible; give a finite number above 0")
    step_min = _DEFAULT_STEP_MIN * math.pow(accuracy_mg_dl / DEFAULT_ACCURACY_MG_DL, 1.0 / _ROUGH_ORDER)
    return max(1, math.ceil(sample_time_min / step_min - 1e-9))


@checked
@dataclass(frozen=True)
class Exponential:
    """The fast integrator: exact transport, fourth order in the rest, one step per sample of up to 5 min by default.

    Parameters
    ----------
    substeps : int, optional
        Steps per sample; by default as many as the accuracy needs at the sample time, see `substeps_for`.
    near_rest : bool
        Linearise at the basal state instead of the working state: better for a patient who fasts and stays near it,
        since the error is then quadratic in the distance from it.
    accuracy_mg_dl : float
        Error of glucose that is accepted under insulin that jumps at every sample, where no substeps are given.
    """

    substeps: int | None = None
    near_rest: bool = False
    accuracy_mg_dl: float = DEFAULT_ACCURACY_MG_DL

    def __post_init__(self) -> None:
        if self.substeps is not None and self.substeps < 1:
            raise Refusal(f"substeps of {self.substeps} are not possible; give 1 or more")
        substeps_for(_DEFAULT_STEP_MIN, self.accuracy_mg_dl)

    def steps_of(self, grid: SampleGrid) -> int:
        """Steps that this integrator makes in each sample of a grid."""
        return substeps_for(grid.sample_time_min, self.accuracy_mg_dl) if self.substeps is None else self.substeps

    def prepare(self, patient: Patient, absorption: Absorption, grid: SampleGrid) -> tuple[ExponentialPlant, Exogenous]:
        """Matrices for the patient, and the meal's moments `(samples, substeps, 3, ...)` with the times of samples.

        Raises
        ------
        TypeError
            For a patient that is not semilinear.
        ValueError
            For a patient whose derivative is not what its parts make, such as one that follows the clock.
        """
        if not isinstance(patient, SemilinearPatient):
            raise TypeError(f"{type(patient).__name__} has no linear driven block; use Explicit() or Adaptive() for it")
        if is_traced(patient):
            raise ArgumentTypeError(
                "the patient is traced by JAX, but the matrices that carry the patient are exponentials that SciPy "
                "computes; give integrator=Adaptive(), which is differentiated in either mode, or make the patient "
                "outside of the transformation, and use simulate_people for many"
            )
        refuse_two_patients(patient)
        substeps = self.steps_of(grid)
        h, dense = substeps_of(grid, substeps)
        with at_once():
            state = patient.steady_state(patient.basal_insulin_mU_min) if self.near_rest else working_state(patient)
            matrices = design(patient, h, dense, state)
        plant = ExponentialPlant(patient=patient, matrices=matrices)
        moments = absorption.moments(grid.samples, substeps, h)
        return plant, Exogenous(t_min=jax.device_put(grid.t_min), moments=moments)

    def at_sample(
        self, plant: ExponentialPlant, absorption: Absorption, grid: SampleGrid, index: jax.Array
    ) -> tuple[ExponentialPlant, Exogenous, Any]:
        """The same plant, the meals' moments and the time of the sample with a number, and the gut after it."""
        substeps = self.steps_of(grid)
        moments, gut = absorption.at_sample(index, substeps, grid.sample_time_min / substeps)
        return plant, Exogenous(t_min=index * grid.sample_time_min, moments=moments), gut
