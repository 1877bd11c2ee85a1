"""Guarded controllers under faults in any order: doses keep their limits, states stay finite, statuses are known."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from designed import Designed
from glucoloop.control import Observation, Status, guarded
from glucoloop.control.catalogue import CONTROLLERS as ENTRIES
from glucoloop.control.protocol import gives_boluses
from glucoloop.identification import FirstOrderModel
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel

LEAST, MOST, CHANGE = 0.0, 66.9, 16.7
MODEL = StepResponseModel.from_impulse_response(-0.19 * np.exp(-np.arange(1, 31) / 18.0), 5.0)
LINEAR = LinearModel(
    Phi=jnp.array([[0.94, 0.0], [0.0, 0.8]]),
    Gamma=jnp.array([-0.2, 0.1]),
    C=jnp.array([1.0, -0.5]),
    state=jnp.array([81.0, 0.0]),
    insulin_mU_min=jnp.array(22.3),
    glucose_mg_dl=jnp.array(81.0),
    sample_time_min=5.0,
)


class LinearDesign(Designed):
    def process_noise(self, glucose, other, glucagon):
        del other, glucagon
        return np.array([glucose, 0.1 * glucose])


DESIGN = LinearDesign(
    linear=LINEAR,
    identified=MODEL,
    first=FirstOrderModel(gain=-3.45, tau_min=89.1, delay_min=5.0, residual_rms_mg_dl=0.0),
    basal_insulin_mU_min=22.3,
    setpoint_mg_dl=81.1,
)
# NLQDMC/SE needs the equations of a patient; with a controller that is slow, as many steps would take minutes
CONTROLLERS = [name for name, entry in ENTRIES.items() if not entry.slow and name != "nlqdmc-se"]

ANY = st.floats(allow_nan=True, allow_infinity=True)
NONSENSE = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 2000.0, 1e300, -1.7e308])


def observation(guard, numbers, valid):
    glucose, setpoint, delivered, carbs = numbers
    return Observation(
        glucose_mg_dl=glucose,
        valid=valid,
        setpoint_mg_dl=setpoint,
        delivered_mU_min=delivered,
        announced_carbs_g=carbs,
        delivered_bolus_mU=jnp.zeros(()) if gives_boluses(guard) else None,
    )


@jax.jit
def step(guard, state, numbers, valid):
    return guard.step(state, observation(guard, numbers, valid))


@functools.lru_cache
def waking(name):
    guard = guarded(ENTRIES[name]().designed(DESIGN))
    return guard, jax.jit(lambda numbers, valid: guard.init(observation(guard, numbers, valid)))


class Faults(RuleBasedStateMachine):
    """A person as a wandering number, and whatever can be told of him."""

    name = ""

    @initialize(
        glucose=st.one_of(st.floats(40.0, 400.0), NONSENSE), delivered=st.one_of(st.floats(0.0, 66.9), NONSENSE)
    )
    def wake(self, glucose, delivered):
        self.guard, wake = waking(self.name)
        self.glucose, self.setpoint = 100.0, 81.0
        self.state = wake(np.array([glucose, self.setpoint, delivered, 0.0]), True)
        self.believed = float(self.state.command_mU_min)  # what the guard takes to have been delivered last
        self.dose = self.believed
        self.status = 0
        self.silent = 0

    def tell(self, reading, *, valid=True, delivered=None, setpoint=None, carbs=0.0):
        told = self.dose if delivered is None else delivered
        self.believed = told if 0.0 <= told <= 2.0 * MOST else self.dose
        numbers = np.array([reading, self.setpoint if setpoint is None else setpoint, told, carbs])
        self.state, decision = step(self.guard, self.state, numbers, valid)
        self.dose, self.status = float(decision.insulin_mU_min), int(decision.status)

    @rule(change=st.floats(-12.0, 12.0))
    def an_ordinary_reading(self, change):
        self.glucose = min(max(self.glucose + change, 40.0), 400.0)
        self.tell(self.glucose)

    @rule(reading=st.one_of(NONSENSE, ANY))
    def a_reading_that_may_be_anything(self, reading):
        self.tell(reading)

    @rule(samples=st.integers(1, 48), reading=st.sampled_from([np.nan, 100.0]))
    def a_gap(self, samples, reading):
        for _ in range(samples):
            self.tell(reading, valid=False)
        assert self.status not in (Status.OK, Status.READING_REJECTED)
        if samples > 18:
            assert self.status in (Status.FALLBACK_REDUCED, Status.SUSPENDED)

    @rule(size=st.floats(-300.0, 300.0))
    def a_spike(self, size):
        self.tell(self.glucose + size)

    @rule(samples=st.integers(1, 12))
    def a_reading_that_is_stuck(self, samples):
        for _ in range(samples):
            self.tell(self.glucose)

    @rule(word=st.one_of(NONSENSE, ANY))
    def a_pump_that_says_anything(self, word):
        self.tell(self.glucose, delivered=word)

    @rule(samples=st.integers(1, 6))
    def an_occlusion_that_is_noticed(self, samples):
        for _ in range(samples):
            self.tell(self.glucose, delivered=0.0)

    @rule(setpoint=st.one_of(NONSENSE, ANY, st.floats(60.0, 150.0)), carbs=st.one_of(NONSENSE, ANY))
    def a_setpoint_and_a_meal_that_may_be_anything(self, setpoint, carbs):
        self.tell(self.glucose, setpoint=setpoint, carbs=carbs)

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def the_dose_keeps_its_limits(self):
        assert LEAST <= self.dose <= MOST
        nearest = min(max(self.believed, LEAST), MOST)
        assert abs(self.dose - self.believed) <= CHANGE + 1e-9 or self.dose == nearest

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def every_number_of_the_state_is_finite(self):
        for leaf in jax.tree.leaves(self.state):
            assert np.all(np.isfinite(leaf))

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def the_status_has_a_sentence(self):
        assert Status(self.status).text.endswith(".")


@pytest.mark.long
@pytest.mark.parametrize("name", CONTROLLERS)
def test_faults_in_any_order(name):
    machine = type("FaultsOf", (Faults,), {"name": name})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=15, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
        ),
    )
