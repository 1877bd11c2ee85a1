"""One sample of the closed loop: read, decide, deliver, and advance to the next.

One person or many, in real time or not: all loops use these two functions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control.protocol import (
    Controller,
    Decision,
    DoseForecast,
    Observation,
    Status,
    draws,
    forecast_of,
    gives_boluses,
    gives_glucagon,
)
from glucoloop.meals.moments import points_of_sample
from glucoloop.meals.rescue import RescueCarbs
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl, seen_mg_dl
from glucoloop.pumps import Delivery, Pump
from glucoloop.pumps.protocol import deliver, glucagon_route
from glucoloop.sensors import Reading, Sensor
from glucoloop.sensors.protocol import site_of
from glucoloop.simulation.plant import Exogenous, Plant

# Far from the numbers of samples, by which readings get their keys, so that nobody's draws are another's.
_PUMP: Final = 0x50554D50
_CONTROLLER: Final = 0x434F4E54


@pytree
class Loop:
    """Parts of a loop, and its setpoint."""

    plant: Plant
    controller: Controller
    sensor: Sensor
    pump: Pump
    setpoint_mg_dl: jax.Array
    rescue: RescueCarbs | None = None
    """Carbohydrate that the person eats when glucose is low; None for none."""
    announced_in_min: jax.Array | None = None
    """Time to eating that an announcement tells; None where meals are announced when they begin."""
    forecasts: bool = static(default=False)
    """Whether the forecasts of the controller are kept, which takes its computing twice."""


@pytree
class LoopState:
    """State that is passed from sample to sample."""

    x: jax.Array
    """State of the patient."""
    reported_mU_min: jax.Array
    """Rate that the pump reports."""
    in_sensor: Any
    in_controller: Any
    in_pump: Any
    reported_bolus_mU: jax.Array | None = None
    """Bolus that the pump reports since the last sample; None under a controller that gives none."""
    in_rescue: Any = None
    rescue_g: jax.Array | None = None
    """Carbohydrate that was eaten against low glucose at the last sample; None where the controller is not told."""


@pytree
class Sampled:
    """Events of a sample, and of the time until the next."""

    x: jax.Array
    """State of the patient at the sample."""
    glucose_mg_dl: jax.Array
    """Glucose of the patient at the sample, free of noise."""
    reading: Reading
    decision: Decision
    delivery: Delivery
    infused_mU_min: jax.Array
    """All insulin that reaches the patient until the next sample, as a rate: the basal rate, and the bolus evenly."""
    inside_mg_dl: jax.Array
    """(points, ...) glucose on the fine grid from the sample to the next, its end included."""
    lowest_valid_mg_dl: jax.Array
    """Lower end of the valid range of the patient's model."""
    rescue_g: jax.Array | None = None
    """Carbohydrate that the person eats against low glucose; None where there is none."""
    basal_mU_min: jax.Array | None = None
    """Basal rate of the patient, for metrics; None within the loop."""
    carbs_g: jax.Array | None = None
    """Carbohydrate of meals that begin before the next sample, for metrics that need it; None within the loop."""
    forecast: DoseForecast | None = None
    """Forecast on which the decision rests, where forecasts are kept and the controller makes one."""


def look(
    loop: Loop,
    state: LoopState,
    announced_g: jax.Array,
    reading_key: jax.Array,
    index: jax.Array,
    time_of_day_min: jax.Array | None = None,
) -> tuple[Any, Reading, Observation]:
    """State of the sensor after it read at a sample, its reading, and the observation of the controller."""
    seen = _seen(loop, state.x)
    in_sensor, reading = loop.sensor.read(state.in_sensor, seen, jax.random.fold_in(reading_key, index))
    reported = state.reported_mU_min, state.reported_bolus_mU
    return in_sensor, reading, _observe(loop, reading, reported, announced_g, time_of_day_min, state.rescue_g)


def _observe(
    loop: Loop,
    reading: Reading,
    reported: tuple[jax.Array, jax.Array | None],
    announced_g: jax.Array,
    time_of_day_min: jax.Array | None,
    rescue_g: jax.Array | None,
) -> Observation:
    shape = reading.glucose_mg_dl.shape
    return Observation(
        glucose_mg_dl=reading.glucose_mg_dl,
        valid=reading.valid,
        setpoint_mg_dl=loop.setpoint_mg_dl,
        delivered_mU_min=reported[0],
        announced_carbs_g=jnp.broadcast_to(announced_g, shape),
        delivered_bolus_mU=reported[1],
        time_of_day_min=None if time_of_day_min is None else jnp.broadcast_to(time_of_day_min, shape),
        announced_in_min=None if loop.announced_in_min is None else jnp.broadcast_to(loop.announced_in_min, shape),
        rescue_carbs_g=rescue_g,
    )


