"""Truth for small quadratic programs: every set of active constraints is tried."""

import itertools

import numpy as np
import pytest


def limits_as_rows(m, u_prev, max_move, u_min, u_max):
    eye, sums = np.eye(m), np.tril(np.ones((m, m)))
    levels = [np.full(2 * m, max_move), np.full(m, u_max - u_prev), np.full(m, u_prev - u_min)]
    return np.concatenate([eye, -eye, sums, -sums]), np.concatenate(levels)


def enumerate_active_sets(H, f, G, h):
    m, scale = len(f), np.sqrt(np.diag(H))
    hessian, gradient, rows = H / np.outer(scale, scale), f / scale, G / scale
    best, least = None, np.inf
    for k in range(m + 1):
        sets = list(itertools.combinations(range(len(h)), k))
        active = np.array(sets, dtype=int).reshape(len(sets), k)
        if k:
            active = active[np.linalg.matrix_rank(rows[active]) == k]
        kkt = np.zeros((len(active), m + k, m + k))
        kkt[:, :m, :m] = hessian
        kkt[:, m:, :m] = rows[active]
        kkt[:, :m, m:] = np.swapaxes(rows[active], 1, 2)
        right = np.concatenate([np.broadcast_to(-gradient, (len(active), m)), h[active]], axis=1)
        x = np.linalg.solve(kkt, right[..., None])[:, :m, 0] / scale
        x = x[np.all(x @ G.T - h <= 1e-11 * (1.0 + np.abs(h)), axis=1)]
        objective = 0.5 * np.einsum("ni,ij,nj->n", x, H, x) + x @ f
        if len(x) and objective.min() < least:
            best, least = x[objective.argmin()], objective.min()
    return best


@pytest.fixture
def exact_moves():
    def solve(H, f, u_prev, max_move, u_min, u_max):
        return enumerate_active_sets(H, f, *limits_as_rows(len(f), u_prev, max_move, u_min, u_max))

    return solve
