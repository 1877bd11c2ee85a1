"""One sample of the closed loop: read, decide, deliver, and go on to the next.

Whether one person is followed or a million, in real time or not, it is these two functions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.control.protocol import Controller, Decision, Observation, Status
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl, seen_mg_dl
from glucoloop.pumps import Delivery, Pump
from glucoloop.sensors import Reading, Sensor
from glucoloop.sensors.protocol import site_of
from glucoloop.simulation.plant import Plant

# Far from the numbers of samples, by which readings get their keys, so that the pump's chance is not the sensor's.
_PUMP: Final = 0x50554D50


@pytree
class Loop:
    """What makes a loop, and where it is to hold glucose."""

    plant: Plant
    controller: Controller
    sensor: Sensor
    pump: Pump
    setpoint_mg_dl: jax.Array


@pytree
class LoopState:
    """What is handed from sample to sample."""

    x: jax.Array
    """State of the patient."""
    reported_mU_min: jax.Array
    """Rate that the pump says it delivered."""
    in_sensor: Any
    in_controller: Any
    in_pump: Any


@pytree
class Sampled:
    """What happened at a sample and until the next."""

    x: jax.Array
    """State of the patient when it was taken."""
    glucose_mg_dl: jax.Array
    """The patient's own then, free of noise."""
    reading: Reading
    decision: Decision
    delivery: Delivery
    inside_mg_dl: jax.Array
    """(points, ...) glucose on the fine grid from there to the next sample, its end included."""
    lowest_valid_mg_dl: jax.Array
    """Glucose below which the patient's model says no more than that it is very low."""


def look(
    loop: Loop, state: LoopState, announced_g: jax.Array, reading_key: jax.Array, index: jax.Array
) -> tuple[Any, Reading, Observation]:
    """State of the sensor after it read at the sample with a number, its reading, and what the controller sees."""
    seen = _seen(loop, state.x)
    in_sensor, reading = loop.sensor.read(state.in_sensor, seen, jax.random.fold_in(reading_key, index))
    return in_sensor, reading, _observe(loop, reading, state.reported_mU_min, announced_g)


def _observe(loop: Loop, reading: Reading, reported: jax.Array, announced_g: jax.Array) -> Observation:
    return Observation(
        glucose_mg_dl=reading.glucose_mg_dl,
        valid=reading.valid,
        setpoint_mg_dl=loop.setpoint_mg_dl,
        delivered_mU_min=reported,
        announced_carbs_g=jnp.broadcast_to(announced_g, reading.glucose_mg_dl.shape),
    )


def _seen(loop: Loop, x: jax.Array) -> jax.Array:
    """Glucose where the sensor sits."""
    return seen_mg_dl(loop.plant.patient, x, site_of(loop.sensor))


def _for_pump(reading_key: jax.Array) -> jax.Array:
    key: jax.Array = jax.random.fold_in(reading_key, _PUMP)
    return key


def begin(
    loop: Loop, x: jax.Array, insulin_mU_min: jax.Array, announced_g: jax.Array, key: jax.Array
) -> tuple[LoopState, jax.Array]:
    """The loop before its first sample, with the patient in the state x under an infusion, and the key for `sample`."""
    sensor_key, reading_key = jax.random.split(key)
    seen = _seen(loop, x)
    in_sensor = loop.sensor.init(seen, sensor_key)
    # The controller wakes at what the first sample will show it.
    _, first = loop.sensor.read(in_sensor, seen, jax.random.fold_in(reading_key, 0))
    state = LoopState(
        x=x,
        reported_mU_min=insulin_mU_min,
        in_sensor=in_sensor,
        in_controller=loop.controller.init(_observe(loop, first, insulin_mU_min, announced_g)),
        in_pump=loop.pump.init(insulin_mU_min, _for_pump(reading_key)),
    )
    return state, reading_key


def sample(
    loop: Loop, state: LoopState, exogenous: Any, announced_g: jax.Array, reading_key: jax.Array, index: jax.Array
) -> tuple[LoopState, Sampled]:
    """The sample with a number: what the integrator needs from outside and what is announced are its own.

    The parts are compiled apart from one another. Across the borders XLA would round otherwise here than in a program
    in which the controller runs by itself, and stepping in real time would no longer be the simulation to the bit.
    """
    apart: Callable[[Any], Any] = jax.lax.optimization_barrier
    glucose = loop.plant.patient.glucose_mg_dl(state.x)
    in_sensor, reading, observation = apart(look(loop, state, announced_g, reading_key, index))
    in_controller, decision = apart(loop.controller.step(state.in_controller, observation))
    finite = jnp.isfinite(decision.insulin_mU_min)
    decision = dataclasses.replace(decision, status=jnp.where(finite, decision.status, Status.NO_FINITE_DOSE))
    pump_key = jax.random.fold_in(_for_pump(reading_key), index)
    # The least that any pump can be asked for, in place of what is no number.
    command = jnp.where(finite, decision.insulin_mU_min, 0.0)
    in_pump, delivery = apart(loop.pump.deliver(state.in_pump, command, pump_key))
    x, inside = apart(loop.plant.advance(state.x, delivery.insulin_mU_min, exogenous))
    happened = Sampled(
        x=state.x,
        glucose_mg_dl=glucose,
        reading=reading,
        decision=decision,
        delivery=delivery,
        inside_mg_dl=inside,
        lowest_valid_mg_dl=jnp.broadcast_to(lowest_valid_glucose_mg_dl(loop.plant.patient), glucose.shape),
    )
    return (
        LoopState(
            x=x,
            reported_mU_min=delivery.reported_mU_min,
            in_sensor=in_sensor,
            in_controller=in_controller,
            in_pump=in_pump,
        ),
        happened,
    )
