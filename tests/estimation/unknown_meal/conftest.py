"""A person small enough to be followed by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static

A = ((0.92, -0.6), (0.0, 0.8))
B = (0.0, 0.25)
G = (0.04, 0.0)


@pytree
class TwoStates:
    """Glucose and an insulin effect, linear; of what appears only the mean over the sample matters."""

    state: jax.Array
    insulin_mU_min: jax.Array
    sample_time_min: float = static(default=5.0)

    def advance_fed(self, x, insulin_mU_min, appearance_mg_min):
        away = jnp.asarray(A) @ (x - self.state) + jnp.asarray(B) * (insulin_mU_min - self.insulin_mU_min)
        return self.state + away + jnp.asarray(G) * appearance_mg_min[0]

    def advance(self, x, insulin_mU_min):
        return self.advance_fed(x, insulin_mU_min, jnp.zeros(3))

    def derivative(self, x, insulin_mU_min):
        return (self.advance(x, insulin_mU_min) - x) / self.sample_time_min

    def glucose_mg_dl(self, x):
        return x[0]


@pytest.fixture(scope="session")
def two_states():
    return TwoStates(state=jnp.asarray([80.0, 3.0]), insulin_mU_min=jnp.asarray(20.0))


@pytest.fixture(scope="session")
def linear():
    """Its matrices."""
    return A, B, G


def appears(eaten, sample):
    """Mean appearance over a sample by Simpson's rule; each sample that is served empties as a trapezoid of 35 min."""

    def gut(t):  # content over 60 min, of ramps of 12 mg/min^2
        since = [
            (t - 5.0 * k - lag, sign * share)
            for k, share in enumerate(eaten)
            if share
            for lag, sign in zip((0.0, 5.0, 30.0, 35.0), (1.0, -1.0, -1.0, 1.0), strict=True)
        ]
        return sum(12.0 * sign * (z - 60.0 * (1.0 - np.exp(-z / 60.0))) for z, sign in since if z > 0)

    return (gut(5.0 * sample) + 4.0 * gut(5.0 * (sample + 0.5)) + gut(5.0 * (sample + 1))) / 6.0


@pytest.fixture(scope="session", name="appears")
def _appears():
    return appears


@pytest.fixture(scope="session")
def record_of():
    """Readings after each sample, free of noise, of shares of samples in which a meal is served, and of insulin."""

    def readings(eaten, insulin):
        x, told = np.zeros(2), []
        for k in range(len(eaten)):
            x = np.asarray(A) @ x + np.asarray(B) * (insulin[k] - 20.0) + np.asarray(G) * appears(eaten[: k + 1], k)
            told.append(80.0 + x[0])
        return np.array(told)

    return readings
