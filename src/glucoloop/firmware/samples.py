"""Recorded samples: observations of a closed loop with faults, then absurd ones, and the controller's decisions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.build.surroundings import surroundings_of
from glucoloop.control.protocol import Controller, Decision, Observation, gives_boluses
from glucoloop.faults import FAULTS
from glucoloop.firmware.exported import Exported
from glucoloop.native.interpreter import Interpreter
from glucoloop.simulation.stepper import Stepper
from glucoloop.situations.situation import Situation

Leaves = list[npt.NDArray[Any]]
Step = Callable[[Sequence[Any], Sequence[Any]], tuple[Leaves, Leaves]]
Init = Callable[[Sequence[Any]], Leaves]

_FAULTS: Final = (
    "missing, per_day=10, duration_min=25",
    "spikes, per_day=10, size_mg_dl=60",
    "stuck, per_day=4, duration_min=40",
    "nonsense, per_day=6, value=0",
    "occlusion, per_day=3, duration_min=30",
    "battery, per_day=3, duration_min=20",
)
"""Faults of sensor and pump in the closed loop, in the order in which they wrap them."""
_MEALS_A_SAMPLE: Final = 0.02
_ABSURD: Final = (np.nan, np.inf, -np.inf, 3e38, -3e38, 0.0, -1.0, 1e-42)
_ABSURD_SHARE: Final = 6
"""Number of samples of which one is absurd, at the end of a record."""


@dataclass(frozen=True)
class SampleRecord:
    """Samples of one or more runs; within a run the state passes from each sample to the next."""

    observations: list[Leaves]
    states: list[Leaves]
    """States before the samples."""
    decisions: list[Leaves]
    run: int
    """Number of samples of a run, after which the controller is initialised again."""

    def wrong_decision(self, init: Init, step: Step) -> int | None:
        """First sample at which another implementation decides otherwise in a bit; None if there is none."""
        starts = range(0, len(self.observations), self.run)
        _, decisions = replayed(self.observations, init, step, starts)
        pairs = zip(self.decisions, decisions, strict=True)
        return next((i for i, (ours, theirs) in enumerate(pairs) if not equal(ours, theirs)), None)

    def wrong_step(self, init: Init, step: Step, samples: int | None = None) -> int | None:
        """First sample at which another implementation gives another decision or state; None if there is none.

        So many samples are computed, spread over the record; all by default.
        """
        last = len(self.observations) - 1
        for i in range(last + 1) if samples is None else _spread(samples, last):
            if i % self.run == 0 and not equal(init(self.observations[i]), self.states[i]):
                return i
            after, decided = step(self.states[i], self.observations[i])
            continues = i < last and (i + 1) % self.run
            if not equal(decided, self.decisions[i]) or (continues and not equal(after, self.states[i + 1])):
                return i
        return None


def _spread(number: int, last: int) -> list[int]:
    """Places from 0 to the last one, at most so many, at distances as equal as can be."""
    return sorted({round(place) for place in np.linspace(0, last, min(number, last + 1))})


def joined(records: Sequence[SampleRecord]) -> SampleRecord:
    """Records of equally long runs, one after another."""
    (run,) = {record.run for record in records}
    return SampleRecord(
        observations=[leaves for record in records for leaves in record.observations],
        states=[leaves for record in records for leaves in record.states],
        decisions=[leaves for record in records for leaves in record.decisions],
        run=run,
    )


def equal(ours: Sequence[Any], theirs: Sequence[Any]) -> bool:
    """Whether all arrays have the same bits."""
    return all(_same(a, b) for a, b in zip(ours, theirs, strict=True))


def _same(a: Any, b: Any) -> bool:
    """Whether two arrays have the same bits; NaN equals NaN."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return bool(np.all((a == b) & (np.signbit(a) == np.signbit(b)) | (a != a) & (b != b)))


def arithmetic(exported: Exported) -> tuple[Init, Step]:
    """Init and step as the form defines them, in NumPy."""
    leaves = len(jax.tree.leaves(exported.traced.state))
    if exported.source.lowered is None:
        first, each = exported.meaning()

        def of_compact(state: Sequence[Any], observation: Sequence[Any]) -> tuple[Leaves, Leaves]:
            results = each([*state, *observation])
            return results[:leaves], results[leaves:]

        return lambda observation: list(first(observation)), of_compact
    return by_columns(exported, *map(Interpreter, exported.source.lowered))


