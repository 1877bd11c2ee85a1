"""Simulation of a controller of your own on virtual people, from Python."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import numpy.typing as npt

from glucoloop._representation import represented
from glucoloop.arguments import checked, on_host
from glucoloop.build.assemble import PeopleLoop, with_profile_of_each
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import Surroundings
from glucoloop.component.effects import warn_without_effect
from glucoloop.component.request import Request, completed
from glucoloop.control import Controller
from glucoloop.meals import Scenario, eaten
from glucoloop.meals.scenario import announced_g, announced_min
from glucoloop.metrics import Metrics, RunningMetrics
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import VirtualPeople
from glucoloop.physiology.exercise import draw_bouts
from glucoloop.pumps import Pump
from glucoloop.pumps.limits import DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.sensors import IdealSensor, Sensor
from glucoloop.simulation.closed_loop import default_pump, sample_grid, scenario_without_effect, usual_limits
from glucoloop.simulation.cohort import CohortRun
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs
from glucoloop.situations.situation import Situation
from glucoloop.trials.people import block_size, few_in_a_block, in_blocks

Array = npt.NDArray[Any]


@represented
@dataclass(frozen=True)
class PeopleRun:
    """Results of people; people trail."""

    metrics: Metrics
    """Metrics as NumPy arrays ``(people,)``; NaN for a person without a basal rate."""
    t_min: Array
    """(samples + 1,) times of the samples and of the horizon."""
    glucose_mg_dl: Array
    """(samples + 1, people) noise-free glucose at each sample and at the horizon."""
    insulin_mU_min: Array
    """(samples, people) all insulin delivered from each sample to the next, as a rate: a bolus counts evenly."""
    engine: str
    """Engine that computed the run, ``"native"`` or ``"xla"``."""
    scenario: Scenario
    setpoint_mg_dl: float
    glucose_valid: Array | None = None
    """(samples + 1, people) whether that glucose is in the valid range of the person's model: lower glucose, which may
    even be below zero, means only that it is very low."""
    not_native: str | None = None
    """Operation that native code lacks, and in whose code it is; None if there is none, or xla was asked for."""


@checked
@on_host("the loop is compiled for people by LLVM")
def simulate_people(
    people: VirtualPeople,
    controller: Controller,
    sensor: Sensor | None = None,
    pump: Pump | None = None,
    scenario: Scenario | None = None,
    seed: int = 0,
    *,
    limits: DoseLimits | None = None,
    precision: str = "float64",
    engine: str | None = None,
    threads: int | None = None,
) -> PeopleRun:
    """Simulate the loop of many people with one controller, in one scenario.

    Parameters
    ----------
    people : VirtualPeople
        People as `virtual_people` draws them; each starts at steady state at an individual basal rate.
    controller : Controller
        A controller of `glucoloop.control`, or one of your own, which must be made of JAX operations.
    sensor, pump : Sensor, Pump, optional
        As for `simulate`.
    scenario : Scenario, optional
        The 50 g oral glucose test at 50 min over 600 min by default. All people eat the same, and exercise at the same
        times; rhythms are drawn for each of them by the seed.
    seed : int
        Seed of the sensors; each person has an individual key.
    limits : DoseLimits, optional
        Limits against which the constraints are checked; those of the patient by default.
    precision : {"float64", "float32"}
    engine : {"native", "xla"}, optional
        Native code where the controller allows it, by default.
    threads : int, optional
        Number of threads, which changes no result; two for each core by default.

    Raises
    ------
    ValueError
        For a scenario that starts or aims elsewhere than where the people rest, a horizon that is not a whole number
        of samples, or an engine that is unknown or not possible.
    """
    if scenario is not None:
        warn_without_effect(scenario_without_effect(scenario, controller, people.patient), stacklevel=4)
    scenario = Scenario() if scenario is None else scenario
    grid = sample_grid(scenario.horizon_min, controller.sample_time_min, scenario.start_min, scenario.warm_up_min)
    setpoint = float(np.asarray(people.patient.setpoint_mg_dl).flat[0])
    for name in ("setpoint_mg_dl", "initial_glucose_mg_dl"):
        value = getattr(scenario, name)
        if value is not None and value != setpoint:
            raise Refusal(
                f"the scenario's {name} is {value:g}, but the people rest at {setpoint:g} mg/dl; "
                f"draw them with setpoint_mg_dl={value:g}"
            )
    default_limits = usual_limits(people.patient)
    limits = default_limits if limits is None else limits
    accumulator = RunningMetrics(setpoint_mg_dl=setpoint, limits=limits, inside_min=tuple(grid.inside_min.tolist()))
    meals, announced_carbs_g, announced_at_min = (
        eaten(scenario.meals),
        announced_g(scenario.meals),
        announced_min(scenario.meals, scenario.announced_before_min),
    )
    as_eaten = np.array_equal(announced_carbs_g, meals.carbs_g) and np.array_equal(announced_at_min, meals.t_min)
    announced_otherwise = scenario.announced and not as_eaten

    def minute_inputs_by(person: npt.NDArray[np.int64]) -> PeopleMinuteInputs:
        bouts = draw_bouts(scenario.exercise, seed, person).later(grid.warm_up_min) if scenario.exercise else None
        at_clock = dataclasses.replace(grid, start_min=scenario.start_min or 0.0)
        return PeopleMinuteInputs(at_clock.whole, bouts, scenario.rhythms, seed, person)

    loop = PeopleLoop(
        Situation(
            patient=completed(Request(patient_entry(people.name), alias=people.name)),
            setpoint_mg_dl=setpoint,
            announce_meals=scenario.announced,
            announce_before_min=scenario.announced_in_min or 0.0,
        ),
        controller,
        people,
        grid,
        accumulator,
        meals=meals,
        own_announcements=announced_otherwise,
        controllers_of=with_profile_of_each(controller),
        surroundings=Surroundings(
            sensor=IdealSensor() if sensor is None else sensor,
            pump=default_pump(default_limits, controller) if pump is None else pump,
        ),
        meal_model=scenario.meal_model,
        start_min=scenario.start_min,
        engine=engine,
        precision=precision,
        minute_inputs=minute_inputs_by(people.draw.person[:1]).names,
        rescue=scenario.rescue,
    )

    def run(place: npt.NDArray[np.intp], n: int) -> CohortRun:
        del n  # what fills the last block up is cut off at the end
        some = people.at(np.resize(place, drawn_together))
        announced: dict[str, Any] = dict.fromkeys(("announced_g", "announced_min"))
        if announced_otherwise:
            announced = {
                name: np.repeat(values[:, None], place.size, axis=1)
                for name, values in zip(announced, (announced_carbs_g, announced_at_min), strict=True)
            }
        keys, minute_inputs = keys_of_people(seed, some.draw.person), minute_inputs_by(some.draw.person[: place.size])
        return loop.run(some, keys, number=place.size, minute_inputs=minute_inputs, **announced)

    number, drawn_together = people.feasible.size, block_size(loop.engine)
    runs = in_blocks(run, np.arange(number), min(drawn_together, few_in_a_block(number)), threads)

    def joined(parts: list[Array]) -> Array:
        return np.concatenate(parts, axis=-1)[..., :number]

    first_meal = min((meal.t_min for meal in scenario.meals if meal.t_min >= 0.0), default=0.0)
    first_meal = float(np.floor(first_meal / grid.sample_time_min) * grid.sample_time_min)
    return PeopleRun(
        metrics=accumulator.finish(
            jax.tree.map(lambda *parts: joined(list(parts)), *(part.accumulator for part in runs)),
            samples=grid.samples,
            sample_time_min=grid.sample_time_min,
            meal_t_min=first_meal,
            precision=loop.cohort.precision,
        ),
        t_min=np.append(grid.t_min, scenario.horizon_min),
        glucose_mg_dl=joined([part.glucose_mg_dl for part in runs]),
        insulin_mU_min=joined([part.insulin_mU_min for part in runs]),
        glucose_valid=joined([part.glucose_valid for part in runs]),
        engine=loop.engine,
        not_native=loop.cohort.not_native,
        scenario=scenario,
        setpoint_mg_dl=setpoint if scenario.setpoint_mg_dl is None else scenario.setpoint_mg_dl,
    )
