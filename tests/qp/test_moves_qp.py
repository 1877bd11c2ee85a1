import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from glucoloop.qp import limit_moves, minimise_many_moves, minimise_moves, minimise_two_moves, solve_qp

U_MAX = 66.9
solve_many, solve = jax.jit(minimise_many_moves), jax.jit(minimise_moves)


def controller_program(m, p, penalty, error, tau=54.0):
    """Hessian and gradient of a predictive controller on a first-order lag, and its least-squares form."""
    step = -2.6 * (1 - np.exp(-5.0 * np.arange(1, p + 1) / tau))
    dynamic = np.array([[step[i - j] if i >= j else 0.0 for j in range(m)] for i in range(p)])
    H = dynamic.T @ dynamic + penalty**2 * np.eye(m)
    stacked = np.concatenate([dynamic, penalty * np.eye(m)])
    return H, dynamic.T @ error, stacked, np.concatenate([-error, np.zeros(m)])


@st.composite
def programs(draw, largest=8):
    m = draw(st.integers(3, largest))
    p = draw(st.integers(m, 20))
    penalty = draw(st.sampled_from([0.0, 1e-3, 0.1, 1.0]))
    size = draw(st.sampled_from([0.1, 10.0, 100.0, 1000.0]))
    seed = draw(st.integers(0, 2**16))
    error = size * (np.full(p, draw(st.floats(-1, 1))) + draw(st.sampled_from([0.0, 1.0])) * noise(seed, p))
    u_prev = draw(st.sampled_from([0.0, U_MAX, 22.33]) | st.floats(0.0, U_MAX))
    return (*controller_program(m, p, penalty, error), u_prev)


def noise(seed, n):
    return np.random.default_rng(seed).normal(size=n)


def assert_allowed(moves, u_prev, max_move, u_min, u_max):
    u = u_prev + np.cumsum(moves)
    assert np.all(np.abs(moves) <= max_move + 1e-12)
    assert np.all((u >= u_min - 1e-10) & (u <= u_max + 1e-10))


# Truth: the active sets of three and four moves; a bounded least-squares problem where only one kind of limit counts.


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(programs(largest=4), st.sampled_from([1.0, 16.7, 60.0]))
def test_few_moves_agree_with_an_enumeration_of_active_sets(exact_moves, program, max_move):
    H, f, _, _, u_prev = program
    solution = solve_many(H, f, u_prev, max_move=max_move, u_min=0.0, u_max=U_MAX)
    assert solution.converged
    assert_allowed(solution.moves, u_prev, max_move, 0.0, U_MAX)
    np.testing.assert_allclose(solution.moves, exact_moves(H, f, u_prev, max_move, 0.0, U_MAX), rtol=0, atol=1e-5)


def assert_no_worse(H, f, moves, truth):
    gap = (moves - truth) @ (f + H @ (moves + truth) / 2)
    assert gap <= 1e-9 * np.abs(f).max() * np.abs(truth).max() + 1e-12 * max(np.abs(H).max(), np.abs(f).max())


@settings(deadline=None, max_examples=100)
@given(programs(), st.sampled_from([1.0, 16.7]))
@pytest.mark.long
def test_rate_limits_alone_agree_with_bounded_least_squares(program, max_move):
    H, f, stacked, right, _ = program
    truth = scipy.optimize.lsq_linear(stacked, right, (-max_move, max_move), method="bvls", tol=1e-15, max_iter=500)
    solution = solve_many(H, f, 0.0, max_move=max_move, u_min=-1e4, u_max=1e4)
    assert solution.converged
    assert_allowed(solution.moves, 0.0, max_move, -1e4, 1e4)
    assert_no_worse(H, f, np.asarray(solution.moves), truth.x)


