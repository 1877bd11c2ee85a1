"""Loop of one person of a cohort, as a value: all that the program of a sample is made of."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from glucoloop._pytree import chosen, pytree, replaced, static
from glucoloop.meals.absorption import Digestion
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl
from glucoloop.sensors import Reading
from glucoloop.simulation.loop import Loop, LoopState, Sampled, begin, look, sample
from glucoloop.simulation.plant import Exogenous, MinuteInputs


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


@pytree
class PersonCarry:
    """State that is passed from sample to sample."""

    loop: LoopState
    gut: jax.Array | None
    """State of the gut; None where meals and guts are the same for all people."""
    accumulator: Any


@pytree
class PersonValues:
    """Numbers in which people differ, as lists of leaves of each part."""

    plant: list[jax.Array]
    digestion: list[jax.Array]
    controller: list[jax.Array]
    sensor: list[jax.Array]
    pump: list[jax.Array]


@pytree
class PersonLoop:
    """Loop of one person of a cohort; it has all that is the same for everybody, and methods take what is not.

    It is all that the program of a sample is made of, so that one that is kept can be named by it.
    """

    loop: Loop
    """Loop of the nominal patient."""
    digestion: Digestion
    fold: Accumulator
    varies: tuple[tuple[bool, ...], ...] = static()
    """Whether each leaf of plant, digestion, controller, sensor and pump differs between people."""
    own_gut: bool = static()
    """Whether each person has a gut in the loop."""
    announced: bool = static()
    warm_up: bool = static()
    records_decisions: bool = static()
    minute_inputs: MinuteInputs
    """Inputs of people that are constant over a minute, an example."""
    start_time_of_day_min: jax.Array | None
    """Time of day at the first sample, where controllers are told it."""

    def values(self, loop: Loop, digestion: Digestion) -> PersonValues:
        """Numbers in which people differ, of a loop and a gut of one or of many."""
        parts = {**vars(loop), "digestion": digestion}
        names = [field.name for field in dataclasses.fields(PersonValues)]
        return PersonValues(**{name: chosen(parts[name], self.varies_in(name)) for name in names})

    def varies_in(self, part: str) -> tuple[bool, ...]:
        """Whether each leaf of a part differs between people."""
        return dict(zip((field.name for field in dataclasses.fields(PersonValues)), self.varies, strict=True))[part]

    def of(self, person: PersonValues) -> Loop:
        """The loop with a person's own numbers in their places."""
        parts = {
            name: replaced(getattr(self.loop, name), self.varies_in(name), getattr(person, name))
            for name in ("plant", "controller", "sensor", "pump")
        }
        return dataclasses.replace(self.loop, **parts)

    def begin(
        self, person: PersonValues, x: Any, insulin: Any, announced: Any, key: Any
    ) -> tuple[PersonCarry, jax.Array]:
        """State before the first sample, and the key of the person's readings."""
        loop = self.of(person)
        state, reading_key = begin(loop, x, insulin, announced, key, self.start_time_of_day_min)
        glucose = loop.plant.patient.glucose_mg_dl(x)
        gut = self.digestion.init() if self.own_gut else None
        return PersonCarry(loop=state, gut=gut, accumulator=self.fold.init(glucose, insulin)), reading_key

    def step(
        self, person: PersonValues, carry: PersonCarry, reaching: Any, shared: Any, rng: Any
    ) -> tuple[PersonCarry, Any]:
        """One sample: it outputs glucose and the delivered rate, and what is decided if it is asked for."""
        gut, inputs = carry.gut, {**shared, **reaching}
        moments = inputs["moments"]
        if gut is not None:
            own: Digestion = replaced(self.digestion, self.varies_in("digestion"), person.digestion)
            with jax.named_scope("meals"):
                gut, moments = own.sample(gut, inputs["meals"])
        announced = inputs["told"] if self.announced else jnp.zeros(())
        (key, index), time = rng, inputs.get("time_of_day_min")
        minute_inputs = MinuteInputs(**{name: inputs[name] for name in self.minute_inputs.names})
        outside = Exogenous(t_min=inputs["t_min"], moments=moments, minute_inputs=minute_inputs)
        loop = self.of(person)
        state, happened = sample(loop, carry.loop, outside, announced, key, index, time)
        with jax.named_scope("metrics"):
            basal = jnp.asarray(loop.plant.patient.basal_insulin_mU_min)
            happened = dataclasses.replace(happened, basal_mU_min=basal, carbs_g=inputs.get("eaten"))
            inside = SampledInside(**vars(happened), before=carry.loop, after=state)
            accumulator = self.fold.step(carry.accumulator, inside, inputs["counted_min" if self.warm_up else "t_min"])
        outputs: tuple[Any, ...] = happened.glucose_mg_dl, happened.infused_mU_min
        if self.records_decisions:
            outputs += _or_nan(happened.reading), happened.decision.status, happened.delivery.reported_mU_min
        return PersonCarry(loop=state, gut=gut, accumulator=accumulator), outputs

    def look(self, person: PersonValues, carry: PersonCarry, key: Any, index: Any) -> tuple[jax.Array, jax.Array]:
        """Glucose, and the reading or NaN, at the coming sample."""
        loop = self.of(person)
        _, reading, _ = look(loop, carry.loop, jnp.zeros(()), key, index)
        return loop.plant.patient.glucose_mg_dl(carry.loop.x), _or_nan(reading)

    def end(self, person: PersonValues, x: Any) -> tuple[jax.Array, jax.Array]:
        """Glucose of a state, and the lower end of the valid range of the model."""
        patient = self.of(person).plant.patient
        return patient.glucose_mg_dl(x), jnp.asarray(lowest_valid_glucose_mg_dl(patient))


@pytree
class WholeRun:
    """The step of a loop that runs by itself, for `engines`."""

    one: PersonLoop

    def __call__(self, person: PersonValues, carry: PersonCarry, reaching: Any, shared: Any, rng: Any) -> Any:
        """Carry one person through one sample."""
        return self.one.step(person, carry, reaching, shared, rng)


@pytree
class SteppedRun:
    """The step of a loop that is advanced from outside: it outputs what is seen at the end of a sample."""

    one: PersonLoop

    def __call__(self, person: PersonValues, carry: PersonCarry, reaching: Any, shared: Any, rng: Any) -> Any:
        """One sample, with doses that reach the person."""
        # Native code takes what depends on the person alone out of the loop, and would round a dose there differently.
        requested, own = reaching["asked"], person.controller[len(reaching["asked"]) :]
        person = dataclasses.replace(person, controller=[*requested, *own])
        after, outputs = self.one.step(person, carry, reaching, shared, rng)
        with jax.named_scope("sensor"):
            glucose, reading = self.one.look(person, after, rng[0], rng[1] + 1)
        return after, (glucose, reading, outputs[1])


def _or_nan(reading: Reading) -> jax.Array:
    return jnp.where(reading.valid, reading.glucose_mg_dl, jnp.nan)
