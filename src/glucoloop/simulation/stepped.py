"""The closed loop with its decisions from outside: of a controller on a chip, or in another process."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.meals.scenario import Scenario
from glucoloop.patients.protocol import Patient
from glucoloop.pumps import Pump
from glucoloop.sensors import Sensor
from glucoloop.simulation.closed_loop import Trace, on_the_grid, sample_grid, trace_of
from glucoloop.simulation.loop import Sampled
from glucoloop.simulation.plant import SteppingIntegrator
from glucoloop.simulation.stepper import Stepper

Decide = Callable[[int, Observation], Decision]
"""Function of the number of a sample and its observation."""


def scenario_stepper(
    patient: Patient,
    sensor: Sensor,
    pump: Pump,
    scenario: Scenario,
    *,
    sample_time_min: float,
    key: jax.Array | int,
    integrator: SteppingIntegrator | None = None,
) -> Stepper:
    """The patient of a scenario, to be stepped from outside."""
    return Stepper(
        patient,
        sensor,
        pump,
        sample_time_min=sample_time_min,
        setpoint_mg_dl=scenario.setpoint_mg_dl,
        initial_glucose_mg_dl=scenario.initial_glucose_mg_dl,
        allow_unusual=scenario.allow_unusual,
        key=key,
        integrator=integrator,
        meal_model=scenario.meal_model,
        start_min=scenario.start_min,
    )


def simulate_stepped(stepper: Stepper, scenario: Scenario, decide: Decide, *, gives_boluses: bool = False) -> Trace:
    """Run a scenario with decisions from outside; the trace is that of `simulate` with the same decisions.

    The stepper is at the start of the scenario (see `scenario_stepper`); the numbers of a decision need not be finite,
    and its bolus counts if `gives_boluses` says so.
    """
    grid = sample_grid(scenario.horizon_min, stepper.sample_time_min)
    on_grid = on_the_grid(scenario, grid)
    announced = np.asarray(on_grid.announced_g).tolist()
    at = [int(meal.t_min / grid.sample_time_min) for meal in scenario.meals]
    happened: list[Sampled] = []
    for sample in range(grid.samples):
        decision = decide(sample, stepper.observation(announced[sample]))
        for meal, index in zip(scenario.meals, at, strict=True):
            if index == sample:
                stepper.eat(meal.carbs_g, max(0.0, meal.t_min - stepper.t_min), meal.eating_min)
        bolus = None if decision.bolus_mU is None or not gives_boluses else float(decision.bolus_mU)
        stepper.step(float(decision.insulin_mU_min), bolus_mU=bolus)
        assert stepper.last is not None
        happened.append(_with_status(stepper.last, decision))
    together: Any = jax.tree.map(lambda *each: jnp.asarray(np.stack(each)), *happened)
    trace = trace_of(stepper.patient, stepper.start, on_grid, together, stepper.state)
    if not gives_boluses:
        trace = dataclasses.replace(trace, command_bolus_mU=None, bolus_mU=None, reported_bolus_mU=None)
    return (
        dataclasses.replace(trace, announced_carbs_g=jnp.asarray(on_grid.announced_g)) if scenario.announced else trace
    )


def _with_status(happened: Sampled, decision: Decision) -> Sampled:
    finite = happened.decision.status != Status.NO_FINITE_DOSE
    told = jnp.where(finite, decision.status, happened.decision.status)
    return dataclasses.replace(happened, decision=dataclasses.replace(happened.decision, status=told))
