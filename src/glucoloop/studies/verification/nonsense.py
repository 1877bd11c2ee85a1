"""Nonsense test: guarded controllers without a patient, which are given arbitrary inputs, with every promise checked.

Readings, setpoints, meals and requests are anything. The pump gives what it is asked for, and at times reports
something else: nothing possible, too little, too much, or what it gave in the sample before. In every other loop single
words of the memory are overwritten.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.control import Controller, Decision, Observation, guarded
from glucoloop.control.guard_settings import guard_of
from glucoloop.control.protocol import gives_boluses
from glucoloop.metrics.promises import OF_CONTROLLER, ROUNDING, Caps, Counted, breaches, promises_of_controller
from glucoloop.simulation.engines import NativeEngine
from glucoloop.situations.situation import Situation, configured
from glucoloop.studies.verification import NONSENSE_SAMPLES, Verification
from glucoloop.studies.verification.campaign import LISTED, Floats, Numbers, Progress, catalogue_controller
from glucoloop.threefry import uniforms
from glucoloop.trials.people import block_size, in_blocks

_BOLUS_OF_RATE_MIN: Final = 60.0
"""A bolus that is requested or reported at will is an hour of the rate that is."""
_ANY_BOLUS_MU: Final = sys.float_info.max
"""A guard does not know the largest bolus of a pump, so that a bolus has only to be a number from 0 on."""
_NONSENSE: Final = np.array(
    [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-3, 0.5, 1.0, 1e5, -1e5, 1e18, 1e300, -1e300, 1.7e308]
)
_READINGS: Final = np.array([np.nan, np.inf, -np.inf, 0.0, 19.9, 20.0, 31.0, 64.9, 81.0, 128.0, 400.0, 600.0, 1e300])
_PARTS: Final = np.array([0.0, 0.0, 0.1, 0.5, 0.9, 1.0, 1.5, 2.0])
"""Parts of what a pump gave that it reports."""
_WANDER_MG_DL_MIN: Final = 12.0


@pytree
class _Wilful:
    """A controller that requests an arbitrary rate at times, and an arbitrary bolus if it gives boluses."""

    inner: Controller
    asks: jax.Array
    wilful: jax.Array

    @property
    def gives_boluses(self) -> bool:
        return gives_boluses(self.inner)

    @property
    def sample_time_min(self) -> float:
        return self.inner.sample_time_min

    @property
    def heals(self) -> bool:
        return bool(getattr(self.inner, "heals", False))

    def init(self, observation: Observation) -> Any:
        return self.inner.init(observation)

    def step(self, state: Any, observation: Observation) -> tuple[Any, Decision]:
        state, decision = self.inner.step(state, observation)
        rate, bolus = _at_will(self.wilful, self.asks, decision.insulin_mU_min, decision.bolus_mU)
        return state, Decision(insulin_mU_min=rate, status=decision.status, bolus_mU=bolus)


def _at_will(
    wilful: jax.Array, dose: jax.Array, rate: jax.Array, bolus: jax.Array | None
) -> tuple[jax.Array, jax.Array | None]:
    """A rate and, if there is one, a bolus, with an arbitrary dose in their place where `wilful` is 1."""
    if bolus is not None:
        bolus = jnp.where(wilful > 0.5, _BOLUS_OF_RATE_MIN * dose, bolus)
    return jnp.where(wilful > 0.5, dose, rate), bolus


@pytree
class _Dose:
    """Dose that the pump gave in a sample, which is the requested one."""

    rate_mU_min: jax.Array
    bolus_mU: jax.Array | None
    """Bolus of the sample; None for a controller without boluses."""

    def reported(self, before: _Dose, inputs: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array | None]:
        """Report of the pump: the dose, a part of it or of the dose before, or anything."""
        late = inputs["late"] > 0.5
        rate = inputs["rate_part"] * jnp.where(late, before.rate_mU_min, self.rate_mU_min)
        bolus = self.bolus_mU
        if bolus is not None and before.bolus_mU is not None:
            bolus = inputs["bolus_part"] * jnp.where(late, before.bolus_mU, bolus)
        return _at_will(inputs["misreported"], inputs["delivered"], rate, bolus)


@pytree
class _Carry:
    guard: Any
    counted: Counted
    dose: _Dose
    dose_before: _Dose
    whole: jax.Array
    """Indicator, 1 while no word of the memory was overwritten."""
    broken: jax.Array
    """(promises,) number of samples at which each was broken."""


class _Loops:
    """The loops of one guarded controller; each is a function of the seed and its number alone."""

    def __init__(self, name: str, config: Verification, sample_time_min: float, precision: str) -> None:
        situation = configured(Situation, patient=config.patient, sample_time_min=sample_time_min)
        self._seed, self._setpoint, self._every = config.seed, situation.target_mg_dl, sample_time_min
        self._limits, self._rounding = situation.limits, ROUNDING[precision]
        controller = catalogue_controller(name, config.patient, sample_time_min)
        self._guard = guarded(controller, guard_of(situation.patient), self._limits)
        self._caps = Caps(
            settings=self._guard.settings,
            limits=self._limits,
            sample_time_min=sample_time_min,
            rounding=self._rounding,
        )
        first = self._begin(jnp.asarray(20.0))
        self._memory_words = sum(np.size(leaf) for leaf in jax.tree.leaves(first.guard))
        inputs = {key: jnp.asarray(values[0, 0]) for key, values in self._inputs(np.zeros(1, np.int64)).items()}
        self._engine = NativeEngine(
            self._step,
            (jnp.asarray(20.0), first, inputs, jnp.zeros(()), jax.random.key(0)),
            precision,
        )
        self._begin_all = jax.jit(jax.vmap(self._begin, in_axes=-1, out_axes=-1))

    def broken(self, loop: Numbers, progress: Progress) -> Floats:
        """(promises, n) number of samples at which each promise was broken."""
        return np.concatenate(in_blocks(self._block, loop, block_size("native"), done=progress), axis=1)

    def _block(self, loop: Numbers, n: int) -> Floats:
        basal = jnp.asarray(2.0 + 58.0 * uniforms(self._seed, "basal", loop))
        carry, keys = self._begin_all(basal), jax.random.split(jax.random.key(0), loop.size)
        with np.errstate(over="ignore"):  # a number too large for single precision is infinite there
            inputs = {name: values.astype(self._engine.precision) for name, values in self._inputs(loop).items()}
        last, _ = self._engine.run(basal, carry, inputs, np.zeros(NONSENSE_SAMPLES), keys)
        broken: Floats = np.asarray(last.broken)[:, :n]
        return broken

    def _begin(self, basal_mU_min: jax.Array) -> _Carry:
        no_bolus = jnp.zeros(()) if self._guard.gives_boluses else None
        observation = Observation(
            glucose_mg_dl=jnp.asarray(self._setpoint),
            valid=jnp.asarray(True),
            setpoint_mg_dl=jnp.asarray(self._setpoint),
            delivered_mU_min=basal_mU_min,
            announced_carbs_g=jnp.zeros(()),
            delivered_bolus_mU=no_bolus,
        )
        basal = _Dose(rate_mU_min=basal_mU_min, bolus_mU=no_bolus)
        return _Carry(
            guard=self._guard.with_basal(basal_mU_min).init(observation),
            counted=self._caps.init(basal_mU_min),
            dose=basal,
            dose_before=basal,
            whole=jnp.ones(()),
            broken=jnp.zeros(len(OF_CONTROLLER)),
        )

    def _step(self, basal: jax.Array, carry: _Carry, inputs: Any, _: Any, rng: Any) -> tuple[_Carry, jax.Array]:
        del rng
        guard = self._guard.with_basal(basal)
        wilful = _Wilful(inner=guard.inner, asks=inputs["asks"], wilful=inputs["wilful"])
        rate, bolus = carry.dose.reported(carry.dose_before, inputs)
        observation = Observation(
            glucose_mg_dl=inputs["reading"],
            valid=inputs["valid"] > 0.5,
            setpoint_mg_dl=inputs["setpoint"],
            delivered_mU_min=rate,
            announced_carbs_g=inputs["carbs"],
            delivered_bolus_mU=bolus,
        )
        memory = _overwritten(carry.guard, inputs["word"], inputs["value"])
        state, decision = dataclasses.replace(guard, inner=wilful).step(memory, observation)
        dose = _Dose(rate_mU_min=decision.insulin_mU_min, bolus_mU=decision.bolus_mU)
        counted, within_caps = self._caps.step(carry.counted, rate, dose.rate_mU_min, bolus, dose.bolus_mU)
        whole = jnp.where(inputs["word"] >= 0.0, 0.0, carry.whole)
        within_caps = within_caps | (whole < 0.5)
        fulfilled = promises_of_controller(
            self._limits,
            _ANY_BOLUS_MU,
            decision,
            rate,
            carry.dose.rate_mU_min,
            state,
            within_caps,
            self._rounding,
        )
        return _Carry(
            guard=state,
            counted=counted,
            dose=dose,
            dose_before=carry.dose,
            whole=whole,
            broken=carry.broken + breaches(fulfilled),
        ), dose.rate_mU_min

    def _inputs(self, loop: Numbers) -> dict[str, Floats]:
        """Inputs of each loop at each sample, ``(samples, n)`` each."""

        def drawn(name: str) -> Floats:
            return np.stack([uniforms(self._seed, name, loop, k) for k in range(NONSENSE_SAMPLES)])

        def anything(name: str, values: Floats) -> Floats:
            chosen: Floats = values[np.floor(drawn(name) * values.size).astype(int)]
            return chosen

        which, much = drawn("which reading"), drawn("how much")
        wild = uniforms(self._seed, "wild", loop)
        wander = 120.0 + np.cumsum(_WANDER_MG_DL_MIN * self._every * wild * (much - 0.5), axis=0)
        reading = np.where(which < 0.3 * wild, anything("reading", _READINGS), wander)
        reading = np.where((which > 0.9) & (wild > 0.5), 700.0 * much, reading)
        highest = float(self._limits.max_mU_min)
        of_pump, given = drawn("which rate"), drawn("rate")
        delivered = np.where(
            of_pump < 0.5, 0.0, np.where(of_pump < 0.9, 2.1 * highest * given, anything("report", _NONSENSE))
        )
        # the pumps of half of the loops report the truth, but for nonsense at times in half of them
        lies, false = loop % 4 >= 2, uniforms(self._seed, "false", loop)
        is_false = lies & (drawn("whether false") < false)
        # one part in some loops, another one at each sample in the others
        lasting = uniforms(self._seed, "lasting", loop) < 0.5

        def part(name: str) -> Floats:
            same = _PARTS[np.floor(uniforms(self._seed, f"lasting {name}", loop) * _PARTS.size).astype(int)]
            return np.where(is_false, np.where(lasting, same, anything(name, _PARTS)), 1.0)

        others, memory = drawn("what else"), drawn("memory")
        lost = (memory < 0.05) & (loop % 2 == 1)
        return {
            "reading": reading,
            "valid": np.where(drawn("valid") < 0.95, 1.0, 0.0),
            "setpoint": np.where(others < 0.9, self._setpoint, anything("setpoint", _NONSENSE)),
            "carbs": np.where(others > 0.1, 0.0, anything("meal", _NONSENSE)),
            "misreported": np.where((drawn("as asked") < 0.97) | ~lies, 0.0, 1.0),
            "delivered": delivered,
            "rate_part": part("part of the rate"),
            "bolus_part": part("part of the bolus"),
            "late": np.where(is_false & (drawn("late") < 0.2), 1.0, 0.0),
            "asks": np.where(given < 0.2, anything("asks", _NONSENSE), 3.0 * highest * given),
            "wilful": np.where(uniforms(self._seed, "wilful", loop) < 0.5, 1.0, 0.0) * np.ones_like(given),
            "word": np.where(lost, np.floor(memory * 20.0 * self._memory_words), -1.0),
            "value": anything("value", _NONSENSE),
        }


def _overwritten(state: Any, word: jax.Array, value: jax.Array) -> Any:
    """A state with one of its words replaced; unchanged for a word below 0."""
    leaves, structure = jax.tree.flatten(state)
    first, new = 0, []
    for leaf in map(jnp.asarray, leaves):
        number = first + jnp.arange(leaf.size).reshape(leaf.shape)
        new.append(jnp.where(word == number, value.astype(leaf.dtype), leaf))
        first += leaf.size
    return jax.tree.unflatten(structure, new)


def run_nonsense(config: Verification, progress: Progress, done: int = 0) -> Iterator[dict[str, dict[str, Any]]]:
    """The loops of each guarded controller at each sample time and precision as plain values, each an ``arm``.

    The first `done` of them are left out.
    """
    position = 0
    for name, number in config.people().items():
        loop = np.arange(number) if config.person is None else np.array([config.person])
        for sample_time_min, precision in config.guard_timings():
            position += 1
            if position <= done:
                continue
            samples = _Loops(name, config, sample_time_min, precision).broken(loop, progress)
            broken = dict(zip(OF_CONTROLLER, samples > 0, strict=True))
            yield {
                "arm": {
                    "controller": name,
                    "sample_time_min": sample_time_min,
                    "precision": precision,
                    "loops": loop.size,
                    "samples": NONSENSE_SAMPLES * loop.size,
                    "broken": {promise: int(where.sum()) for promise, where in broken.items()},
                    "examples": {promise: loop[where][:LISTED].tolist() for promise, where in broken.items()},
                }
            }
