"""Controllers inside a guard, and what a test of a guard shows it."""

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static
from glucoloop.control import (
    Decision,
    GuardSettings,
    MPCTuning,
    Observation,
    design_linear_mpc,
)
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import DoseLimits

BASAL, SETPOINT, EVERY = 20.0, 81.0, 5.0
MODEL = StepResponseModel.from_impulse_response(-0.19 * np.exp(-np.arange(1, 61) / 18.0), EVERY)
MPC = design_linear_mpc(MODEL, MPCTuning(2, 12, 1.0, 1.0))
LIMITS = DoseLimits()
OPEN = GuardSettings(
    held_min=1000.0,
    error_mg_dl=0.0,
    always_basal=100.0,
    max_hour=100.0,
    max_on_board=100.0,
    low_mg_dl=0.0,
    ahead_min=0.0,
    fastest_mg_dl_min=1000.0,
)
"""A guard that lets everything pass that can be."""


@pytree
class Wants:
    """Asks for one rate, and remembers what it was shown."""

    rate: float
    sample_time_min: float = static(default=EVERY)

    def init(self, observation):
        return observation

    def step(self, state, observation):
        dose = jnp.full_like(observation.glucose_mg_dl, self.rate)
        return observation, Decision(insulin_mU_min=dose, status=jnp.zeros(dose.shape, int))


def observe(reading, delivered=BASAL, *, valid=True, setpoint=SETPOINT, carbs=0.0):
    return Observation(
        glucose_mg_dl=jnp.asarray(reading, float),
        valid=jnp.broadcast_to(jnp.asarray(valid), jnp.shape(reading)),
        setpoint_mg_dl=jnp.broadcast_to(jnp.asarray(setpoint, float), jnp.shape(reading)),
        delivered_mU_min=jnp.broadcast_to(jnp.asarray(delivered, float), jnp.shape(reading)),
        announced_carbs_g=jnp.broadcast_to(jnp.asarray(carbs, float), jnp.shape(reading)),
    )


@jax.jit
def step(controller, state, observation):
    return controller.step(state, observation)


def follow(controller, readings, *, start=BASAL, valid=None):
    """Doses, statuses and states over some readings, the pump doing as it is asked."""
    state, delivered = controller.init(observe(readings[0], start)), jnp.asarray(start)
    doses, statuses, states = [], [], []
    for k, reading in enumerate(readings):
        state, decision = step(controller, state, observe(reading, delivered, valid=valid is None or valid[k]))
        delivered = decision.insulin_mU_min
        doses.append(delivered)
        statuses.append(decision.status)
        states.append(state)
    return np.array(doses), np.array(statuses), states
