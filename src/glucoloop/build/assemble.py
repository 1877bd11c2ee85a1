"""The closed loop of a situation: of one person with `close_loop`, of many with `PeopleLoop`.

Every command, study and paper makes its loops here, so that a situation means the same in all of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy.typing as npt

from glucoloop.build.designs import paced_situation, with_actions, with_guard, with_schedule
from glucoloop.build.individual import individual_design
from glucoloop.build.surroundings import Surroundings, surroundings_of
from glucoloop.build.titration import profile_of
from glucoloop.control import Controller, paced
from glucoloop.meals import Eaten, MealModel, RescueCarbs, Scenario
from glucoloop.native.targets import FUSED
from glucoloop.patients import Patient
from glucoloop.patients.population import VirtualPeople
from glucoloop.simulation import Trace
from glucoloop.simulation.closed_loop import closed_loop
from glucoloop.simulation.cohort import Cohort, CohortRun, People
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs
from glucoloop.simulation.person_loop import Accumulator
from glucoloop.simulation.plant import Integrator, SampleGrid
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation
from glucoloop.therapy import Profile, given_profile

Array = npt.NDArray[Any]


class AtRest(Protocol):
    """People at the start of a run, such as `patients.population.VirtualPeople`; people trail."""

    @property
    def patient(self) -> Patient:
        """Constants of the people."""

    @property
    def rest(self) -> Array:
        """State of each at steady state, ``(states, people)``."""

    @property
    def basal_insulin_mU_min(self) -> Array:
        """Rate under which each rests, ``(people,)``."""

    @property
    def profile(self) -> Profile:
        """Profile of each, ``(people,)``."""


ControllersOf = Callable[[Any], Controller]
"""Function that makes the controllers of people `AtRest`, whose numbers trail."""


def close_loop(
    situation: Situation,
    controller: Controller,
    scenario: Scenario,
    *,
    patient: Patient | None = None,
    surroundings: Surroundings | None = None,
    key: jax.Array | int | None = None,
    integrator: Integrator | None = None,
    forecasts: bool = False,
) -> Trace:
    """Simulate one person in a situation under a controller.

    By default the person is the nominal patient, sensor, pump and key are those of the situation.
    """
    surroundings = surroundings_of(situation) if surroundings is None else surroundings
    return closed_loop(
        situation.nominal if patient is None else patient,
        controller,
        surroundings.sensor,
        surroundings.pump,
        scenario,
        situation.seed if key is None else key,
        integrator=integrator,
        forecasts=forecasts,
    )


def own_controllers(
    situation: Situation, case: Case, controller: Controller, example: VirtualPeople, *, individual: bool
) -> ControllersOf | None:
    """Function that makes controllers of a case for people.

    They are designed for each if `individual`, and else have the profile of each. `controller` is that of the
    nominal patient, and `example` some of the people, which show the values that vary. None for a controller with
    nothing to adapt to a person.
    """
    if not individual:
        return with_profile_of_each(controller)
    inner = dataclasses.replace(case, guard=None, every_min=None)
    of_case = paced_situation(situation, case)
    designed = individual_design(of_case.of_controller(), inner, controller, example)
    if designed is None:
        return None

    def with_own_guard(people: VirtualPeople) -> Controller:
        # The guard alone is given the basal rate: what is inside was designed for each person already.
        basal = jnp.asarray(people.profile.basal_mU_min)
        acting = with_actions(designed(people), of_case, people.profile)
        own = with_guard(acting, case.guard, situation.limits, basal)
        return paced(with_schedule(own, of_case, people.profile), situation.sample_time_min)

    return with_own_guard


def with_profile_of_each(controller: Controller) -> ControllersOf:
    """Function that gives one controller the profile of each person."""
    return lambda people: given_profile(controller, people.profile)


def of_nominal_person(controller: Controller, situation: Situation, example: AtRest) -> Controller:
    """A controller of the nominal patient in the form of those of people, whose profiles may hold more or less."""
    if not hasattr(controller, "with_profile"):
        return controller
    one: Controller = given_profile(controller, profile_of(situation).like(example.profile))
    return one


class PeopleLoop:
    """The loop of one controller in a situation, compiled once for any people.

    The situation gives patient, target and announcement; sensor, pump and meal model too, unless `surroundings` and
    `meal_model` give them. The controller was designed for the nominal patient; `controllers_of` makes those of people
    (see `own_controllers`). `example` and `varied` are some people, and sensors and pumps of some, to show which
    numbers vary. `meals` are those of all people, ``(meals,)``, or None if each brings meals; with `own_announcements`
    each brings what is announced, as where carbohydrate is counted with an error. The other arguments are as for
    `simulation.cohort.Cohort`.
    """

    def __init__(
        self,
        situation: Situation,
        controller: Controller,
        example: AtRest,
        grid: SampleGrid,
        accumulator: Accumulator,
        *,
        meals: Eaten | None,
        own_announcements: bool = False,
        controllers_of: ControllersOf | None = None,
        surroundings: Surroundings | None = None,
        varied: Surroundings | None = None,
        meal_model: MealModel | None = None,
        start_min: float | None = None,
        engine: str | None = None,
        precision: str = "float64",
        products: str = FUSED,
        record_decisions: bool = False,
        minute_inputs: Sequence[str] = (),
        stepped: bool = False,
        rescue: RescueCarbs | None = None,
    ) -> None:
        self.controllers_of, self._example = controllers_of, example.patient
        if controllers_of is not None:
            controller = of_nominal_person(controller, situation, example)
        self.controller = controller
        surroundings = surroundings_of(situation) if surroundings is None else surroundings
        self.cohort = Cohort(
            situation.nominal,
            example.patient,
            controller,
            surroundings.sensor,
            surroundings.pump,
            grid,
            accumulator,
            setpoint_mg_dl=situation.target_mg_dl,
            meals=meals,
            announced=situation.announce_meals,
            announced_in_min=situation.announce_before_min or None,
            own_announcements=own_announcements,
            start_min=situation.start_min if start_min is None else start_min,
            meal_model=situation.gut if meal_model is None else meal_model,
            varied_controller=None if controllers_of is None else controllers_of(example),
            varied_sensor=None if varied is None else varied.sensor,
            varied_pump=None if varied is None else varied.pump,
            engine=engine,
            precision=precision,
            products=products,
            record_decisions=record_decisions,
            minute_inputs=minute_inputs,
            stepped=stepped,
            rescue=situation.rescue_carbs if rescue is None else rescue,
        )

    @property
    def engine(self) -> str:
        """Engine of the loop, native or xla."""
        return self.cohort.engine

    @property
    def engine_facts(self) -> dict[str, str]:
        """The engine by its name and, where native code could not take the loop, what it lacks and in whose code."""
        lacking = self.cohort.not_native
        return {"engine": self.engine, **({} if lacking is None else {"not_native": lacking})}

    def people(
        self,
        people: AtRest,
        key: jax.Array,
        *,
        controller: Controller | None = None,
        surroundings: Surroundings | None = None,
        meals: Eaten | None = None,
        announced_g: Array | None = None,
        announced_min: Array | None = None,
        minute_inputs: PeopleMinuteInputs | None = None,
    ) -> People:
        """People prepared for a run of the cohort, with the keys ``(people,)`` of their sensors.

        Controllers, sensors, pumps and meals ``(meals, people)`` of people take the place of those of the loop;
        `announced_g` and `announced_min`, ``(meals, people)``, are the carbohydrate that is announced of the meals [g]
        and the times at which it is, by default what is eaten and when eating begins; `minute_inputs` is exercise
        and what rhythms change, in a loop made for them.
        """
        number = people.basal_insulin_mU_min.shape[0]

        def trailing(leaf: Any, like: Any) -> Any:
            # the nominal patient has one number where people differ
            return jnp.broadcast_to(leaf, number) if jnp.ndim(like) and not jnp.ndim(leaf) else leaf

        if controller is None and self.controllers_of is not None:
            controller = self.controllers_of(people)
        return People(
            patient=jax.tree.map(trailing, people.patient, self._example),
            x=people.rest,
            insulin_mU_min=people.basal_insulin_mU_min,
            key=key,
            controller=controller,
            sensor=None if surroundings is None else surroundings.sensor,
            pump=None if surroundings is None else surroundings.pump,
            meals=meals,
            announced_g=announced_g,
            announced_min=announced_min,
            minute_inputs=minute_inputs,
        )

    def run(
        self, people: AtRest, key: jax.Array, *, number: int | None = None, threads: int = 1, **brought: Any
    ) -> CohortRun:
        """Run the loop of people, or of a number of the first of them, with the arguments of `people`."""
        with one_at_a_time:
            ready = self.people(people, key, **brought)
        return self.cohort.run(ready, number=number, threads=threads)
