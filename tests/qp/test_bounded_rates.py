"""One-sided costs within bounds against SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.qp.bounded_rates import OneSided, minimise_rates

M, P = 4, 9
COSTS = OneSided(weight=jnp.linspace(1.0, 2.0, P), straight_beyond=8.0, below=50.0, floor=20.0)
LEAST, MOST = np.zeros(M), np.full(M, 6.0)
minimise = jax.jit(minimise_rates)
slopes = jax.jit(lambda e: COSTS.slopes(e, e - 3.0))
derivative = jax.jit(jax.grad(lambda e: COSTS.cost(e, e - 3.0)))


def problem(seed):
    rng = np.random.default_rng(seed)
    A = -np.tril(rng.uniform(0.0, 3.0, (P, M)))
    e = rng.normal(10.0, 15.0, P)
    return A, e, e - rng.uniform(-5.0, 20.0), rng.uniform(0.0, 6.0, M), np.full(M, 2.0), rng.uniform(0.1, 2.0, M)


def objective(u, A, e, c, start, preferred, preference):
    """As at the head of the module."""
    e, c = e + A @ (u - start), c + A @ (u - start)
    up = np.maximum(e, 0.0)
    huber = np.where(up <= 8.0, 0.5 * up**2, 8.0 * (up - 4.0))
    cost = huber + 25.0 * np.maximum(-e, 0.0) ** 2 + 10.0 * np.maximum(-c, 0.0) ** 2
    return float(np.asarray(COSTS.weight) @ cost + 0.5 * np.sum(preference * (u - preferred) ** 2))


@pytest.mark.parametrize("seed", range(6))
def test_repeated_it_reaches_the_minimum_that_scipy_finds(seed):
    A, e, c, start, preferred, preference = problem(seed)
    found = scipy.optimize.minimize(
        objective,
        start,
        args=(A, e, c, start, preferred, preference),
        bounds=list(zip(LEAST, MOST, strict=True)),
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    u = start
    for _ in range(40):
        moved = A @ (u - start)
        u = np.asarray(minimise(COSTS, e + moved, c + moved, A, u, preferred, preference, LEAST, MOST))
    assert objective(u, A, e, c, start, preferred, preference) <= found.fun * (1.0 + 1e-4) + 1e-6


@given(st.integers(0, 10_000))
def test_it_never_goes_up_nor_beyond_the_bounds(seed):
    A, e, c, start, preferred, preference = problem(seed)
    u = np.asarray(minimise(COSTS, e, c, A, start, preferred, preference, LEAST, MOST))
    assert np.all((u >= LEAST) & (u <= MOST))
    before, after = (objective(v, A, e, c, start, preferred, preference) for v in (start, u))
    assert after <= before * (1.0 + 1e-12)


def test_a_start_beyond_the_bounds_is_brought_within():
    A, e, c, _, preferred, preference = problem(3)
    u = minimise(COSTS, e, c, A, np.array([-5.0, 9.0, 2.0, 100.0]), preferred, preference, LEAST, MOST)
    assert np.all((u >= LEAST) & (u <= MOST))


@given(st.lists(st.floats(-100.0, 100.0), min_size=P, max_size=P))
def test_slopes_are_those_of_the_cost(values):
    e = jnp.asarray(values)
    slope, bend = slopes(e)
    wanted = derivative(e)
    np.testing.assert_allclose(slope, wanted, rtol=1e-9, atol=1e-9)
    assert np.all(np.asarray(bend) > 0.0)
