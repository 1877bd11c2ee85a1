"""Closed loop of many people at once: the same loop, sample by sample, for all of them.

Values that differ between people (constants of the patient, meals, random keys, individual controllers) have a trailing
axis; shared values are part of the program. `people_plant` integrates, and `engines` runs the loop.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, varying
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control.protocol import Controller, gives_boluses, gives_glucagon
from glucoloop.meals.protocol import Eaten, MealModel
from glucoloop.meals.rescue import RescueCarbs
from glucoloop.native.targets import FUSED
from glucoloop.patients.capabilities import refuse_glucagon
from glucoloop.patients.protocol import Patient
from glucoloop.pumps import Pump
from glucoloop.sensors import Sensor
from glucoloop.simulation.engines import Engine, make_engine, one_at_a_time
from glucoloop.simulation.integrators import plants_of_people
from glucoloop.simulation.loop import Loop
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs, refuse_minute_inputs
from glucoloop.simulation.people_meals import PeopleMeals
from glucoloop.simulation.person_loop import Accumulator, PersonLoop, PersonValues, SampledInside, SteppedRun, WholeRun
from glucoloop.simulation.plant import MinuteInputs, SampleGrid
from glucoloop.simulation.user_objects import NEED_VALUES, needs_values
from glucoloop.simulation.vector_stepper import MAX_AT_ONCE, Begun, SeenAtSample, SteppedPeople, StoredInputs
from glucoloop.units import MIN_PER_DAY

Array = npt.NDArray[Any]

_PEOPLE_AT_ONCE: Final = 1024
"""Number of people of whom a piece of a run in native code has `MAX_AT_ONCE` samples; of fewer it has more."""


@dataclass(frozen=True)
class People:
    """Some people at the start of a run; people trail."""

    patient: Patient
    x: Array
    """(states, people) steady states."""
    insulin_mU_min: Array
    """(people,) rates under which they rest."""
    key: jax.Array
    """(people,) random key of each sensor."""
    controller: Controller | None = None
    """Controllers of people's own, numbers trailing, or None for the cohort's."""
    sensor: Sensor | None = None
    """Sensors of people's own, numbers trailing, or None for the cohort's."""
    pump: Pump | None = None
    meals: Eaten | None = None
    """(meals, people) meals of people's own, or None for the cohort's; in a warm-up they begin before 0."""
    announced_g: Array | None = None
    """(meals, people) announced carbohydrate of each meal, in a cohort that was made for individual announcements, or
    None for the true carbohydrate.
    """
    minute_inputs: PeopleMinuteInputs | None = None
    """Exercise and what rhythms change, from the beginning of the warm-up on, in a cohort that was made for them."""
    announced_min: Array | None = None
    """(meals, people) time at which each meal is announced, or None for that at which eating begins."""


@dataclass(frozen=True)
class CohortRun:
    """Results of people."""

    accumulator: Any
    """The fold's state at the end, ``(..., people)``, float64."""
    glucose_mg_dl: Array
    """(samples + 1, people) noise-free glucose at each sample and at the horizon, in the engine's precision."""
    glucose_valid: Array
    """(samples + 1, people) whether that glucose is in the valid range of the person's model: lower glucose, which may
    even be below zero, means only that it is very low."""
    insulin_mU_min: Array
    """(samples, people) all insulin delivered from each sample to the next, as a rate: a bolus counts evenly."""
    reading_mg_dl: Array | None = None
    """(samples, people) readings of the sensor, NaN where there was none, if the cohort returns them."""
    status: Array | None = None
    """(samples, people) `control.protocol.Status` of each decision, if the cohort returns it."""
    reported_mU_min: Array | None = None
    """(samples, people) rates as the pump reported them, from each sample to the next, if the cohort returns them."""


@pytree
class _Counted:
    """A fold that begins at the end of the warm-up, as that of a run which begins there."""

    accumulator: Accumulator

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Any:
        return self.accumulator.init(glucose_mg_dl, insulin_mU_min)

    def step(self, state: Any, happened: SampledInside, t_min: jax.Array) -> Any:
        begun = self.accumulator.init(happened.inside_mg_dl[-1], happened.delivery.insulin_mU_min)
        counted = self.accumulator.step(state, happened, t_min)
        return jax.tree.map(lambda new, old: jnp.where(t_min < 0.0, new, old), begun, counted)