def _seen(loop: Loop, x: jax.Array) -> jax.Array:
    """Glucose at the site of the sensor."""
    return seen_mg_dl(loop.plant.patient, x, site_of(loop.sensor))


def _for_pump(reading_key: jax.Array) -> jax.Array:
    key: jax.Array = jax.random.fold_in(reading_key, _PUMP)
    return key


def _with_key(loop: Loop, observation: Observation, reading_key: jax.Array, index: Any) -> Observation:
    """Observation with the key of a sample, where the controller draws random numbers."""
    if not draws(loop.controller):
        return observation
    return dataclasses.replace(observation, key=jax.random.fold_in(jax.random.fold_in(reading_key, _CONTROLLER), index))


def begin(
    loop: Loop,
    x: jax.Array,
    insulin_mU_min: jax.Array,
    announced_g: jax.Array,
    key: jax.Array,
    time_of_day_min: jax.Array | None = None,
) -> tuple[LoopState, jax.Array]:
    """Loop before its first sample, with the patient in the state x under an infusion, and the key for `sample`."""
    sensor_key, reading_key = jax.random.split(key)
    seen = _seen(loop, x)
    in_sensor = loop.sensor.init(seen, sensor_key)
    # The controller initialises at what the first sample will show it.
    _, first = loop.sensor.read(in_sensor, seen, jax.random.fold_in(reading_key, 0))
    no_bolus = jnp.zeros_like(insulin_mU_min) if gives_boluses(loop.controller) else None
    no_rescue = jnp.zeros_like(insulin_mU_min) if loop.rescue is not None and loop.rescue.told else None
    observation = _observe(loop, first, (insulin_mU_min, no_bolus), announced_g, time_of_day_min, no_rescue)
    state = LoopState(
        x=x,
        reported_mU_min=insulin_mU_min,
        in_sensor=in_sensor,
        in_controller=loop.controller.init(_with_key(loop, observation, reading_key, 0)),
        in_pump=loop.pump.init(insulin_mU_min, _for_pump(reading_key)),
        reported_bolus_mU=no_bolus,
        in_rescue=None if loop.rescue is None else loop.rescue.init(insulin_mU_min),
        rescue_g=no_rescue,
    )
    return state, reading_key


