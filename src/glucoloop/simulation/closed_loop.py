"""The closed loop: a patient, a controller, a sensor, a pump and a scenario make a trace."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree
from glucoloop.arguments import ArgumentTypeError, checked, is_traced, random_key
from glucoloop.component.effects import (
    AHEAD,
    ANNOUNCEMENTS,
    CHANCE,
    MEALS,
    MEALS_ANNOUNCED,
    OF_CONTROLLERS,
    RHYTHMS,
    TIME_OF_DAY,
    Need,
    warn_without_effect,
)
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.control.protocol import (
    Controller,
    Observation,
    draws,
    gives_boluses,
    gives_glucagon,
    uses_of,
)
from glucoloop.meals.models import meal_model_of
from glucoloop.meals.scenario import Scenario, announced_g, announced_min
from glucoloop.patients.capabilities import insulin_route, lowest_valid_glucose_mg_dl, refuse_glucagon, usual_pump
from glucoloop.patients.protocol import Patient
from glucoloop.pumps import DoseLimits, GlucagonLimits, LimitedPump, Pump
from glucoloop.refusal import Refusal
from glucoloop.sensors import DeadTime, IdealSensor, Lag, Sensor
from glucoloop.simulation.integrators import default_integrator
from glucoloop.simulation.loop import Loop, LoopState, Sampled, begin, sample
from glucoloop.simulation.minute_inputs import minute_inputs_of
from glucoloop.simulation.plant import Integrator, MinuteInputs, SampleGrid
from glucoloop.simulation.trace import Trace
from glucoloop.simulation.user_objects import (
    Fixed,
    apart,
    sample_time_of,
    wrong_with,
    wrong_with_pump,
    wrong_with_sensor,
)
from glucoloop.units import MIN_PER_DAY

Values = jax.Array | npt.NDArray[np.float64]


@pytree
class Start:
    """State and rate at which the loop begins."""

    x: jax.Array
    insulin_mU_min: jax.Array
    setpoint_mg_dl: jax.Array


@pytree
class _OnGrid:
    """Meals on the grid of samples, and the grid."""

    t_min: Values
    fine_t_min: Values
    carbs_g: Values
    announced_g: Values
    time_of_day_min: Values | None
    """Time of day at each sample, or None if the controller does not get it."""


def on_the_grid(scenario: Scenario, grid: SampleGrid) -> _OnGrid:
    """Meals of a scenario on a grid of samples, from the beginning of its warm-up on."""
    meals = scenario.eaten()

    def at_samples(t_min: Any, sizes_g: Any) -> Values:
        if is_traced(t_min, sizes_g):
            return jnp.zeros(grid.samples).at[jnp.floor(t_min / grid.sample_time_min).astype(int)].add(sizes_g)
        # an announcement may come before the start, which is then the time at which it is heard, or after the end
        sample = np.maximum(np.floor(np.asarray(t_min) / grid.sample_time_min), 0.0).astype(int)
        heard = sample < grid.samples
        return np.bincount(sample[heard], np.asarray(sizes_g)[heard], grid.samples).astype(float)

    carbs_g = at_samples(meals.t_min, meals.carbs_g)
    announced = 0.0 * carbs_g
    if scenario.announced:
        announced_at_min = scenario.warm_up_min + announced_min(scenario.meals, scenario.announced_before_min)
        announced = at_samples(announced_at_min, announced_g(scenario.meals))
    return _OnGrid(
        t_min=grid.t_min,
        fine_t_min=grid.fine_t_min,
        carbs_g=carbs_g,
        announced_g=announced,
        time_of_day_min=None if scenario.start_min is None else (grid.start_min + grid.t_min) % MIN_PER_DAY,
    )


@kept_jit(static_argnums=1)
def _run(numbers: list[Any], fixed: Fixed, start: Start, exogenous: Any, on_grid: _OnGrid, key: jax.Array) -> Trace:
    """Scan of the closed loop over samples."""
    loop: Loop = fixed.joined(numbers)
    patient = loop.plant.patient
    announced, times = on_grid.announced_g, on_grid.time_of_day_min
    first_time = None if times is None else times[0]
    state, reading_key = begin(loop, start.x, start.insulin_mU_min, announced[0], key, first_time)

    def one(state: LoopState, entry: Any) -> tuple[LoopState, Sampled]:
        index, outside, announced_g, time_of_day_min = entry
        return sample(loop, state, outside, announced_g, reading_key, index, time_of_day_min)

    index = jnp.arange(on_grid.carbs_g.shape[0])
    last, happened = jax.lax.scan(one, state, (index, exogenous, announced, times))
    return trace_of(patient, start, on_grid, happened, last.x)


def trace_of(patient: Patient, start: Start, on_grid: _OnGrid, happened: Sampled, x_end: jax.Array) -> Trace:
    """Trace of a run from the events of its samples, which are stacked on the leading axis, and its last state."""
    glucose = patient.glucose_mg_dl(start.x)
    return Trace(
        t_min=jnp.asarray(on_grid.t_min),
        glucose_mg_dl=happened.glucose_mg_dl,
        reading_mg_dl=happened.reading.glucose_mg_dl,
        reading_valid=happened.reading.valid,
        command_mU_min=happened.decision.insulin_mU_min,
        insulin_mU_min=happened.delivery.insulin_mU_min,
        reported_mU_min=happened.delivery.reported_mU_min,
        status=happened.decision.status,
        carbs_g=jnp.asarray(on_grid.carbs_g),
        states=jnp.concatenate([happened.x, x_end[None]]),
        fine_t_min=jnp.asarray(on_grid.fine_t_min),
        fine_glucose_mg_dl=jnp.concatenate([glucose[None], happened.inside_mg_dl.reshape(-1, *glucose.shape)]),
        setpoint_mg_dl=start.setpoint_mg_dl,
        basal_insulin_mU_min=start.insulin_mU_min,
        lowest_valid_mg_dl=jnp.broadcast_to(lowest_valid_glucose_mg_dl(patient), glucose.shape),
        command_bolus_mU=happened.decision.bolus_mU,
        bolus_mU=happened.delivery.bolus_mU,
        reported_bolus_mU=happened.delivery.reported_bolus_mU,
        command_glucagon_ug=happened.decision.glucagon_ug,
        glucagon_ug=happened.delivery.glucagon_ug,
        rescue_g=happened.rescue_g,
        forecast=happened.forecast,
        subcutaneous=insulin_route(patient) == SUBCUTANEOUS,
    )


def usual_limits(patient: Patient) -> DoseLimits:
    """Limits of the pump that is usual for a patient, or for the route by which it has insulin.

    Designs, `summarise` and `LimitedPump` see no patient and take the limits of 1999; for subcutaneous insulin those
    keep a controller far within what the pump can give.

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.usual_limits(gl.patient()).max_mU_min
    66.9
    """
    usual = usual_pump(patient)
    return DoseLimits(
        max_change_mU_min=usual.max_change_mU_min, min_mU_min=usual.min_mU_min, max_mU_min=usual.max_mU_min
    )


def default_pump(limits: DoseLimits, controller: Controller) -> Pump:
    """Pump with these limits, and a second route where a controller gives glucagon."""
    return LimitedPump(limits=limits, glucagon=GlucagonLimits() if gives_glucagon(controller) else None)


def sample_grid(
    horizon_min: float, sample_time_min: float, start_min: float | None = None, warm_up_min: float = 0.0
) -> SampleGrid:
    """Samples of a run from a time of day, midnight by default; horizon and warm-up are whole numbers of them."""

    def whole(what: str, minutes: float, least: int) -> int:
        samples = round(minutes / sample_time_min)
        if samples < least or abs(samples * sample_time_min - minutes) > 1e-9 * minutes:
            raise Refusal(
                f"a {what} of {minutes:g} min is not a whole number of samples of {sample_time_min:g} min; "
                f"{max(1, samples) * sample_time_min:g} min would be"
            )
        return samples

    return SampleGrid(
        sample_time_min=sample_time_min,
        samples=whole("horizon", horizon_min, 1),
        start_min=start_min or 0.0,
        warm_up=whole("warm-up", warm_up_min, 0),
    )


def start_of(patient: Patient, scenario: Scenario) -> Start:
    """The patient at steady state, at the initial glucose of the scenario."""
    insulin = patient.basal_insulin_mU_min
    if scenario.initial_glucose_mg_dl is not None:
        insulin = patient.insulin_for(scenario.initial_glucose_mg_dl)
    setpoint = (
        patient.setpoint_mg_dl if scenario.setpoint_mg_dl is None else jnp.asarray(scenario.setpoint_mg_dl, float)
    )
    return Start(x=patient.steady_state(insulin), insulin_mU_min=insulin, setpoint_mg_dl=setpoint)


@checked
def simulate(
    patient: Patient,
    controller: Controller,
    sensor: Sensor | None = None,
    pump: Pump | None = None,
    scenario: Scenario | None = None,
    key: jax.Array | int | None = None,
    *,
    integrator: Integrator | None = None,
    forecasts: bool = False,
) -> Trace:
    """Simulate the closed loop of one patient or of several.

    At each sample the sensor reads, the controller decides, and the pump delivers until the next one. The patient
    starts at steady state, before the warm-up of the scenario if it has one; the trace begins at the end of that.

    Parameters
    ----------
    sensor : Sensor, optional
        Sensor; an ideal one by default.
    pump : Pump, optional
        Pump; by default one with the default limits of the patient, see `simulation.usual_limits`.
    scenario : Scenario, optional
        The 50 g oral glucose test at 50 min over 600 min by default.
    key : JAX key or int, optional
        Source of all randomness: the same key gives the same trace. By default 0.
    integrator : Integrator, optional
        Integrator; by default `Exponential` if the patient has the parts for it, else `Explicit`, as for one whose
        constants follow the clock, and in a scenario with exercise or rhythms.
    forecasts : bool
        Whether the trace has the forecast on which each decision rests, see `Trace.forecasts_to_polars`.

    Warns
    -----
    NoEffectWarning
        For what the scenario has and the controller has no use for, such as announced meals, for a key where nothing is
        drawn at random, and for forecasts of a controller that makes none.

    Raises
    ------
    ValueError
        If the horizon is not a whole number of the controller's samples, the patient cannot rest at the initial
        glucose, or it does not take the exercise or the rhythms of the scenario.
    """
    if scenario is not None:
        warn_without_effect(scenario_without_effect(scenario, controller, patient), stacklevel=3)
    seed = random_key(0 if key is None else key)
    if key is not None and not (draws(controller) or _draw(sensor, pump)):
        warn_without_effect([f"key has no effect: {CHANCE.reason}."], stacklevel=3)
    trace = closed_loop(patient, controller, sensor, pump, scenario, seed, integrator=integrator, forecasts=forecasts)
    if forecasts and trace.forecast is None:
        warn_without_effect([f"forecasts has no effect: the controller {type(controller).__name__} makes none."], 3)
    return trace


def _draw(sensor: Sensor | None, pump: Pump | None) -> bool:
    """Whether a sensor or a pump may draw random numbers; those that nobody here knows may."""
    while isinstance(sensor, DeadTime | Lag):
        sensor = sensor.inner
    return not (sensor is None or type(sensor) is IdealSensor) or not (pump is None or type(pump) is LimitedPump)


def scenario_without_effect(scenario: Scenario, controller: Controller, patient: Patient) -> Iterator[str]:
    """Notes on what a scenario has, and neither controller nor patient nor the scenario itself has a use for."""
    uses = uses_of(controller) | ({MEALS} if len(scenario.meals) else frozenset())
    uses |= {MEALS_ANNOUNCED} if scenario.announced else frozenset()
    uses |= {TIME_OF_DAY} if scenario.rhythms or not getattr(patient, "timeless", False) else frozenset()
    uses |= {RHYTHMS} if scenario.rhythms else frozenset()
    uses |= {MEALS} if scenario.rescue is not None else frozenset()
    for name, needs in _SCENARIO_NEEDS.items():
        value, default = getattr(scenario, name), getattr(Scenario, name)
        lacking = next((need for need in needs if need not in uses), None)
        if lacking is not None and (value is not None if default is None else is_traced(value) or value != default):
            of_controller = f"the controller {type(controller).__name__} does not use {lacking.noun}"
            yield f"{name} has no effect: {of_controller if lacking in OF_CONTROLLERS else lacking.reason}."


_SCENARIO_NEEDS: Final[dict[str, tuple[Need, ...]]] = {
    "announced": (MEALS, ANNOUNCEMENTS),
    "announced_before_min": (MEALS_ANNOUNCED, MEALS, ANNOUNCEMENTS, AHEAD),
    "meal_model": (MEALS,),
    "start_min": (TIME_OF_DAY,),
    "rhythm_seed": (RHYTHMS,),
    "rhythm_person": (RHYTHMS,),
}
"""Settings of a scenario without which it can be the same, with what each needs to have an effect."""


def closed_loop(
    patient: Patient,
    controller: Controller,
    sensor: Sensor | None = None,
    pump: Pump | None = None,
    scenario: Scenario | None = None,
    key: jax.Array | int = 0,
    *,
    integrator: Integrator | None = None,
    forecasts: bool = False,
) -> Trace:
    """Simulate as `simulate` does, of arguments that were checked before."""
    sensor = IdealSensor() if sensor is None else sensor
    dual = gives_glucagon(controller)
    pump = default_pump(usual_limits(patient), controller) if pump is None else pump
    scenario = Scenario() if scenario is None else scenario
    key = random_key(key)

    counted = sample_grid(scenario.horizon_min, sample_time_of(controller), scenario.start_min, scenario.warm_up_min)
    grid = counted.whole
    minute_inputs = minute_inputs_of(patient, scenario, grid)
    if dual:
        refuse_glucagon(patient)
    if integrator is None:
        integrator = default_integrator(patient, minute_inputs=bool(minute_inputs.names) or dual)
    plant, exogenous = integrator.prepare(patient, scenario.absorbed_by(patient), grid)
    exogenous = dataclasses.replace(exogenous, minute_inputs=minute_inputs)
    start = start_of(patient, scenario)
    rescue = scenario.rescue and scenario.rescue.for_gut(meal_model_of(patient, scenario.meal_model))
    loop = Loop(
        plant=plant,
        controller=controller,
        sensor=sensor,
        pump=pump,
        setpoint_mg_dl=start.setpoint_mg_dl,
        rescue=rescue,
        announced_in_min=None if scenario.announced_in_min is None else jnp.asarray(scenario.announced_in_min, float),
        forecasts=forecasts,
    )
    numbers, fixed = apart(loop)
    try:
        on_grid = on_the_grid(scenario, grid)
        trace: Trace = _run(numbers, fixed, start, exogenous, on_grid, key)
    except (AttributeError, TypeError, ValueError):
        wrong = (
            wrong_with_sensor(sensor, start.setpoint_mg_dl)
            or wrong_with_pump(pump, start.insulin_mU_min)
            or wrong_with(controller, _first_observation(start, controller, scenario))
        )
        if wrong is None:
            raise
        raise ArgumentTypeError(wrong) from None
    return with_minute_inputs(trace, scenario, on_grid, minute_inputs).after(counted.warm_up)


def with_minute_inputs(trace: Trace, scenario: Scenario, on_grid: _OnGrid, minute_inputs: MinuteInputs) -> Trace:
    """A trace with what was announced, and the exercise of its scenario."""
    announced_g = jnp.asarray(on_grid.announced_g) if scenario.announced else None
    exercise = None if minute_inputs.exercise_pct is None else jnp.mean(jnp.asarray(minute_inputs.exercise_pct), axis=1)
    return dataclasses.replace(trace, announced_carbs_g=announced_g, exercise_pct=exercise)


def _first_observation(start: Start, controller: Controller, scenario: Scenario) -> Observation:
    zero = jnp.zeros(())
    return Observation(
        glucose_mg_dl=start.setpoint_mg_dl,
        valid=jnp.ones((), bool),
        setpoint_mg_dl=start.setpoint_mg_dl,
        delivered_mU_min=start.insulin_mU_min,
        announced_carbs_g=zero,
        delivered_bolus_mU=zero if gives_boluses(controller) else None,
        time_of_day_min=None if scenario.start_min is None else jnp.asarray(scenario.start_min, float),
        announced_in_min=None if scenario.announced_in_min is None else zero,
        key=jax.random.key(0) if draws(controller) else None,
    )