@settings(deadline=None, max_examples=100)
@given(programs())
def test_magnitude_limits_alone_agree_with_bounded_least_squares(program):
    H, f, stacked, right, u_prev = program
    to_moves = np.linalg.inv(np.tril(np.ones_like(H)))
    bounds = (-u_prev - 1e-13, U_MAX - u_prev + 1e-13)
    truth = scipy.optimize.lsq_linear(stacked @ to_moves, right, bounds, method="bvls", tol=1e-15, max_iter=500)
    solution = solve_many(H, f, u_prev, max_move=100.0, u_min=0.0, u_max=U_MAX)
    assert solution.converged
    assert_allowed(solution.moves, u_prev, 100.0, 0.0, U_MAX)
    assert_no_worse(H, f, np.asarray(solution.moves), to_moves @ truth.x)


@settings(deadline=None, max_examples=60)
@given(programs(), st.sampled_from([1.0, 16.7]))
def test_no_general_solver_finds_better_moves(program, max_move):
    H, f, _, _, u_prev = program
    m, scale = len(f), max(np.abs(H).max(), np.abs(f).max())
    sums = np.tril(np.ones((m, m)))
    solution = solve_many(H, f, u_prev, max_move=max_move, u_min=0.0, u_max=U_MAX)
    general = scipy.optimize.minimize(
        lambda d: (0.5 * d @ H @ d + f @ d) / scale,
        np.zeros(m),
        jac=lambda d: (H @ d + f) / scale,
        bounds=[(-max_move, max_move)] * m,
        constraints={
            "type": "ineq",
            "fun": lambda d: np.concatenate([u_prev + sums @ d, U_MAX - u_prev - sums @ d]),
            "jac": lambda d: np.concatenate([sums, -sums]),
        },
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 300},
    )
    assert solution.converged
    assert_allowed(solution.moves, u_prev, max_move, 0.0, U_MAX)
    rival = np.asarray(limit_moves(general.x, u_prev, max_move=max_move, u_min=0.0, u_max=U_MAX))
    assert_no_worse(H, f, np.asarray(solution.moves), rival)


def test_two_moves_agree_with_the_closed_form():
    for seed in range(40):
        H, f, _, _ = controller_program(2, 8, 0.1, 30 * noise(seed, 8))
        limits = {"max_move": 16.7, "u_min": 0.0, "u_max": U_MAX}
        general = solve_many(H, f, 22.33, **limits)
        np.testing.assert_allclose(general.moves, minimise_two_moves(H, f, 22.33, **limits), rtol=0, atol=1e-7)


# Degenerate programs, and what is no program at all.


def test_no_room_means_no_move():
    H, f, _, _ = controller_program(3, 8, 0.0, np.ones(8))
    np.testing.assert_array_equal(solve_many(H, f, 9.0, max_move=5.0, u_min=9.0, u_max=9.0).moves, 0.0)
    np.testing.assert_array_equal(solve_many(H, f, 9.0, max_move=0.0, u_min=0.0, u_max=U_MAX).moves, 0.0)


def test_a_hessian_of_lower_rank_still_gives_a_minimiser():
    H, f = np.ones((4, 4)), np.full(4, -20.0)
    solution = solve_many(H, f, 22.33, max_move=16.7, u_min=0.0, u_max=U_MAX)
    assert solution.converged
    np.testing.assert_allclose(np.sum(solution.moves), 20.0, atol=1e-7)
    solution = solve_many(np.zeros((3, 3)), np.array([-1.0, 0.0, 0.0]), 22.33, max_move=5.0, u_min=0.0, u_max=U_MAX)
    assert solution.converged
    np.testing.assert_allclose(solution.moves[0], 5.0, atol=1e-7)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_non_finite_program_gives_allowed_moves_and_says_so(bad):
    H, f, _, _ = controller_program(4, 8, 0.1, np.ones(8))
    for H1, f1 in ((H * bad, f), (H, np.array([1.0, bad, 1.0, 1.0]))):
        solution = solve_many(H1, f1, 1.0, max_move=16.7, u_min=0.0, u_max=U_MAX)
        assert not solution.converged
        assert_allowed(solution.moves, 1.0, 16.7, 0.0, U_MAX)
    two = minimise_moves(np.eye(2), np.array([bad, 0.0]), 1.0, max_move=16.7, u_min=0.0, u_max=U_MAX)
    assert not two.converged
    assert np.all(np.isfinite(two.moves))


