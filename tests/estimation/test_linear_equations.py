"""Linear equations of one person and of many, against NumPy."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.estimation.riccati import solved

RNG = np.random.default_rng(5)
MATRICES, RIGHTS = RNG.normal(size=(7, 6, 6)), RNG.normal(size=(7, 6, 3))
EXCHANGED = np.array([[0.0, 1.0], [2.0, 0.0]])


def test_rows_are_exchanged_where_a_pivot_is_zero():
    np.testing.assert_allclose(solved(EXCHANGED, np.eye(2)), np.linalg.inv(EXCHANGED), rtol=1e-15)


@pytest.mark.parametrize(("of_matrix", "of_right"), [(0, 0), (0, None), (None, 0)])
def test_each_of_many_people_has_the_solution_of_numpy(of_matrix, of_right):
    matrix, right = MATRICES if of_matrix == 0 else MATRICES[0], RIGHTS if of_right == 0 else RIGHTS[0]
    found = jax.vmap(solved, in_axes=(of_matrix, of_right))(matrix, right)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-11)


def test_derivatives_in_both_directions_are_those_of_the_inverse():
    A, b = MATRICES[0], RIGHTS[0]
    dA = RNG.normal(size=A.shape)
    x = np.linalg.solve(A, b)
    _, forward = jax.jvp(lambda A: solved(A, b), (jnp.asarray(A),), (jnp.asarray(dA),))
    np.testing.assert_allclose(forward, -np.linalg.solve(A, dA @ x), rtol=1e-9)
    backward = jax.grad(lambda A: solved(A, b).sum())(jnp.asarray(A))
    np.testing.assert_allclose((backward * dA).sum(), forward.sum(), rtol=1e-9)


def test_no_batch_of_matrices_reaches_lapack():
    """Since two at the same time can wait for each other without end, which is seen only now and then."""

    def twice(A, b):
        return solved(A, b), solved(2.0 * A, b)

    twice_mapped = jax.jit(jax.vmap(jax.vmap(twice)))
    text = twice_mapped.lower(MATRICES[None], RIGHTS[None]).compile().as_text()
    calls = [line for line in text.splitlines() if "lapack_" in line]
    assert calls
    for line in calls:
        shapes = re.findall(r"f64\[([\d,]*)\]", line.split("metadata")[0])
        assert shapes
        assert all(shape.count(",") <= 1 for shape in shapes)


@pytest.mark.parametrize(("of_matrix", "of_right"), [(0, 0), (0, None), (None, 0)])
def test_other_devices_solve_for_all_people_at_once(monkeypatch, of_matrix, of_right):
    matrix, right = MATRICES if of_matrix == 0 else MATRICES[0], RIGHTS if of_right == 0 else RIGHTS[0]

    def of_people(matrix, right):
        return jax.vmap(solved, in_axes=(of_matrix, of_right))(matrix, right)

    text = jax.jit(of_people).trace(matrix, right).lower(lowering_platforms=("cuda",)).as_text()
    assert re.search(r"@cusolver_getrf_ffi\(.*tensor<7x6x6xf64>" if of_matrix == 0 else "@cusolver_getrf_ffi", text)
    assert "stablehlo.while" not in text

    # that branch here; a single batch at a time cannot wait for another
    monkeypatch.setattr(jax.lax, "platform_dependent", lambda *given, cpu, default: default(*given))
    np.testing.assert_allclose(of_people(matrix, right), np.linalg.solve(matrix, right), rtol=1e-11)
