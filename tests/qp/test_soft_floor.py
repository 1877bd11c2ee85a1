"""Moves above a soft floor: optimal as convex programs go, and those of the program with its slacks written out."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from glucoloop.qp import minimise_moves, minimise_moves_above_floor, soft_floor

U_MAX = 66.9
LIMITS = {"u_min": 0.0, "u_max": U_MAX}
P = 13
solve, solve_plain = jax.jit(minimise_moves_above_floor), jax.jit(minimise_moves)


def dynamic_matrix(m, tau, late):
    step = np.r_[np.zeros(late), -2.6 * (1 - np.exp(-5.0 * np.arange(1, P + 1) / tau))]
    return np.array([[step[i - j] if i >= j else 0.0 for j in range(m)] for i in range(P)])


def programs(m, people, seed, weights=(1.0, 3.0, 10.0, 30.0, 100.0)):
    """Programs of predictive controllers whose glucose is about to be, or is, near the floor; people trail."""
    rng = np.random.default_rng(seed)
    H, f, A, short, u, rate = [], [], [], [], [], []
    for _ in range(people):
        response = dynamic_matrix(m, rng.choice([20.0, 54.0, 150.0]), rng.integers(0, 4))
        output, move = rng.choice([1.0, 3.0]), rng.choice([0.0, 0.1, 1.0])
        free = rng.choice([60.0, 65.0, 70.0, 80.0]) + 5.0 * rng.normal() * np.arange(P)
        free += rng.choice([0.0, 1.0, 20.0]) * rng.normal(size=P)
        H.append(output**2 * response.T @ response + move**2 * np.eye(m))
        f.append(-(output**2) * response.T @ (rng.choice([30.0, 60.0, 81.0]) - free))
        A.append(response)
        short.append(rng.choice([60.0, 65.0, 70.0]) - free)
        u.append(rng.uniform(0.0, U_MAX))
        rate.append(rng.choice([2.0, 16.7]))
    trailing = [np.stack(part, axis=-1) for part in (H, f, A, short, u, rate)]
    return (*trailing, rng.choice(weights))


def vertices(m, u_prev, rate):
    """Corners of what the pump allows, by trying every m of its limits."""
    eye, sums = np.eye(m), np.tril(np.ones((m, m)))
    rows = np.concatenate([eye, -eye, sums, -sums])
    levels = np.concatenate([np.full(2 * m, rate), np.full(m, U_MAX - u_prev), np.full(m, u_prev)])
    sets = np.array(list(itertools.combinations(range(4 * m), m)))
    sets = sets[np.abs(np.linalg.det(rows[sets])) > 0.5]
    corners = np.linalg.solve(rows[sets], levels[sets][..., None])[..., 0]
    return corners[np.all(corners @ rows.T <= levels + 1e-9, axis=1)]


def objective(d, H, f, A, short, w):
    return 0.5 * d @ H @ d + f @ d + 0.5 * np.sum((w * np.maximum(0.0, short - A @ d)) ** 2)


def largest_gain(d, H, f, A, short, w, corners):
    """No allowed moves are better than d by more than this: a convex function lies above its tangent."""
    gradient = H @ d + f - A.T @ (w**2 * np.maximum(0.0, short - A @ d))
    return np.max((d - corners) @ gradient)


def assert_allowed(moves, u_prev, rate):
    u = u_prev + np.cumsum(moves)
    assert np.all(np.abs(moves) <= rate + 1e-12)
    assert np.all((u >= -1e-10) & (u <= U_MAX + 1e-10))


@pytest.mark.parametrize(("m", "people", "seeds"), [(1, 200, 1), (2, 200, 8), (3, 20, 3)])
def test_no_allowed_moves_are_better(m, people, seeds):
    bound, rounds = 0, []
    for seed in range(seeds):
        H, f, A, short, u, rate, w = programs(m, people, seed)
        found = solve(H, f, A, short, w, u, max_move=rate, **LIMITS)
        assert np.all(found.converged)
        for i in range(people):
            one = H[..., i], f[:, i], A[..., i], short[:, i], w
            d = np.asarray(found.moves[:, i])
            assert_allowed(d, u[i], rate[i])
            gain = largest_gain(d, *one, vertices(m, u[i], rate[i]))
            scale = np.sum((w * short[:, i]) ** 2) + np.sum(np.abs(f[:, i])) * rate[i]
            assert gain <= (1e-12 if m < 3 else 1e-9) * scale
        plain = solve_plain(H, f, u, max_move=rate, **LIMITS)
        bound += int(np.sum(np.any(plain.moves != found.moves, axis=0)))
        rounds.append(int(np.max(found.iterations)))
    assert bound > 0.3 * people * seeds  # the floor counts in many of them
    assert max(rounds) < soft_floor.ROUNDS
    assert m == 3 or max(rounds) >= 4  # and the programs are no easy ones


def with_slacks(H, f, A, short, w, u_prev, rate):
    """The moves by a general solver that knows the slacks as variables."""
    m = len(f)
    sums, scale = np.tril(np.ones((m, m))), 1.0 + np.abs(f).max()
    hessian = np.block([[H, np.zeros((m, P))], [np.zeros((P, m)), w**2 * np.eye(P)]]) / scale
    gradient = np.r_[f, np.zeros(P)] / scale
    rows = np.block([[A, np.eye(P)], [sums, np.zeros((m, P))], [-sums, np.zeros((m, P))]])
    levels = np.concatenate([short, np.full(m, -u_prev), np.full(m, u_prev - U_MAX)])
    return scipy.optimize.minimize(
        lambda x: 0.5 * x @ hessian @ x + gradient @ x,
        np.r_[np.zeros(m), np.maximum(0.0, short)],
        jac=lambda x: hessian @ x + gradient,
        bounds=[(-rate, rate)] * m + [(0.0, None)] * P,
        constraints={"type": "ineq", "fun": lambda x: rows @ x - levels, "jac": lambda x: rows},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    ).x[:m]


@pytest.mark.parametrize("m", [1, 2])
def test_the_program_with_its_slacks_written_out_has_the_same_moves(m):
    H, f, A, short, u, rate, w = programs(m, 200, 11, weights=(3.0,))
    H = H + np.eye(m)[..., None]  # so that a general solver knows the moves as well as the objective
    found = solve(H, f, A, short, w, u, max_move=rate, **LIMITS)
    asked = np.flatnonzero(found.iterations)[:25]
    truth = [with_slacks(H[..., i], f[:, i], A[..., i], short[:, i], w, u[i], rate[i]) for i in asked]
    np.testing.assert_allclose(found.moves[:, asked], np.transpose(truth), rtol=0.0, atol=1e-6)


def test_a_floor_that_asks_for_nothing_changes_no_bit():
    H, f, A, short, u, rate, w = programs(2, 200, 3)
    plain = minimise_moves(H, f, u, max_move=rate, **LIMITS)
    for level, weight in ((short - 1e4, w), (short, 0.0)):
        found = minimise_moves_above_floor(H, f, A, level, weight, u, max_move=rate, **LIMITS)
        np.testing.assert_array_equal(found.moves, plain.moves)
        np.testing.assert_array_equal(found.iterations, 0)
        assert np.all(found.converged)


def test_each_sample_has_its_own_weight():
    H, f, A, short, u, rate, _ = programs(2, 200, 4)
    near = np.arange(P) < 6
    found = solve(H, f, A, short, np.where(near, 10.0, 0.0), u, max_move=rate, **LIMITS)
    # what lies far below zero is never missing
    alone = solve(H, f, A, np.where(near[:, None], short, -1e6), np.full(P, 10.0), u, max_move=rate, **LIMITS)
    assert np.all(found.converged & alone.converged)
    np.testing.assert_allclose(found.moves, alone.moves, rtol=0.0, atol=1e-9)


def test_a_cohort_is_its_people():
    H, f, A, short, u, rate, w = programs(2, 200, 5)
    together = solve(H, f, A, short, w, u, max_move=rate, **LIMITS)
    shared = solve(H[..., 0], f, A[..., 0], short, w, u, max_move=16.7, **LIMITS)
    for i in range(4):
        alone = solve(H[..., i], f[:, i], A[..., i], short[:, i], w, u[i], max_move=rate[i], **LIMITS)
        assert alone.converged
        np.testing.assert_allclose(together.moves[:, i], alone.moves, rtol=0.0, atol=1e-9)
        alone = solve(H[..., 0], f[:, i], A[..., 0], short[:, i], w, u[i], max_move=16.7, **LIMITS)
        np.testing.assert_allclose(shared.moves[:, i], alone.moves, rtol=0.0, atol=1e-9)


def test_too_few_rounds_are_told_and_have_still_gained(monkeypatch):
    H, f, A, short, u, rate, w = programs(2, 200, 6)
    enough = solve(H, f, A, short, w, u, max_move=rate, **LIMITS)
    monkeypatch.setattr(soft_floor, "ROUNDS", 1)
    few = minimise_moves_above_floor(H, f, A, short, w, u, max_move=rate, **LIMITS)
    np.testing.assert_array_equal(few.converged, enough.iterations <= 1)
    late = np.flatnonzero(~np.asarray(few.converged))
    assert late.size > 50
    plain = minimise_moves(H, f, u, max_move=rate, **LIMITS)
    for i in late:
        value = functools.partial(objective, H=H[..., i], f=f[:, i], A=A[..., i], short=short[:, i], w=w)
        assert_allowed(np.asarray(few.moves[:, i]), u[i], rate[i])
        assert value(np.asarray(few.moves[:, i])) <= value(np.asarray(plain.moves[:, i]))
        assert value(np.asarray(enough.moves[:, i])) <= value(np.asarray(few.moves[:, i])) * (1 + 1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_no_program_gives_allowed_moves_and_says_so(bad):
    H, f, A, short, u, rate, w = (part[..., 0] if np.ndim(part) else part for part in programs(2, 1, 7))
    given = [H, f, A, short]
    for k in range(4):
        one = [part.copy() for part in given]
        one[k].flat[-1] = bad
        found = solve(*one, w, u, max_move=rate, **LIMITS)
        assert not found.converged
        assert_allowed(np.asarray(found.moves), u, rate)


@pytest.mark.parametrize(("rows", "columns", "wanted"), [(4, 2, 5), (5, 3, 5)])
def test_shapes_that_do_not_fit_are_refused(rows, columns, wanted):
    with pytest.raises(ValueError, match="the response must be"):
        minimise_moves_above_floor(
            jnp.eye(2), jnp.zeros(2), jnp.zeros((rows, columns)), jnp.zeros(wanted), 1.0, 0.0, max_move=1.0, **LIMITS
        )
