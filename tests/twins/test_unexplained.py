"""The smoother of what is unexplained: least squares with gaps, and a start far from the first reading."""

import numpy as np
import pytest

from glucoloop.twins.extended import Linearised
from glucoloop.twins.unexplained import _gains, _response, _smoothed

SAMPLES, VARIANCE = 160, 0.3


def linearised(seed):
    """Stable equations of four states with three disturbances."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    G = rng.standard_normal((4, 3))
    nothing = dict.fromkeys(Linearised._fields)
    return Linearised(
        **{
            **nothing,
            "transition": A,
            "disturbance": G,
            "noise": G @ G.T,
            "readout": rng.standard_normal(4),
            "reading_variance": VARIANCE,
        }
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_smoothed_disturbances_are_those_of_least_squares(seed):
    linear = linearised(seed)
    rng = np.random.default_rng(100 + seed)
    signal = 40.0 + np.cumsum(rng.standard_normal(SAMPLES))  # far from 0 at its first sample
    signal[30:70] = np.nan
    signal[rng.random(SAMPLES) < 0.1] = np.nan
    there = np.isfinite(signal)
    columns = []
    for at in range(3 * SAMPLES):
        unit = np.zeros(3 * SAMPLES)
        unit[at] = 1.0
        columns.append(_response(linear, unit.reshape(SAMPLES, 3))[there])
    H = np.stack(columns, axis=1)
    whole = np.concatenate([H / np.sqrt(VARIANCE), np.eye(3 * SAMPLES)])
    wanted = np.concatenate([signal[there] / np.sqrt(VARIANCE), np.zeros(3 * SAMPLES)])
    expected, *_ = np.linalg.lstsq(whole, wanted, rcond=None)
    found = _smoothed(linear, _gains(linear, there), signal)
    np.testing.assert_allclose(found.ravel(), expected, rtol=1e-7, atol=1e-7)
