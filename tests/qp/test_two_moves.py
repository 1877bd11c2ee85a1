import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from glucoloop.qp import minimise_one_move, minimise_two_moves

U_MAX = 66.9
solve_two = jax.jit(minimise_two_moves)


def assert_allowed(moves, u_prev, max_move, u_min, u_max, slack=1e-12):
    u = u_prev + np.cumsum(np.asarray(moves), axis=0)
    assert np.all(np.abs(moves) <= max_move * (1 + slack))
    assert np.all(u >= u_min - slack * (u_max - u_min))
    assert np.all(u <= u_max + slack * (u_max - u_min))


@st.composite
def programs(draw):
    unit = st.floats(-1.0, 1.0)
    root = np.array([[draw(unit), draw(unit)], [draw(unit), draw(unit)]])
    H = root @ root.T + draw(st.sampled_from([1e-5, 1e-2, 1.0])) * np.eye(2)
    f = draw(st.sampled_from([1e-3, 1.0, 30.0, 1e3])) * np.array([draw(unit), draw(unit)])
    u_prev = draw(st.sampled_from([0.0, U_MAX, 22.33]) | st.floats(0.0, U_MAX))
    max_move = draw(st.sampled_from([16.7, 1.0, 40.0, 200.0]) | st.floats(0.1, 100.0))
    return H, f, u_prev, max_move


@pytest.mark.long
@settings(deadline=None, max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(programs())
def test_two_moves_are_the_minimiser(exact_moves, program):
    H, f, u_prev, max_move = program
    moves = np.asarray(solve_two(H, f, u_prev, max_move=max_move, u_min=0.0, u_max=U_MAX))
    truth = exact_moves(H, f, u_prev, max_move, 0.0, U_MAX)
    assert_allowed(moves, u_prev, max_move, 0.0, U_MAX)
    np.testing.assert_allclose(moves, truth, rtol=0, atol=1e-12 * np.linalg.cond(H) * max_move + 1e-9)


def test_single_precision_picks_the_same_moves():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 2, 4000))
    H = np.einsum("ikb,jkb->ijb", root, root) + 0.1 * np.eye(2)[:, :, None]
    f, u_prev = 30 * rng.normal(size=(2, 4000)), rng.uniform(0, U_MAX, 4000)
    limits = {"max_move": 16.7, "u_min": 0.0, "u_max": U_MAX}
    double = solve_two(H, f, u_prev, **limits)
    single = solve_two(*(jnp.asarray(a, dtype=jnp.float32) for a in (H, f, u_prev)), **limits)
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, double, rtol=0, atol=5e-3)
    assert np.median(np.abs(single - double)) < 1e-5


@pytest.mark.long
def test_people_trail():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(2, 2, 50))
    H = np.einsum("ikb,jkb->ijb", root, root)
    f, u_prev, max_move = 20 * rng.normal(size=(2, 50)), rng.uniform(0, U_MAX, 50), rng.uniform(1, 30, 50)
    together = minimise_two_moves(H, f, u_prev, max_move=max_move, u_min=0.0, u_max=U_MAX)
    shared = minimise_two_moves(H[..., 0], f, u_prev, max_move=16.7, u_min=0.0, u_max=U_MAX)
    for i in range(50):
        alone = minimise_two_moves(H[..., i], f[:, i], u_prev[i], max_move=max_move[i], u_min=0.0, u_max=U_MAX)
        np.testing.assert_allclose(together[:, i], alone, rtol=0, atol=1e-12)
        alone = minimise_two_moves(H[..., 0], f[:, i], u_prev[i], max_move=16.7, u_min=0.0, u_max=U_MAX)
        np.testing.assert_allclose(shared[:, i], alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize("H", [np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, 0.0]), np.diag([0.0, 2.0])])
@pytest.mark.parametrize("f", [[0.0, 0.0], [-3.0, -3.0], [1.0, -1.0], [1e-300, 0.0], [-1e12, 1.0]])
def test_a_singular_hessian_still_gives_a_minimiser(H, f):
    moves = np.asarray(solve_two(H, np.array(f), 30.0, max_move=16.7, u_min=0.0, u_max=U_MAX))
    assert_allowed(moves, 30.0, 16.7, 0.0, U_MAX)
    grid = np.linspace(-16.7, 16.7, 201)
    d0, d1 = np.meshgrid(grid, grid)
    within = (30 + d0 + d1 >= 0) & (30 + d0 + d1 <= U_MAX)
    d = np.stack([d0[within], d1[within]])
    objective = 0.5 * np.einsum("in,ij,jn->n", d, H, d) + np.array(f) @ d
    assert 0.5 * moves @ H @ moves + np.array(f) @ moves <= objective.min() + 1e-9 * (1 + np.abs(objective).max())


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_program_gives_no_move(bad):
    limits = {"max_move": 16.7, "u_min": 0.0, "u_max": U_MAX}
    assert np.all(np.isfinite(minimise_two_moves(np.eye(2), np.array([bad, 1.0]), 30.0, **limits)))
    np.testing.assert_array_equal(minimise_two_moves(np.eye(2) * np.nan, np.ones(2), 30.0, **limits), 0.0)
    np.testing.assert_array_equal(minimise_two_moves(np.eye(2), np.full(2, np.nan), 30.0, **limits), 0.0)
    np.testing.assert_array_equal(minimise_one_move(np.eye(1), np.array([bad]), 30.0, **limits), 0.0)


def test_an_input_outside_its_bounds_counts_as_on_them():
    limits = {"max_move": 16.7, "u_min": 0.0, "u_max": U_MAX}
    outside = minimise_two_moves(np.eye(2), np.array([5.0, -3.0]), -4.0, **limits)
    np.testing.assert_array_equal(outside, minimise_two_moves(np.eye(2), np.array([5.0, -3.0]), 0.0, **limits))
    np.testing.assert_allclose(outside, [0.0, 3.0], atol=1e-12)


def test_no_room_means_no_move():
    for limits in ({"max_move": 0.0, "u_min": 0.0, "u_max": U_MAX}, {"max_move": 5.0, "u_min": 9.0, "u_max": 9.0}):
        np.testing.assert_array_equal(minimise_two_moves(np.eye(2), -np.ones(2), 9.0, **limits), 0.0)
        np.testing.assert_array_equal(minimise_one_move(np.eye(1), -np.ones(1), 9.0, **limits), 0.0)


@settings(deadline=None, max_examples=100)
@given(st.floats(1e-6, 1e3), st.floats(-1e4, 1e4), st.floats(0.0, U_MAX), st.floats(0.0, 100.0))
def test_one_move_is_the_clipped_vertex(curvature, slope, u_prev, max_move):
    move = minimise_one_move([[curvature]], [slope], u_prev, max_move=max_move, u_min=0.0, u_max=U_MAX)
    low, high = max(-max_move, -u_prev), min(max_move, U_MAX - u_prev)
    np.testing.assert_allclose(move, [np.clip(-slope / curvature, low, high)], rtol=1e-14, atol=1e-12)
