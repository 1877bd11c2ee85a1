"""Controllers inside a guard, and what a test of a guard shows it."""

import math

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
    unchanged_min=1000.0,
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


def damaged(state, word, value):
    """A state with one word replaced, by a factor above 1e3; none for a word below 0."""
    leaves, structure = jax.tree.flatten(state)
    first, new = 0, []
    for leaf in map(jnp.asarray, leaves):
        number = first + jnp.arange(leaf.size).reshape(leaf.shape)
        new.append(jnp.where(word == number, value.astype(leaf.dtype), leaf))
        first += leaf.size
    return jax.tree.unflatten(structure, new)


def largest_hour(rates, boluses, every, basal=BASAL):
    """Largest insulin in any window of 60 min [basal hours]: windows that begin or end anywhere, by brute force.

    The insulin up to a time is linear between boluses, so the largest window has an end at the border of a sample.
    """
    before = math.ceil(60.0 / every) + 2
    rates = np.r_[np.full(before, basal), np.maximum(rates, basal)]
    boluses = np.r_[np.zeros(before), boluses]
    t = every * np.arange(rates.size + 1)
    total = np.r_[0.0, np.cumsum(every * rates)]
    at_once = np.r_[0.0, np.cumsum(boluses)]
    begin = np.r_[t, t - 60.0]
    begin = begin[(begin >= 0.0) & (begin + 60.0 <= t[-1] + 1e-9)]
    flowed = np.interp(begin + 60.0, t, total) - np.interp(begin, t, total)
    hair = 1e-7
    last = np.searchsorted(t[:-1], begin + 60.0 + hair, side="right")
    first = np.searchsorted(t[:-1], begin - hair, side="left")
    return float(np.max(flowed + at_once[last] - at_once[first])) / (60.0 * basal)


def largest_on_board(rates, boluses, every, tau_min, basal=BASAL):
    """Largest insulin on board [basal rates], each bolus given at once."""
    left, on_board, largest = math.exp(-every / tau_min), 0.0, 0.0
    for rate, bolus in zip(rates, boluses, strict=True):
        on_board += bolus / (tau_min * basal)
        largest = max(largest, on_board)
        on_board = max(left * on_board + (1.0 - left) * (rate / basal - 1.0), 0.0)
        largest = max(largest, on_board)
    return largest
