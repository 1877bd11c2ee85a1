"""Nonsense test: guarded controllers with arbitrary inputs and corrupted memory, without a patient.

In each loop readings wander or are arbitrary; at times the setpoint, the meal, the rate that the pump reports and the
rate that the inner controller asks for are arbitrary too. In every other loop single words of the memory are
overwritten as well, those of the guard and those of the inner controller. A loop is a function of the seed and its
number alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.cohorts.blocks import block_size, in_blocks
from glucoloop.control import Controller, Decision, Observation, Status, guarded
from glucoloop.control.catalogue import CONTROLLERS, controller_entry
from glucoloop.control.protocol import gives_boluses
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.refusal import Refusal
from glucoloop.simulation.engines import NativeEngine
from glucoloop.situations.situation import usual_situation
from glucoloop.studies.verification import MOST_SAMPLES
from glucoloop.studies.verification.campaign import catalogue_controller
from glucoloop.studies.verification.caps import Caps, Counted
from glucoloop.studies.verification.invariants import CAPS, COMMAND, CONTROLLER, RATE, STATUS
from glucoloop.studies.verification.watched import all_finite
from glucoloop.threefry import checked_counter, uniforms

Array = npt.NDArray[Any]
Progress = Callable[[int], None]
"""Callback with each number of finished loops."""

SAMPLES: Final = 96
"""Number of samples of a loop."""
QUICK: Final = tuple(name for name, entry in CONTROLLERS.items() if not entry.slow)
PROMISES: Final = (COMMAND, RATE, STATUS, CONTROLLER, CAPS)
_TOLD: Final = 10
"""Number of broken loops that are listed for each promise and controller."""
_ROUNDING_MU_MIN: Final = 1e-9
_BOLUS_OF_RATE_MIN: Final = 60.0
"""A bolus that is asked for or reported at will is an hour of the rate that is."""
_NONSENSE: Final = np.array(
    [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-3, 0.5, 1.0, 1e5, -1e5, 1e18, 1e300, -1e300, 1.7e308]
)
_READINGS: Final = np.array([np.nan, np.inf, -np.inf, 0.0, 19.9, 20.0, 31.0, 64.9, 81.0, 128.0, 400.0, 600.0, 1e300])


@dataclass(frozen=True)
class NonsenseCheck:
    """Definition of a nonsense test.

    Raises
    ------
    ValueError
        For a number out of bounds, or an unknown controller.
    """

    samples: int = 100_000_000
    """Smallest number of samples, of all controllers together."""
    seed: int = 1
    controllers: tuple[str, ...] = QUICK
    loop: int | None = None
    """Number of a single loop, or None for as many loops as necessary."""

    def __post_init__(self) -> None:
        if isinstance(self.samples, bool) or not isinstance(self.samples, int) or not 1 <= self.samples <= MOST_SAMPLES:
            raise Refusal(f"samples is {self.samples!r}; give a whole number from 1 to {MOST_SAMPLES}")
        checked_counter("seed", self.seed)
        if self.loop is not None:
            checked_counter("loop", self.loop)
        if not self.controllers:
            raise Refusal(f"there is no controller to try; give at least one of {', '.join(QUICK)}")
        for name in self.controllers:
            if controller_entry(name).slow:
                raise Refusal(f"{name} takes too long for nonsense in masses; give some of {', '.join(QUICK)}")

    @property
    def loops(self) -> int:
        """Number of loops of each controller."""
        return 1 if self.loop is not None else math.ceil(self.samples / (SAMPLES * len(self.controllers)))


@dataclass(frozen=True)
class NonsenseArm:
    """The loops of one guarded controller."""

    controller: str
    loops: int
    broken: Mapping[str, int]
    """Number of loops in which each promise was broken."""
    told: Mapping[str, tuple[int, ...]]
    """Numbers of the first loops that broke each promise."""


@dataclass(frozen=True)
class NonsenseResult:
    """Results by controller."""

    seed: int
    arms: tuple[NonsenseArm, ...]
    interrupted: bool = False

    @property
    def samples(self) -> int:
        """Number of checked samples."""
        return SAMPLES * sum(arm.loops for arm in self.arms)

    @property
    def violations(self) -> dict[str, int]:
        """Number of loops in which each promise was broken, over all controllers."""
        return {promise: sum(arm.broken[promise] for arm in self.arms) for promise in PROMISES}

    @property
    def holds(self) -> bool:
        """Whether no promise was broken."""
        return not any(self.violations.values())


@pytree
class _Wilful:
    """A controller that asks for an arbitrary rate at times, and an arbitrary bolus if it gives boluses."""

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
        asked, bolus = jax.tree.map(
            lambda dose, factor: jnp.where(self.wilful > 0.5, factor * self.asks, dose),
            (decision.insulin_mU_min, decision.bolus_mU),
            (1.0, None if decision.bolus_mU is None else _BOLUS_OF_RATE_MIN),
        )
        return state, Decision(insulin_mU_min=asked, status=decision.status, bolus_mU=bolus)


@pytree
class _Carry:
    guard: Any
    counted: Counted
    asked_mU_min: jax.Array
    asked_bolus_mU: jax.Array | None
    """Bolus that was asked for, or None for a controller without boluses."""
    whole: jax.Array
    """Indicator, 1 while no word of the memory was overwritten."""
    broken: jax.Array
    """(promises,) number of samples at which each was broken."""


class _Loops:
    """The loops of one guarded controller."""

    def __init__(self, name: str, seed: int) -> None:
        self._seed, limits = seed, PARKER_1999_LIMITS
        guard = guarded(catalogue_controller(name), limits=limits)
        self._guard, self._caps = guard, Caps(settings=guard.settings, limits=limits, boluses=guard.gives_boluses)
        self._no_bolus = jnp.zeros(()) if guard.gives_boluses else None
        self._setpoint = usual_situation().target_mg_dl
        self.words = sum(np.size(leaf) for leaf in jax.tree.leaves(self._begin(jnp.asarray(20.0)).guard))
        told = self._told(np.zeros(1, np.int64))
        example = {key: jnp.asarray(values[0, 0]) for key, values in told.items()}
        self._engine = NativeEngine(
            self._step,
            (jnp.asarray(20.0), self._begin(jnp.asarray(20.0)), example, jnp.zeros(()), jax.random.key(0)),
            "float64",
        )
        self._begin_all = jax.jit(jax.vmap(self._begin, in_axes=-1, out_axes=-1))

    def broken(self, loop: npt.NDArray[np.int64], progress: Progress | None) -> Array:
        """(promises, n) number of samples at which each promise was broken."""
        parts: list[Array] = []
        size = block_size("native")
        for start in range(0, loop.size, 4 * size):
            chunk = loop[start : start + 4 * size]
            parts += in_blocks(self._block, chunk, size)
            if progress is not None:
                progress(chunk.size)
        return np.concatenate(parts, axis=1)

    def _block(self, loop: npt.NDArray[np.int64], n: int) -> Array:
        basal = jnp.asarray(2.0 + 58.0 * uniforms(self._seed, "basal", loop))
        carry, keys = self._begin_all(basal), jax.random.split(jax.random.key(0), loop.size)
        last, _ = self._engine.run(basal, carry, self._told(loop), np.zeros(SAMPLES), keys)
        broken: Array = np.asarray(last.broken)[:, :n]
        return broken

    def _begin(self, basal_mU_min: jax.Array) -> _Carry:
        observation = Observation(
            glucose_mg_dl=jnp.asarray(self._setpoint),
            valid=jnp.asarray(True),
            setpoint_mg_dl=jnp.asarray(self._setpoint),
            delivered_mU_min=basal_mU_min,
            announced_carbs_g=jnp.zeros(()),
            delivered_bolus_mU=self._no_bolus,
        )
        return _Carry(
            guard=self._guard.with_basal(basal_mU_min).init(observation),
            counted=self._caps.init(basal_mU_min),
            asked_mU_min=basal_mU_min,
            asked_bolus_mU=self._no_bolus,
            whole=jnp.ones(()),
            broken=jnp.zeros(len(PROMISES)),
        )

    def _step(self, basal: jax.Array, carry: _Carry, told: Any, _: Any, rng: Any) -> tuple[_Carry, jax.Array]:
        del rng
        guard, limits = self._guard.with_basal(basal), PARKER_1999_LIMITS
        guard = dataclasses.replace(
            guard, inner=_Wilful(inner=guard.inner, asks=told["asks"], wilful=told["wilful"]), settings=guard.settings
        )
        word, word_bolus = jax.tree.map(
            lambda asked, factor: jnp.where(told["as_asked"] > 0.5, asked, factor * told["delivered"]),
            (carry.asked_mU_min, carry.asked_bolus_mU),
            (1.0, None if carry.asked_bolus_mU is None else _BOLUS_OF_RATE_MIN),
        )
        observation = Observation(
            glucose_mg_dl=told["reading"],
            valid=told["valid"] > 0.5,
            setpoint_mg_dl=told["setpoint"],
            delivered_mU_min=word,
            announced_carbs_g=told["carbs"],
            delivered_bolus_mU=word_bolus,
        )
        state, decision = guard.step(_overwritten(carry.guard, told["word"], told["value"]), observation)
        asked, bolus = decision.insulin_mU_min, decision.bolus_mU
        whole = jnp.where(told["word"] >= 0.0, 0.0, carry.whole)
        counted, kept = self._caps.step(carry.counted, word, asked, word_bolus, bolus)
        meant = (word >= limits.min_mU_min) & (word <= limits.max_mU_min)
        known = jnp.asarray(False)
        for status in Status:
            known = known | (decision.status == int(status))
        held = {
            COMMAND: jnp.isfinite(asked)
            & (asked >= limits.min_mU_min)
            & (asked <= limits.max_mU_min)
            & _is_dose(bolus),
            RATE: (jnp.abs(asked - word) <= limits.max_change_mU_min + _ROUNDING_MU_MIN) | ~meant,
            STATUS: known,
            CONTROLLER: all_finite(state),
            CAPS: kept | (whole < 0.5),
        }
        broken = carry.broken + jnp.where(jnp.stack([held[name] for name in PROMISES]), 0.0, 1.0)
        return _Carry(
            guard=state, counted=counted, asked_mU_min=asked, asked_bolus_mU=bolus, whole=whole, broken=broken
        ), asked

    def _told(self, loop: npt.NDArray[np.int64]) -> dict[str, Array]:
        """Inputs of each loop at each sample, ``(SAMPLES, n)`` each."""

        def drawn(name: str) -> Array:
            return np.stack([uniforms(self._seed, name, loop, k) for k in range(SAMPLES)])

        def anything(name: str, values: Array) -> Array:
            chosen: Array = values[np.floor(drawn(name) * values.size).astype(int)]
            return chosen

        which, much = drawn("which reading"), drawn("how much")
        wild = uniforms(self._seed, "wild", loop)
        wander = 120.0 + np.cumsum(60.0 * wild * (much - 0.5), axis=0)
        reading = np.where(which < 0.3 * wild, anything("reading", _READINGS), wander)
        reading = np.where((which > 0.9) & (wild > 0.5), 700.0 * much, reading)
        of_pump, given = drawn("which rate"), drawn("rate")
        delivered = np.where(of_pump < 0.5, 0.0, np.where(of_pump < 0.9, 140.0 * given, anything("report", _NONSENSE)))
        others, memory = drawn("what else"), drawn("memory")
        lost = (memory < 0.05) & (loop % 2 == 1)
        return {
            "reading": reading,
            "valid": np.where(drawn("valid") < 0.95, 1.0, 0.0),
            "setpoint": np.where(others < 0.9, self._setpoint, anything("setpoint", _NONSENSE)),
            "carbs": np.where(others > 0.1, 0.0, anything("meal", _NONSENSE)),
            "as_asked": np.where((drawn("as asked") < 0.97) | (loop % 4 < 2), 1.0, 0.0),
            "delivered": delivered,
            "asks": np.where(given < 0.2, anything("asks", _NONSENSE), 200.0 * given),
            "wilful": np.where(uniforms(self._seed, "wilful", loop) < 0.5, 1.0, 0.0) * np.ones_like(given),
            "word": np.where(lost, np.floor(memory * 20.0 * self.words), -1.0),
            "value": anything("value", _NONSENSE),
        }


def _is_dose(bolus_mU: jax.Array | None) -> jax.Array:
    """Whether a bolus, if there is one, is a number from 0 on."""
    return jnp.asarray(True) if bolus_mU is None else jnp.isfinite(bolus_mU) & (bolus_mU >= 0.0)


def _overwritten(state: Any, word: jax.Array, value: jax.Array) -> Any:
    """A state with one of its words replaced; unchanged for a word below 0."""
    leaves, structure = jax.tree.flatten(state)
    first, new = 0, []
    for leaf in map(jnp.asarray, leaves):
        number = first + jnp.arange(leaf.size).reshape(leaf.shape)
        new.append(jnp.where(word == number, value.astype(leaf.dtype), leaf))
        first += leaf.size
    return jax.tree.unflatten(structure, new)


def run_nonsense(nonsense: NonsenseCheck, progress: Progress | None = None) -> NonsenseResult:
    """Run a nonsense test.

    Parameters
    ----------
    nonsense : NonsenseCheck
    progress : callable, optional
        Called with each number of finished loops. If it raises KeyboardInterrupt, the run ends early and returns the
        results so far, marked as interrupted.
    """
    loop = np.arange(nonsense.loops) if nonsense.loop is None else np.array([nonsense.loop])
    arms: list[NonsenseArm] = []
    try:
        for name in nonsense.controllers:
            broken = _Loops(name, nonsense.seed).broken(loop, progress) > 0
            of = dict(zip(PROMISES, broken, strict=True))
            arms.append(
                NonsenseArm(
                    controller=name,
                    loops=loop.size,
                    broken={promise: int(where.sum()) for promise, where in of.items()},
                    told={promise: tuple(loop[where][:_TOLD].tolist()) for promise, where in of.items()},
                )
            )
    except KeyboardInterrupt:
        return NonsenseResult(seed=nonsense.seed, arms=tuple(arms), interrupted=True)
    return NonsenseResult(seed=nonsense.seed, arms=tuple(arms))
