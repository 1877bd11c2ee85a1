"""A patient who keeps accounts."""

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.patients import Patient

DECILITRES = np.array([3.5, 4.5, 13.8, 11.2, 25.1, 6.6, 10.4, 67.4])
LITRES = np.array([0.26, 0.99, 0.94, 1.14, 0.51, 0.74, 6.74])


@pytree
class Ledger:
    """A patient who books what enters and leaves him, in four more states: glucose in and out, insulin in and out."""

    person: Patient
    lower_mg_dl: float = 0.0
    """By how much the references of glucose are below the published ones."""

    @property
    def basal_insulin_mU_min(self):
        return self.person.basal_insulin_mU_min

    @property
    def setpoint_mg_dl(self):
        return self.person.setpoint_mg_dl

    def steady_state(self, insulin_mU_min):
        return jnp.concatenate([self.person.steady_state(insulin_mU_min), jnp.zeros(4)])

    def insulin_for(self, glucose_mg_dl):
        return self.person.insulin_for(glucose_mg_dl)

    def glucose_mg_dl(self, x):
        return x[2]

    def derivative(self, t_min, x, inputs):
        _, _, _, _, G_L, G_K, _, G_PI, _, I_H, I_G, _, _, _, I_PI, A_IHGP, A_IHGU, N, A_NHGP = x[:19]
        made = 155 * A_IHGP * (2.7 * jnp.tanh(0.388 * N) - A_NHGP)
        made = made * (1.425 - 1.406 * jnp.tanh(0.6199 * (G_L / (101 - self.lower_mg_dl) - 0.4969)))
        liver = 20 * A_IHGU * (5.6648 + 5.6589 * jnp.tanh(2.4375 * (G_L / (101 - self.lower_mg_dl) - 1.48)))
        muscle = (
            35 * (G_PI / (86.81 - self.lower_mg_dl)) * (7.035 + 6.51623 * jnp.tanh(0.33827 * (I_PI / 5.304 - 5.82113)))
        )
        urine = jnp.where(G_K < 460, 71 + 71 * jnp.tanh(0.011 * (G_K - 460)), -330 + 0.872 * G_K)
        cleared = 0.40 * (0.18 * I_H + 0.72 * I_G) + 0.30 * 0.72 * I_H + I_PI / (0.85 / (0.15 * 1.05) - 20 / 6.74)
        booked = [
            inputs.meal_mg_min + made,
            liver + muscle + urine + 70.0 + 10.0 + 20.0,  # and brain, red cells, gut
            inputs.insulin_mU_min,
            cleared,
        ]
        return jnp.concatenate([self.person.derivative(t_min, x[:19], inputs), jnp.stack(booked)])


@pytest.fixture(scope="session")
def ledger():
    """Make a patient keep accounts."""
    return lambda person, lower_mg_dl=0.0: Ledger(person=person, lower_mg_dl=lower_mg_dl)


@pytest.fixture(scope="session")
def conserved():
    """Check the accounts of a trace's states, and hand back what the body holds of glucose and insulin."""

    def check(states):
        held = []
        for content, into, out in (
            (states[:, :8] @ DECILITRES, states[:, 19], states[:, 20]),
            (states[:, 8:15] @ LITRES, states[:, 21], states[:, 22]),
        ):
            np.testing.assert_allclose(content - content[0], into - out, rtol=0.0, atol=1e-10 * into[-1])
            held.append(content)
        return held

    return check