def by_columns(exported: Exported, first: Callable[..., Any], each: Callable[..., Any]) -> tuple[Init, Step]:
    """Init and step by functions of columns of numbers, `carry` and `own`, such as an `Interpreter`."""
    records = exported.source.records

    def column(values: Sequence[Any]) -> npt.NDArray[Any]:
        flat = [np.ravel(value).astype(exported.precision) for value in values]
        return np.concatenate([*flat, np.zeros(0, exported.precision)])[:, None]

    def split(rows: npt.NDArray[Any], name: str) -> Leaves:
        ends = np.cumsum([field.size for field in records[name].fields])
        return [
            rows[end - field.size : end, 0].reshape(field.shape)
            for end, field in zip(ends, records[name].fields, strict=True)
        ]

    def init(observation: Sequence[Any]) -> Leaves:
        return split(first(own=column(observation))[1], "state")

    def step(state: Sequence[Any], observation: Sequence[Any]) -> tuple[Leaves, Leaves]:
        after, decided = each(carry=column(state), own=column(observation))
        return split(after, "state"), split(decided, "decision")

    return init, step


def example(controller: Controller, stepper: Stepper) -> Observation:
    """Example of the controller's observation."""
    observation = stepper.observation()
    if gives_boluses(controller) and observation.delivered_bolus_mU is None:
        observation = dataclasses.replace(observation, delivered_bolus_mU=jnp.zeros(()))
    return observation


def stepper_of(situation: Situation, seed: int) -> Stepper:
    """The patient with faulty sensor and pump."""
    surroundings = surroundings_of(situation, [FAULTS.choose(text) for text in _FAULTS])
    return Stepper(
        situation.nominal,
        surroundings.sensor,
        surroundings.pump,
        sample_time_min=situation.sample_time_min,
        setpoint_mg_dl=situation.target_mg_dl,
        allow_unusual=True,
        key=seed,
        meal_model=situation.gut,
        start_min=situation.start_min,
        rhythms=situation.rhythms,
        rhythm_seed=seed if situation.rhythms else 0,
        announced_in_min=situation.announce_before_min or None,
    )


def record(
    exported: Exported, controller: Controller, situation: Situation, init: Init, step: Step, *, samples: int, seed: int
) -> SampleRecord:
    """Run the loop of a controller with faults, decided by `init` and `step`, and give it absurd numbers at the end."""
    stepper, rng = stepper_of(situation, seed), np.random.default_rng(seed)
    observation = example(controller, stepper)
    observations: list[Leaves] = []
    states: list[Leaves] = []
    decisions: list[Leaves] = []
    state: Leaves = []
    for i in range(samples):
        leaves = leaves_of(observation, exported)
        if i >= samples - samples // _ABSURD_SHARE:
            leaves = [_absurd(leaf, rng) for leaf in leaves]
        state = state if i else init(leaves)
        states.append(state)
        state, decided = step(state, leaves)
        observations.append(leaves)
        decisions.append(decided)
        decision = decision_of(decided, exported)
        carbs = float(rng.uniform(10.0, 80.0)) if rng.random() < _MEALS_A_SAMPLE else 0.0
        bolus = None if decision.bolus_mU is None else float(decision.bolus_mU)
        observation = stepper.step(float(decision.insulin_mU_min), carbs, bolus)
        if situation.announce_meals:
            observation = dataclasses.replace(observation, announced_carbs_g=jnp.asarray(carbs))
    return SampleRecord(observations, states, decisions, samples)


def replayed(
    observations: Sequence[Leaves], init: Init, step: Step, starts: Sequence[int]
) -> tuple[list[Leaves], list[Leaves]]:
    """States before, and decisions on, observations; the controller is initialised at the samples in `starts`."""
    state: Leaves = []
    states, decisions = [], []
    for i, observation in enumerate(observations):
        state = init(observation) if i in starts else state
        states.append(state)
        state, decided = step(state, observation)
        decisions.append(decided)
    return states, decisions


def decision_of(leaves: Leaves, exported: Exported) -> Decision:
    """Decision of its leaves."""
    decision: Decision = jax.tree.unflatten(jax.tree.structure(exported.traced.decision), leaves)
    return decision


def leaves_of(observation: Observation, exported: Exported) -> Leaves:
    """Leaves of an observation in the precision of a controller."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(observation)]
    return [leaf.astype(exported.precision) if leaf.dtype != bool else leaf for leaf in leaves]


def _absurd(leaf: npt.NDArray[Any], rng: np.random.Generator) -> npt.NDArray[Any]:
    """A number as it is, or an absurd one such as may come over a wire."""
    if leaf.dtype == bool:
        return np.asarray(bool(rng.random() < 0.8))
    if rng.random() < 0.5:
        return leaf
    with np.errstate(over="ignore"):
        return np.asarray(rng.choice(_ABSURD)).astype(leaf.dtype)
