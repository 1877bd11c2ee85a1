"""Closed loop of many people at once: the same loop, sample by sample, for all of them.

Values that differ between people (constants of the patient, meals, random keys, individual controllers) have a trailing
axis; shared values are part of the program. `people_plant` integrates, and `engines` runs the loop.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import chosen, pytree, replaced, varying
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control.protocol import Controller, gives_boluses, gives_glucagon
from glucoloop.meals.absorption import Digestion
from glucoloop.meals.protocol import Eaten, MealModel
from glucoloop.meals.rescue import RescueCarbs
from glucoloop.native.targets import FUSED
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl, refuse_glucagon
from glucoloop.patients.protocol import Patient
from glucoloop.pumps import Pump
from glucoloop.sensors import Reading, Sensor
from glucoloop.simulation.engines import Engine, make_engine, one_at_a_time
from glucoloop.simulation.integrators import plants_of_people
from glucoloop.simulation.loop import Loop, LoopState, Sampled, begin, look, sample
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs, refuse_minute_inputs
from glucoloop.simulation.people_meals import PeopleMeals
from glucoloop.simulation.plant import Exogenous, MinuteInputs, SampleGrid
from glucoloop.simulation.user_objects import NEED_VALUES, needs_values
from glucoloop.simulation.vector_stepper import MAX_AT_ONCE, Begun, SeenAtSample, SteppedPeople, StoredInputs
from glucoloop.units import MIN_PER_DAY

Array = npt.NDArray[Any]

_PEOPLE_AT_ONCE: Final = 1024
"""Number of people of whom a piece of a run in native code has `MAX_AT_ONCE` samples; of fewer it has more."""


@pytree
class SampledInside(Sampled):
    """Events of a sample, with the states of the loop before and after it."""

    before: LoopState
    after: LoopState


class Accumulator(Protocol):
    """Reduction of the loop as it runs, in place of a trace; a pytree."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Any:
        """State at the start of the run."""

    def step(self, state: Any, happened: SampledInside, t_min: jax.Array) -> Any:
        """State after a sample, which was taken at the time `t_min`."""


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


@pytree
class _Carry:
    loop: LoopState
    gut: jax.Array | None
    """State of the gut; None where meals and guts are the same for all people."""
    accumulator: Any


