"""The error of readings: its filter against the dense covariance, and what is learned of it."""

import numpy as np
import pytest

from glucoloop.twins import Noise

T_MIN = np.cumsum([0.0, 5.0, 5.0, 5.0, 90.0, 5.0, 10.0, 5.0])
"""Times of readings with a gap."""


def covariance_of(noise, t_min):
    slow = noise.slow_sd_mg_dl**2 * np.exp(-np.abs(t_min[:, None] - t_min) / noise.time_constant_min)
    return slow + noise.own_sd_mg_dl**2 * np.eye(t_min.size)


def test_what_is_made_independent_has_the_form_of_the_dense_covariance():
    noise = Noise(8.0, 45.0, 2.0)
    columns = np.random.default_rng(1).standard_normal((T_MIN.size, 3))
    white = noise.independent(T_MIN, columns)
    assert white.T @ white == pytest.approx(columns.T @ np.linalg.solve(covariance_of(noise, T_MIN), columns))


def test_drawn_errors_have_that_covariance():
    noise = Noise(8.0, 45.0, 2.0)
    drawn = noise.drawn(T_MIN, 20_000, np.random.default_rng(2))
    assert np.cov(drawn.T) == pytest.approx(covariance_of(noise, T_MIN), abs=2.5)


def test_the_noise_is_learned_though_parameters_take_part_of_it():
    rng, t_min, true = np.random.default_rng(3), 5.0 * np.arange(1500.0), Noise(9.0, 60.0, 3.0)
    jacobian = np.column_stack([np.sin(t_min / period) * 10.0 for period in range(30, 230, 10)])
    residual = true.drawn(t_min, 1, rng)[0] + jacobian @ rng.standard_normal(jacobian.shape[1])
    learned = Noise().learned(t_min, residual, jacobian)
    assert learned.slow_sd_mg_dl == pytest.approx(9.0, rel=0.2)
    assert learned.time_constant_min == pytest.approx(60.0, rel=0.4)
    assert learned.own_sd_mg_dl == pytest.approx(3.0, rel=0.15)