def test_general_programs_know_their_multipliers():
    # min (x-3)^2 + (y-2)^2 with x + y <= 3, x <= 1.5: at (1.5, 1.5) the multipliers are 2 and 1; the last row is off.
    solution = solve_qp(
        2 * np.eye(2), [-6.0, -4.0], [[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]], jnp.array([3.0, 1.5, jnp.inf])
    )
    assert solution.converged
    np.testing.assert_allclose(solution.x, [1.5, 1.5], atol=1e-9)
    np.testing.assert_allclose(solution.multipliers, [1.0, 2.0, 0.0], atol=1e-8)


def test_an_infeasible_program_is_not_called_converged():
    assert not solve_qp(np.eye(1), [0.0], [[1.0], [-1.0]], [-1.0, -1.0]).converged


@pytest.mark.parametrize(
    ("H", "f", "G", "h"),
    [
        (np.eye(3), np.ones(2), np.eye(2), np.ones(2)),
        (np.eye(2), np.ones(2), np.eye(3), np.ones(3)),
        (np.eye(2), np.ones(2), np.eye(2), np.ones(3)),
        (np.eye(2), np.ones(2), np.zeros((0, 2)), np.zeros(0)),
    ],
)
def test_shapes_that_do_not_fit_are_refused(H, f, G, h):
    with pytest.raises(ValueError, match="H must be"):
        solve_qp(H, f, G, h)


def test_moves_of_a_wrong_shape_are_refused():
    with pytest.raises(ValueError, match="H must be"):
        minimise_moves(np.eye(2), np.ones(3), 0.0, max_move=1.0, u_min=0.0, u_max=1.0)


# How it runs.


@pytest.mark.parametrize("m", [1, 2, 4])
def test_a_cohort_is_its_people(m):
    rng = np.random.default_rng(1)
    H = np.stack([controller_program(m, 10, penalty, np.ones(10))[0] for penalty in (0.0, 0.3, 1.0)], axis=-1)
    f, u_prev = 50 * rng.normal(size=(m, 3)), rng.uniform(0, U_MAX, 3)
    together = solve(H, f, u_prev, max_move=16.7, u_min=0.0, u_max=U_MAX)
    assert together.converged.shape == (3,)
    assert np.all(together.converged)
    for i in range(3):
        alone = solve(H[..., i], f[:, i], u_prev[i], max_move=16.7, u_min=0.0, u_max=U_MAX)
        np.testing.assert_allclose(together.moves[:, i], alone.moves, rtol=0, atol=1e-7)


def test_it_runs_inside_a_scan():
    H, f, _, _ = controller_program(4, 10, 0.1, np.full(10, 20.0))

    def step(u, scale):
        solution = minimise_moves(H, f * scale, u, max_move=16.7, u_min=0.0, u_max=U_MAX)
        return u + solution.moves[0], solution.converged

    scales = np.array([1.0, -1.0, 3.0, -5.0, 0.0])
    u, converged = jax.jit(lambda: jax.lax.scan(step, 22.33, scales))()
    expected = 22.33
    for scale in scales:
        expected, _ = step(expected, scale)
    assert np.all(converged)
    np.testing.assert_allclose(u, expected, atol=1e-7)


def test_limits_are_applied_in_sequence():
    moves = limit_moves([30.0, 30.0, -90.0], 40.0, max_move=16.7, u_min=0.0, u_max=U_MAX)
    np.testing.assert_allclose(moves, [16.7, 10.2, -16.7], atol=1e-12)
    np.testing.assert_allclose(limit_moves([-5.0], -3.0, max_move=16.7, u_min=0.0, u_max=U_MAX), [0.0])
