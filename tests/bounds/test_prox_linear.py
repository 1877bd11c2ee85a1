"""The minimiser alone, on problems with known answers."""

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from glucoloop.bounds import prox_linear
from glucoloop.bounds.prox_linear import Limits, Measure, minimise


def limits(n, *, low=-10.0, high=10.0, most=100.0):
    D = np.eye(n) - np.eye(n, k=-1)
    return Limits(low=low, high=high, most=most, D=D, d=np.zeros(n), free=np.ones(n, bool))


def test_best_line_through_a_parabola():
    # Chebyshev: x^2 is within 1/8 of x - 1/8 on [0, 1], and of no other line.
    x = np.linspace(0.0, 1.0, 101)
    J = np.stack([np.ones_like(x), x], axis=1)
    found = minimise(
        lambda v: J @ v - x**2,
        lambda v: J,
        Measure(cost=(1.0, 1.0), joint=True),
        limits(2),
        np.zeros(2),
        tolerance=1e-10,
    )
    assert found.value == pytest.approx(0.125, abs=1e-8)
    np.testing.assert_allclose(found.v, [-0.125, 1.0], atol=1e-6)
    assert found.optimality < 1e-8


def test_nonlinear_fit_with_kinks_agrees_with_scipy():
    # The best rational approximation a / (1 + b x) of exp(-x), by its epigraph form.
    x = np.linspace(0.0, 2.0, 101)

    def error(v):
        return v[0] / (1.0 + v[1] * x) - np.exp(-x)

    def slope(v):
        bottom = 1.0 + v[1] * x
        return np.stack([1.0 / bottom, -v[0] * x / bottom**2], axis=1)

    found = minimise(
        error, slope, Measure(cost=(1.0, 1.0), joint=True), limits(2), np.array([0.5, 0.5]), tolerance=1e-9
    )
    sides = [{"type": "ineq", "fun": lambda z, side=side: z[2] + side * error(z)} for side in (-1.0, 1.0)]
    least = minimize(lambda z: z[2], [0.5, 0.5, 1.0], constraints=sides, options={"ftol": 1e-12}).fun
    assert found.value == pytest.approx(least, abs=1e-6)


def test_weighted_squares_within_limits_agree_with_scipy():
    rng = np.random.default_rng(0)
    J, b, weight = rng.normal(size=(101, 2)), rng.normal(size=101) + 0.5, rng.uniform(0.5, 2.0, 101)
    within = limits(2, low=-0.3, high=0.4, most=0.02)
    measure = Measure(weight=weight, below=3.0)
    found = minimise(lambda v: J @ v - b, lambda v: J, measure, within, np.zeros(2), tolerance=1e-12)

    def value(v):
        g = J @ v - b
        return 0.5 * float(weight @ np.where(g < 0.0, 3.0 * g**2, g**2))

    near = [{"type": "ineq", "fun": lambda v, side=side: 0.02 - side * (within.D @ v)} for side in (-1.0, 1.0)]
    least = minimize(value, np.zeros(2), bounds=[(-0.3, 0.4)] * 2, constraints=near, options={"ftol": 1e-14})
    assert found.value == pytest.approx(least.fun, rel=1e-6)


def test_what_is_not_free_stays():
    J = np.eye(2)[np.arange(101) % 2]
    held = limits(2)
    held = Limits(low=-10.0, high=10.0, most=100.0, D=held.D, d=held.d, free=np.array([False, True]))
    measure = Measure(cost=(1.0, 1.0), joint=True)
    start = np.array([0.3, 0.0])
    found = minimise(lambda v: J @ v - 1.0, lambda v: J, measure, held, start, tolerance=1e-9)
    assert found.v[0] == 0.3
    assert found.value == pytest.approx(0.7)


def test_large_program_with_some_of_its_rows_agrees_with_all_of_them(monkeypatch):
    x = np.linspace(0.0, 1.0, 101)
    J, target = np.vander(x, 2), np.sin(9.0 * x)
    measure = Measure(cost=(1.0, 1.0), joint=True)
    A, bound = np.block([[J, -np.ones((101, 1))], [-J, -np.ones((101, 1))]]), [(-10.0, 10.0)] * 2 + [(0.0, None)]
    least = linprog([0.0, 0.0, 1.0], A, np.concatenate([target, -target]), bounds=bound).fun
    monkeypatch.setattr(prox_linear, "_ROWS_TOGETHER", 212)  # as many as all of them, so that it is compiled once
    for many in (1000, 100):
        monkeypatch.setattr(prox_linear, "_MANY_ROWS", many)
        found = minimise(lambda v: J @ v - target, lambda v: J, measure, limits(2), np.zeros(2), tolerance=1e-9)
        assert found.value == pytest.approx(least, abs=1e-6)