@pytree
class _PersonValues:
    """Values that differ between people, people trailing."""

    plant: list[jax.Array]
    digestion: list[jax.Array]
    controller: list[jax.Array]
    sensor: list[jax.Array]
    pump: list[jax.Array]


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
        self._minute_inputs, self._stepped = tuple(minute_inputs), stepped
        refuse_minute_inputs(nominal, MinuteInputs(**{name: np.zeros(0) for name in self._minute_inputs}))
        self._records_decisions = record_decisions
        self._nominal, self._announced = nominal, announced
        self._warm_up, self._warm_up_min = grid.warm_up, grid.warm_up_min
        self._fold: Accumulator = _Counted(accumulator=accumulator) if self._warm_up else accumulator
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
            products=products,
        )
        self._single = Loop(
            plant=self._plants.single,
            controller=controller,
            sensor=sensor,
            pump=pump,
            setpoint_mg_dl=jnp.asarray(float(setpoint_mg_dl)),
            rescue=rescue and rescue.for_gut(eating.gut(nominal)),
            announced_in_min=None if announced_in_min is None else jnp.asarray(float(announced_in_min)),
        )
        self._varies = {
            "controller": varying(controller if varied_controller is None else varied_controller, controller),
            "sensor": varying(sensor if varied_sensor is None else varied_sensor, sensor),
            "pump": varying(pump if varied_pump is None else varied_pump, pump),
        }
        self._shared = {"moments": eating.moments, "t_min": grid.t_min, "told": eating.announced_by_sample}
        if start_min is not None:
            self._shared["time_of_day_min"] = (grid.start_min + grid.t_min) % MIN_PER_DAY
        if self._warm_up:
            self._shared["counted_min"] = grid.t_min - self._warm_up_min
        self._begin_people = jax.jit(jax.vmap(self._begin, in_axes=(-1, -1, 0, 0, 0), out_axes=(-1, 0)))
        self._end_people = jax.jit(jax.vmap(self._end, in_axes=-1))
        self._look_at_people = jax.jit(jax.vmap(self._look, in_axes=(-1, -1, 0, None)))
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

    def run(self, people: People, *, threads: int = 1) -> CohortRun:
        """Run the loop of some hundred to a few thousand people, so that they fit the caches.

        The result does not depend on the number of threads of native code.
        """
        pieces: list[tuple[Array, ...]] = []
        accumulator, end, lowest = self.follow(people, lambda *piece: pieces.append(piece), threads=threads)
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

    # one person

    def _loop(self, person: _PersonValues) -> Loop:
        """The loop with a person's own numbers in their places."""
        parts = {
            name: replaced(getattr(self._single, name), v, getattr(person, name)) for name, v in self._varies.items()
        }
        return dataclasses.replace(self._single, plant=self._plants.of(person.plant), **parts)

    def _end(self, person: _PersonValues, x: Any) -> tuple[jax.Array, jax.Array]:
        """Glucose of a state, and the lower end of the valid range of the model."""
        patient = self._loop(person).plant.patient
        return patient.glucose_mg_dl(x), jnp.asarray(lowest_valid_glucose_mg_dl(patient))

    def _begin(self, person: _PersonValues, x: Any, insulin: Any, announced: Any, key: Any) -> tuple[_Carry, jax.Array]:
        """State before the first sample, and the key of the person's readings."""
        loop = self._loop(person)
        times = self._shared.get("time_of_day_min")
        state, reading_key = begin(loop, x, insulin, announced, key, None if times is None else jnp.asarray(times[0]))
        glucose = loop.plant.patient.glucose_mg_dl(x)
        gut = self._eating.digestion.init() if self._eating.individual else None
        return _Carry(loop=state, gut=gut, accumulator=self._fold.init(glucose, insulin)), reading_key

    def _step(self, person: _PersonValues, carry: _Carry, reaching: Any, shared: Any, rng: Any) -> tuple[_Carry, Any]:
        """One sample: it outputs glucose and the delivered rate, and what is decided if it is asked for."""
        gut, inputs = carry.gut, {**shared, **reaching}
        moments = inputs["moments"]
        if gut is not None:
            own: Digestion = replaced(self._eating.digestion, self._eating.varies, person.digestion)
            with jax.named_scope("meals"):
                gut, moments = own.sample(gut, inputs["meals"])
        announced = inputs["told"] if self._announced else jnp.zeros(())
        (key, index), time = rng, inputs.get("time_of_day_min")
        minute_inputs = MinuteInputs(**{name: inputs[name] for name in self._minute_inputs})
        outside = Exogenous(t_min=inputs["t_min"], moments=moments, minute_inputs=minute_inputs)
        state, happened = sample(self._loop(person), carry.loop, outside, announced, key, index, time)
        with jax.named_scope("metrics"):
            patient = self._loop(person).plant.patient
            happened = dataclasses.replace(happened, basal_mU_min=jnp.asarray(patient.basal_insulin_mU_min))
            inside = SampledInside(**vars(happened), before=carry.loop, after=state)
            accumulator = self._fold.step(
                carry.accumulator, inside, inputs["counted_min" if self._warm_up else "t_min"]
            )
        outputs: tuple[Any, ...] = happened.glucose_mg_dl, happened.infused_mU_min
        if self._records_decisions:
            outputs += _or_nan(happened.reading), happened.decision.status, happened.delivery.reported_mU_min
        return _Carry(loop=state, gut=gut, accumulator=accumulator), outputs

    def _look(self, person: _PersonValues, carry: _Carry, key: Any, index: Any) -> tuple[jax.Array, jax.Array]:
        """Glucose, and the reading or NaN, at the coming sample."""
        loop = self._loop(person)
        _, reading, _ = look(loop, carry.loop, jnp.zeros(()), key, index)
        return loop.plant.patient.glucose_mg_dl(carry.loop.x), _or_nan(reading)

    def _step_apart(self, person: _PersonValues, carry: _Carry, reaching: Any, shared: Any, rng: Any) -> Any:
        """One sample of a person who is stepped; it outputs what is seen at its end."""
        # Native code takes what depends on the person alone out of the loop, and would round a dose there differently.
        requested, own = reaching["asked"], person.controller[len(reaching["asked"]) :]
        person = dataclasses.replace(person, controller=[*requested, *own])
        after, outputs = self._step(person, carry, reaching, shared, rng)
        with jax.named_scope("sensor"):
            glucose, reading = self._look(person, after, rng[0], rng[1] + 1)
        return after, (glucose, reading, outputs[1])

    def _make_engine(self, name: str | None, precision: str, products: str) -> Engine:
        parts = {name: chosen(getattr(self._single, name), varies) for name, varies in self._varies.items()}
        numbers = chosen(self._eating.digestion, self._eating.varies)
        person = _PersonValues(plant=self._plants.values_of_nominal(), digestion=numbers, **parts)
        insulin = self._nominal.basal_insulin_mU_min
        rest = self._nominal.steady_state(insulin)
        carry, key = jax.eval_shape(self._begin, person, rest, insulin, jnp.zeros(()), jax.random.key(0))
        reaching: dict[str, Any] = {name: np.zeros(self._grid.inside_min.size) for name in self._minute_inputs}
        if self._eating.individual:
            reaching["meals"] = np.zeros(self._eating.digestion.inputs)
        if self._eating.announced_each:
            reaching["told"] = np.zeros(())
        shared = {name: values[0] for name, values in self._shared.items()}
        if self._stepped:
            external = self._single.controller
            requested = parts["controller"][: 1 + gives_boluses(external) + gives_glucagon(external)]
            reaching, shared = {**shared, **reaching, "asked": requested}, {}
        try:
            return make_engine(
                self._step_apart if self._stepped else self._step,
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
            raise ArgumentTypeError(needs_values(type(self._single.controller).__name__, error)) from None

    # many people

    def _values_of(self, people: People) -> _PersonValues:
        """Values that differ between people."""

        def part(name: str) -> list[jax.Array]:
            brought = getattr(people, name)
            return chosen(getattr(self._single, name) if brought is None else brought, self._varies[name])

        return _PersonValues(
            plant=self._plants.values_of(people.patient),
            digestion=self._eating.values_of(people.patient),
            controller=part("controller"),
            sensor=part("sensor"),
            pump=part("pump"),
        )

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


def _or_nan(reading: Reading) -> jax.Array:
    return jnp.where(reading.valid, reading.glucose_mg_dl, jnp.nan)