class Cohort:
    """A closed loop compiled for people of one kind, who are like the `nominal` patient.

    `varied` are some people, to show which constants vary: those that have one axis more than the nominal patient's;
    `varied_controller`, `varied_sensor` and `varied_pump` do the same where each person has a different one. `meals`
    are those of all people, ``(meals,)``, or None if each has individual meals; with `own_announcements` what is
    announced is individual too, as for carbohydrate that is counted with an error. With `announced_in_min` controllers
    are told that a meal is eaten so long after its announcement. Controllers are told of the time of
    day from `start_min`, in minutes after midnight, if it is given. The meal model is each person's own unless it is
    given. With a warm-up of the grid, times count from the end of it, and fold and results begin there. For engine,
    precision and products see `make_engine`. By default the integrator makes the steps
    that `people_plant` gives people. With `record_decisions` a run returns readings and statuses too. `minute_inputs`
    has the names of the inputs of people that are constant over a minute, see `plant.MinuteInputs`. One that is
    `stepped` is advanced from outside, by `begin` and `lanes`, and does not run by itself; its controller is an
    `ExternalDoses`, or has one inside. With `rescue` people eat when their glucose is low.
    """

    def __init__(
        self,
        nominal: Patient,
        varied: Patient,
        controller: Controller,
        sensor: Sensor,
        pump: Pump,
        grid: SampleGrid,
        accumulator: Accumulator,
        *,
        setpoint_mg_dl: float,
        meals: Eaten | None,
        announced: bool = False,
        own_announcements: bool = False,
        announced_in_min: float | None = None,
        start_min: float | None = None,
        meal_model: MealModel | None = None,
        varied_controller: Controller | None = None,
        varied_sensor: Sensor | None = None,
        varied_pump: Pump | None = None,
        engine: str | None = None,
        precision: str = "float64",
        products: str = FUSED,
        substeps: int | None = None,
        record_decisions: bool = False,
        minute_inputs: Sequence[str] = (),
        stepped: bool = False,
        rescue: RescueCarbs | None = None,
    ) -> None:
        self._minute_inputs, self._stepped, self._nominal = tuple(minute_inputs), stepped, nominal
        inputs = MinuteInputs(**{name: np.zeros(0) for name in self._minute_inputs})
        refuse_minute_inputs(nominal, inputs)
        self._warm_up, self._warm_up_min = grid.warm_up, grid.warm_up_min
        takes_meals = getattr(accumulator, "takes_meals", False)
        grid = self._grid = dataclasses.replace(grid, start_min=start_min or 0.0).whole
        dual = gives_glucagon(controller)
        if dual:
            refuse_glucagon(nominal)
        self._plants = plants_of_people(
            nominal, varied, grid, substeps, products, minute_inputs=bool(self._minute_inputs) or dual
        )
        eating = self._eating = PeopleMeals(
            nominal,
            varied,
            meals,
            grid,
            warm_up_min=self._warm_up_min,
            substeps=self._plants.substeps,
            instead=meal_model,
            announced=announced,
            own_announcements=own_announcements,
            counted=takes_meals,
            products=products,
        )
        self._shared = {"moments": eating.moments, "t_min": grid.t_min, "told": eating.announced_by_sample}
        if takes_meals and not eating.individual:
            self._shared["eaten"] = eating.eaten_by_sample
        if start_min is not None:
            self._shared["time_of_day_min"] = (grid.start_min + grid.t_min) % MIN_PER_DAY
        if self._warm_up:
            self._shared["counted_min"] = grid.t_min - self._warm_up_min
        times = self._shared.get("time_of_day_min")
        one = self._one = PersonLoop(
            loop=Loop(
                plant=self._plants.single,
                controller=controller,
                sensor=sensor,
                pump=pump,
                setpoint_mg_dl=jnp.asarray(float(setpoint_mg_dl)),
                rescue=rescue and rescue.for_gut(eating.gut(nominal)),
                announced_in_min=None if announced_in_min is None else jnp.asarray(float(announced_in_min)),
            ),
            digestion=eating.digestion,
            fold=_Counted(accumulator=accumulator) if self._warm_up else accumulator,
            varies=(
                tuple(self._plants.varies),
                tuple(eating.varies),
                *(
                    tuple(varying(one if many is None else many, one))
                    for many, one in ((varied_controller, controller), (varied_sensor, sensor), (varied_pump, pump))
                ),
            ),
            own_gut=eating.individual,
            announced=announced,
            warm_up=bool(self._warm_up),
            records_decisions=record_decisions,
            minute_inputs=inputs,
            start_time_of_day_min=None if times is None else jnp.asarray(times[0]),
        )
        self._begin_people = jax.jit(jax.vmap(one.begin, in_axes=(-1, -1, 0, 0, 0), out_axes=(-1, 0)))
        self._end_people = jax.jit(jax.vmap(one.end, in_axes=-1))
        self._look_at_people = jax.jit(jax.vmap(one.look, in_axes=(-1, -1, 0, None)))
        self._engine = self._make_engine(engine, precision, products)

    @property
    def engine(self) -> str:
        """Name of the engine."""
        return self._engine.name

    @property
    def not_native(self) -> str | None:
        """Operation that native code lacks, and in whose code it is; None if there is none, or xla was asked for."""
        return self._engine.not_native

    @property
    def precision(self) -> str:
        """Precision of the engine."""
        return self._engine.precision

    def run(self, people: People, *, number: int | None = None, threads: int = 1) -> CohortRun:
        """Run the loop of some hundred to a few thousand people, so that they fit the caches.

        The result, of so many of the first people as in `follow`, does not depend on the number of threads of native
        code.
        """
        pieces: list[tuple[Array, ...]] = []
        accumulator, end, lowest = self.follow(
            people, lambda *piece: pieces.append(piece), number=number, threads=threads
        )
        outputs = pieces[0] if len(pieces) == 1 else [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
        glucose, delivered, *decisions = outputs
        reading, status, reported = decisions or (None, None, None)
        whole = np.concatenate([glucose, end[None]])
        return CohortRun(
            accumulator=accumulator,
            glucose_mg_dl=whole,
            glucose_valid=whole >= lowest,
            insulin_mU_min=delivered,
            reading_mg_dl=reading,
            status=None if status is None else status.astype(int),
            reported_mU_min=reported,
        )

    def follow(
        self, people: People, take: Callable[..., None], *, number: int | None = None, threads: int = 1
    ) -> tuple[Any, Array, Array]:
        """Run the loop in pieces, so that memory does not grow with its length.

        `take` is called with the glucose ``(samples, people)`` and the insulin of each piece, and with readings,
        statuses and reported rates if the cohort returns them. The fold's state at the end comes back as float64, and
        so do glucose at the end and the lower end of its valid range. Of a `number` only so many of the first people
        are run, and meals, announcements and what is held are of them alone.
        """
        samples, everybody, most = self._grid.samples, people.insulin_mU_min.shape[0], MAX_AT_ONCE
        number = everybody if number is None else number
        if self.engine == "native":
            most *= max(1, _PEOPLE_AT_ONCE // number)
        again = np.arange(everybody) % number
        with one_at_a_time:
            of_all, (reaching_in, first_announced) = self._values_of(people), self._inputs_of(people, number)
            reaching = reaching_in(slice(0, min(samples, most)))
            rest = people.x, people.insulin_mU_min
            carry, keys = self._begin_people(of_all, *rest, first_announced[again], people.key)
            for computed in jax.tree.leaves((of_all, carry, keys)):
                computed.block_until_ready()
            person = of_all
            if number < everybody:
                person, carry = jax.tree.map(lambda leaf: np.asarray(leaf)[..., :number], (person, carry))
                keys = keys[:number]
        for first in range(0, samples, most):
            piece = slice(first, min(first + most, samples))
            if first:
                with one_at_a_time:
                    reaching = reaching_in(piece)
            shared = {name: values[piece] for name, values in self._shared.items()}
            carry, outputs = self._engine.run(person, carry, reaching, shared, keys, first=first, threads=threads)
            uncounted = max(0, self._warm_up - first)
            take(*(output[uncounted:] for output in outputs))
        with one_at_a_time:
            end, lowest = (np.asarray(of)[:number] for of in self._end_people(of_all, carry.loop.x[:, again]))
        return jax.tree.map(lambda values: np.asarray(values, np.float64), carry.accumulator), end, lowest

    def begin(self, people: People) -> Begun:
        """People before their first sample, for the `lanes` of a stepped cohort."""
        with one_at_a_time:
            person = self._values_of(people)
            reaching_in, first_announced = self._inputs_of(people, people.insulin_mU_min.shape[0])
            rest = people.x, people.insulin_mU_min
            carry, keys = self._begin_people(person, *rest, first_announced, people.key)
            glucose, reading = map(np.asarray, self._look_at_people(person, carry, keys, 0))
        number, samples = people.insulin_mU_min.shape[0], self._grid.samples

        @functools.lru_cache(maxsize=1)
        def inputs_in(piece: int) -> dict[str, StoredInputs]:
            within = slice(piece * MAX_AT_ONCE, min((piece + 1) * MAX_AT_ONCE, samples))
            of_all = {name: values[within] for name, values in self._shared.items()}
            together = {name: np.broadcast_to(v[..., None], (*v.shape, number)) for name, v in of_all.items()}
            return {name: StoredInputs(values) for name, values in {**together, **reaching_in(within)}.items()}

        seen = SeenAtSample(
            glucose_mg_dl=glucose, reading_mg_dl=reading, infused_mU_min=np.array(people.insulin_mU_min, float)
        )
        key_data = np.asarray(jax.random.key_data(keys))
        return Begun(person=person, carry=carry, key_data=key_data, inputs_in=inputs_in, seen=seen, samples=samples)

    def lanes(self, number: int) -> SteppedPeople:
        """Places for a number of people of a stepped cohort, each of whom is at a sample of their own."""
        return SteppedPeople(self._engine.lanes(number), number)

    def _make_engine(self, name: str | None, precision: str, products: str) -> Engine:
        person = self._one.values(self._one.loop, self._one.digestion)
        insulin = self._nominal.basal_insulin_mU_min
        rest = self._nominal.steady_state(insulin)
        carry, key = jax.eval_shape(self._one.begin, person, rest, insulin, jnp.zeros(()), jax.random.key(0))
        reaching: dict[str, Any] = {name: np.zeros(self._grid.inside_min.size) for name in self._minute_inputs}
        if self._eating.individual:
            reaching["meals"] = np.zeros(self._one.digestion.inputs)
        if self._eating.announced_each:
            reaching["told"] = np.zeros(())
        if self._eating.counted_each:
            reaching["eaten"] = np.zeros(())
        shared = {name: values[0] for name, values in self._shared.items()}
        if self._stepped:
            external = self._one.loop.controller
            requested = person.controller[: 1 + gives_boluses(external) + gives_glucagon(external)]
            reaching, shared = {**shared, **reaching, "asked": requested}, {}
        try:
            return make_engine(
                (SteppedRun if self._stepped else WholeRun)(one=self._one),
                person,
                carry,
                reaching,
                shared,
                key,
                name=name,
                precision=precision,
                products=products,
            )
        except NEED_VALUES as error:
            raise ArgumentTypeError(needs_values(type(self._one.loop.controller).__name__, error)) from None

    def _values_of(self, people: People) -> PersonValues:
        """Values that differ between people."""
        names = ("controller", "sensor", "pump")
        own = {name: getattr(people, name) for name in names if getattr(people, name) is not None}
        loop = dataclasses.replace(self._one.loop, plant=self._plants.of(people.patient), **own)
        return self._one.values(loop, self._eating.digestion_of(people.patient))

    def _inputs_of(self, people: People, n: int) -> tuple[Callable[[slice], dict[str, Any]], Array]:
        """Function of a piece of the run that gives the inputs of the first people, and what is announced first."""
        if (() if people.minute_inputs is None else people.minute_inputs.names) != self._minute_inputs:
            raise TypeError(f"this cohort was made for people with {self._minute_inputs}; give their values as held")
        announced = people.announced_g, people.announced_min
        everybody = people.insulin_mU_min.shape[0]
        eaten, first_announced = self._eating.inputs(people.patient, n, people.meals, *announced, everybody)

        def inputs(piece: slice) -> dict[str, Any]:
            minute_inputs = MinuteInputs() if people.minute_inputs is None else people.minute_inputs.of(piece)
            return {**{name: getattr(minute_inputs, name) for name in self._minute_inputs}, **eaten(piece)}

        return inputs, first_announced