def sample(
    loop: Loop,
    state: LoopState,
    exogenous: Exogenous,
    announced_g: jax.Array,
    reading_key: jax.Array,
    index: jax.Array,
    time_of_day_min: jax.Array | None = None,
) -> tuple[LoopState, Sampled]:
    """Advance the loop by the sample with the given number, with its exogenous inputs and announced carbohydrate.

    A bolus reaches the patient evenly until the next sample, beside the basal rate. Pumps give about 1.5 U a minute: of
    5 U the mean insulin comes 1.7 min after the beginning, and in 5-min samples it is 2.5 min here. If all of it came
    at once, glucose of the patient of Hovorka et al. (2004) after a meal would differ by up to 1.5 mg/dl for each unit.

    The parts are compiled separately. Otherwise XLA would round differently here than in a program in which the
    controller runs by itself, and stepping in real time would not equal the simulation to the bit.
    """
    apart: Callable[[Any], Any] = jax.lax.optimization_barrier
    glucose = loop.plant.patient.glucose_mg_dl(state.x)
    # Native code names the part that holds an operation which it lacks.
    with jax.named_scope("sensor"):
        looked = look(loop, state, announced_g, reading_key, index, time_of_day_min)
    in_sensor, reading, observation = apart(looked)
    observation = _with_key(loop, observation, reading_key, index)
    with jax.named_scope("controller"):
        decided = loop.controller.step(state.in_controller, observation)
    in_controller, decision = apart(decided)
    # by itself, so that the decision is the same to the bit
    forecast = apart(forecast_of(loop.controller, state.in_controller, observation)) if loop.forecasts else None
    _check_declared(loop.controller, decision)
    finite = jnp.isfinite(decision.insulin_mU_min)
    for further in (decision.bolus_mU, decision.glucagon_ug):
        if further is not None:
            finite = finite & jnp.isfinite(further)
    decision = dataclasses.replace(decision, status=jnp.where(finite, decision.status, Status.NO_FINITE_DOSE))
    pump_key = jax.random.fold_in(_for_pump(reading_key), index)
    # The minimum that any pump can be asked for, in place of what is no number.
    command, bolus = jax.tree.map(
        lambda requested: jnp.where(finite, requested, 0.0), (decision.insulin_mU_min, decision.bolus_mU)
    )
    with jax.named_scope("pump"):
        given = deliver(loop.pump, state.in_pump, command, pump_key, bolus)
    in_pump, delivery = apart(given)
    infused = delivery.insulin_mU_min
    if delivery.bolus_mU is not None:
        infused = infused + delivery.bolus_mU / loop.controller.sample_time_min
    if decision.glucagon_ug is not None:
        with jax.named_scope("pump"):
            glucagon = glucagon_route(loop.pump).allowed(jnp.where(finite, decision.glucagon_ug, 0.0))
        delivery = dataclasses.replace(delivery, glucagon_ug=glucagon)
        exogenous = _with_glucagon(exogenous, glucagon, loop.controller.sample_time_min)
    in_rescue, rescue_g = None, None
    if loop.rescue is not None:
        with jax.named_scope("meals"):
            seen = _seen_by_person(loop.rescue, reading, glucose)
            ate = loop.rescue.eat(state.in_rescue, seen, _moments(exogenous), loop.controller.sample_time_min)
        in_rescue, rescue_g, moments = ate
        exogenous = dataclasses.replace(exogenous, moments=moments)
    with jax.named_scope("patient"):
        advanced = loop.plant.advance(state.x, infused, exogenous)
    x, inside = apart(advanced)
    happened = Sampled(
        x=state.x,
        glucose_mg_dl=glucose,
        reading=reading,
        decision=decision,
        delivery=delivery,
        infused_mU_min=infused,
        inside_mg_dl=inside,
        lowest_valid_mg_dl=jnp.broadcast_to(lowest_valid_glucose_mg_dl(loop.plant.patient), glucose.shape),
        rescue_g=rescue_g,
        forecast=forecast,
    )
    return (
        LoopState(
            x=x,
            reported_mU_min=delivery.reported_mU_min,
            in_sensor=in_sensor,
            in_controller=in_controller,
            in_pump=in_pump,
            reported_bolus_mU=delivery.reported_bolus_mU,
            in_rescue=in_rescue,
            rescue_g=None if state.rescue_g is None else rescue_g,
        ),
        happened,
    )


def _seen_by_person(rescue: RescueCarbs, reading: Reading, glucose_mg_dl: jax.Array) -> jax.Array:
    """Glucose by which a person eats: the reading, NaN where there is none, or true glucose."""
    return jnp.where(reading.valid, reading.glucose_mg_dl, jnp.nan) if rescue.by_reading else glucose_mg_dl


def _moments(exogenous: Exogenous) -> jax.Array:
    if exogenous.moments is None:
        raise ArgumentTypeError(
            "this integrator knows all meals before the run, and rescue carbohydrate depends on the run; "
            "give Exponential() or Explicit() as the integrator, or leave the rescue out"
        )
    return exogenous.moments


def _with_glucagon(exogenous: Exogenous, glucagon_ug: jax.Array, sample_time_min: float) -> Exogenous:
    """Inputs of a sample with glucagon that enters evenly until the next one."""
    rate = glucagon_ug / sample_time_min
    of_points = jnp.broadcast_to(rate, (points_of_sample(sample_time_min), *jnp.shape(rate)))
    minute_inputs = dataclasses.replace(exogenous.minute_inputs, glucagon_ug_min=of_points)
    return dataclasses.replace(exogenous, minute_inputs=minute_inputs)


def _check_declared(controller: Controller, decision: Decision) -> None:
    """Refuse a controller whose decisions contradict what it declares to give, which no loop could carry."""
    name, declares = type(controller).__name__, gives_boluses(controller)
    if decision.bolus_mU is not None and not declares:
        raise ArgumentTypeError(
            f"{name}.step decides on a bolus, but {name} does not say so; write gives_boluses = True in its class"
        )
    if decision.bolus_mU is None and declares:
        raise ArgumentTypeError(
            f"{name} says that it gives boluses, but {name}.step decides on none; "
            "return Decision(..., bolus_mU=...), 0 where there is none"
        )
    if (decision.glucagon_ug is not None) != gives_glucagon(controller):
        raise ArgumentTypeError(
            f"{name}.step and {name}.gives_glucagon contradict one another; a controller with gives_glucagon = True "
            "returns Decision(..., glucagon_ug=...), 0 where there is none, and another one returns none"
        )
