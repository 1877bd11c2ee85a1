"""Matrices of the driven block for many people, against SciPy and the design of one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from glucoloop.patients import SorensenPatient
from glucoloop.patients.population import Population, draw
from glucoloop.patients.sorensen.varying import with_values
from glucoloop.patients.variation import Variation
from glucoloop.simulation.exponential import design
from glucoloop.simulation.people_plant import doublings_for, driven_matrices

EVERYTHING = Population(
    "everything",
    (
        *(
            Variation(parameter=name, distribution="uniform", spread_pct=35.0)
            for name in ("F_LC", "F_KC", "V_H", "Q_B")
        ),
        Variation(parameter="F_PC", distribution="uniform", spread_pct=10.0),
        Variation(parameter="weight_kg", distribution="lognormal", spread_pct=20.0),
        Variation(parameter="Q_K", distribution="uniform", spread_pct=30.0),
    ),
)
PEOPLE, STEP_MIN = 300, 2.5  # more than go through at a time


def drawn(population, people):
    """Patients with the constants of some people; nobody needs to rest here."""
    return SorensenPatient(
        parameters=jax.tree.map(jnp.asarray, with_values(draw(population, 3, np.arange(people)).values)),
        basal_insulin_mU_min=jnp.ones(people),
        setpoint_mg_dl=jnp.ones(people),
    )


@pytest.fixture(scope="module")
def people():
    return drawn(EVERYTHING, PEOPLE)


@pytest.fixture(scope="module")
def matrices(people, patient_81):
    return driven_matrices(people, STEP_MIN, states=7, doublings=doublings_for(patient_81, STEP_MIN))


def person(people, i):
    return jax.tree.map(lambda a: a[i] if np.ndim(a) else a, people)


def rates(patient):
    z = np.zeros(7)
    A = np.stack([patient.driven_derivative(row, np.zeros(())) for row in np.eye(7)], axis=1)
    return A, np.asarray(patient.driven_derivative(z, np.ones(())))


@pytest.mark.long
@pytest.mark.parametrize("i", [0, 255, 256, 299])
def test_they_are_those_of_the_design_for_one_person(people, matrices, patient_81, i):
    single = design(person(people, i), STEP_MIN, [np.arange(1.0, 3.0)], patient_81.working_state())
    end, gauss = matrices
    np.testing.assert_allclose(end[..., i], single.driven_end, rtol=0.0, atol=2e-13)
    np.testing.assert_allclose(gauss[..., i], single.driven_gauss, rtol=0.0, atol=5e-13)


def test_the_end_of_a_step_is_the_matrix_exponential(people, matrices):
    end, _ = matrices
    for i in range(0, PEOPLE, 37):
        A, b = rates(person(people, i))
        augmented = np.block([[A, b[:, None]], [np.zeros((1, 8))]])
        np.testing.assert_allclose(end[..., i], scipy.linalg.expm(STEP_MIN * augmented)[:7], rtol=0.0, atol=2e-13)


def test_the_path_is_projected_on_quadratics(people, matrices):
    """The values at the Gauss nodes give the integrals of the path with 1, s and s^2."""
    _, gauss = matrices
    A, b = rates(person(people, 11))
    augmented = np.block([[A, b[:, None]], [np.zeros((1, 8))]])
    nodes, weights = np.polynomial.legendre.leggauss(3)
    s = (nodes + 1.0) / 2.0
    fine, fine_weights = np.polynomial.legendre.leggauss(24)
    at = (fine + 1.0) / 2.0
    path = scipy.linalg.expm(at[:, None, None] * STEP_MIN * augmented)[:, :7]
    for power in range(3):
        truth = np.tensordot(fine_weights / 2.0 * at**power, path, 1)
        found = np.tensordot(weights / 2.0 * s**power, gauss[..., 11], 1)
        np.testing.assert_allclose(found, truth, rtol=0.0, atol=1e-12)


def test_a_person_is_the_same_to_the_bit_whoever_is_asked_for(people, matrices, patient_81):
    chosen = np.array([299, 3, 256, 3])
    some = jax.tree.map(lambda a: a[chosen] if np.ndim(a) else a, people)
    again = driven_matrices(some, STEP_MIN, states=7, doublings=doublings_for(patient_81, STEP_MIN))
    for a, b in zip(again, matrices, strict=True):
        np.testing.assert_array_equal(a, b[..., chosen])


def test_flows_four_times_as_fast_need_no_more_doublings(patient_81):
    fast = Population("fast", (Variation(parameter="weight_kg", distribution="uniform", spread_pct=1.0),
                               *(Variation(parameter=n, distribution="uniform", centre=c, spread_pct=1.0)
                                 for n, c in (("V_H", 0.25), ("V_G", 0.24), ("V_K", 0.13)))))  # fmt: skip
    some = drawn(fast, 2)
    end, _ = driven_matrices(some, STEP_MIN, states=7, doublings=doublings_for(patient_81, STEP_MIN))
    for i in range(2):
        A, b = rates(person(some, i))
        augmented = np.block([[A, b[:, None]], [np.zeros((1, 8))]])
        np.testing.assert_allclose(end[..., i], scipy.linalg.expm(STEP_MIN * augmented)[:7], rtol=0.0, atol=2e-13)


@pytest.mark.parametrize("step_min", [1e-3, 0.5, 15.0])
def test_steps_of_any_length(people, patient_81, step_min):
    some = jax.tree.map(lambda a: a[:4] if np.ndim(a) else a, people)
    end, _ = driven_matrices(some, step_min, states=7, doublings=doublings_for(patient_81, step_min))
    A, b = rates(person(people, 2))
    augmented = np.block([[A, b[:, None]], [np.zeros((1, 8))]])
    np.testing.assert_allclose(end[..., 2], scipy.linalg.expm(step_min * augmented)[:7], rtol=0.0, atol=2e-13)
