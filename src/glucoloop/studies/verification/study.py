"""A campaign or a nonsense test carried out, in tables and sentences."""

from __future__ import annotations

import dataclasses
import functools
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.cohorts.blocks import block_size, in_blocks
from glucoloop.control import Controller, Decision, Observation, guarded
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.protocol import gives_boluses
from glucoloop.metrics.promises import OF_CONTROLLER, PROMISES, Caps, Counted, breaches, held_by_controller
from glucoloop.patients.settings import PATIENTS
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.report.columns import Column, FittingTable, Line, decimals, terminal_table, whole
from glucoloop.report.descriptions import engine_notes
from glucoloop.simulation.engines import NativeEngine
from glucoloop.situations.case import Case
from glucoloop.situations.run import ControlledSituation, boluses_into_a_vein
from glucoloop.situations.situation import usual_situation
from glucoloop.storage.findings import Findings
from glucoloop.studies.verification import NONSENSE_SAMPLES, Verification
from glucoloop.studies.verification.campaign import (
    LISTED,
    MARGIN_PCT,
    Floats,
    Numbers,
    Progress,
    catalogue_controller,
    circumstances_of,
    run_campaign,
)
from glucoloop.text import how_many
from glucoloop.threefry import uniforms

_BOLUS_OF_RATE_MIN: Final = 60.0
"""A bolus that is asked for or reported at will is an hour of the rate that is."""
_ANY_BOLUS_MU: Final = sys.float_info.max
"""A guard does not know the largest bolus of a pump, so that a bolus has only to be a number from 0 on."""
_NONSENSE: Final = np.array(
    [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-3, 0.5, 1.0, 1e5, -1e5, 1e18, 1e300, -1e300, 1.7e308]
)
_READINGS: Final = np.array([np.nan, np.inf, -np.inf, 0.0, 19.9, 20.0, 31.0, 64.9, 81.0, 128.0, 400.0, 600.0, 1e300])


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
    """The loops of one guarded controller with arbitrary inputs and corrupted memory, without a patient.

    In each loop readings wander or are arbitrary; at times the setpoint, the meal, the rate that the pump reports and
    the rate that the inner controller asks for are arbitrary too. In every other loop single words of the memory are
    overwritten as well, those of the guard and those of the inner controller. A loop is a function of the seed and its
    number alone.
    """

    def __init__(self, name: str, seed: int) -> None:
        self._seed, self._setpoint = seed, usual_situation().target_mg_dl
        self._guard = guarded(catalogue_controller(name), limits=PARKER_1999_LIMITS)
        self._caps = Caps(settings=self._guard.settings, limits=PARKER_1999_LIMITS)
        first = self._begin(jnp.asarray(20.0))
        self._memory_words = sum(np.size(leaf) for leaf in jax.tree.leaves(first.guard))
        inputs = {key: jnp.asarray(values[0, 0]) for key, values in self._inputs(np.zeros(1, np.int64)).items()}
        self._engine = NativeEngine(
            self._step,
            (jnp.asarray(20.0), first, inputs, jnp.zeros(()), jax.random.key(0)),
            "float64",
        )
        self._begin_all = jax.jit(jax.vmap(self._begin, in_axes=-1, out_axes=-1))

    def broken(self, loop: Numbers, progress: Progress) -> Floats:
        """(promises, n) number of samples at which each promise was broken."""
        return np.concatenate(in_blocks(self._block, loop, block_size("native"), done=progress), axis=1)

    def _block(self, loop: Numbers, n: int) -> Floats:
        basal = jnp.asarray(2.0 + 58.0 * uniforms(self._seed, "basal", loop))
        carry, keys = self._begin_all(basal), jax.random.split(jax.random.key(0), loop.size)
        last, _ = self._engine.run(basal, carry, self._inputs(loop), np.zeros(NONSENSE_SAMPLES), keys)
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
        return _Carry(
            guard=self._guard.with_basal(basal_mU_min).init(observation),
            counted=self._caps.init(basal_mU_min),
            asked_mU_min=basal_mU_min,
            asked_bolus_mU=no_bolus,
            whole=jnp.ones(()),
            broken=jnp.zeros(len(OF_CONTROLLER)),
        )

    def _step(self, basal: jax.Array, carry: _Carry, inputs: Any, _: Any, rng: Any) -> tuple[_Carry, jax.Array]:
        del rng
        guard = self._guard.with_basal(basal)
        wilful = _Wilful(inner=guard.inner, asks=inputs["asks"], wilful=inputs["wilful"])
        rate, bolus = _at_will(inputs["misreported"], inputs["delivered"], carry.asked_mU_min, carry.asked_bolus_mU)
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
        asked, asked_bolus = decision.insulin_mU_min, decision.bolus_mU
        counted, within_caps = self._caps.step(carry.counted, rate, asked, bolus, asked_bolus)
        whole = jnp.where(inputs["word"] >= 0.0, 0.0, carry.whole)
        within_caps = within_caps | (whole < 0.5)
        held = held_by_controller(PARKER_1999_LIMITS, _ANY_BOLUS_MU, decision, rate, state, within_caps)
        return _Carry(
            guard=state,
            counted=counted,
            asked_mU_min=asked,
            asked_bolus_mU=asked_bolus,
            whole=whole,
            broken=carry.broken + breaches(held),
        ), asked

    def _inputs(self, loop: Numbers) -> dict[str, Floats]:
        """Inputs of each loop at each sample, ``(samples, n)`` each."""

        def drawn(name: str) -> Floats:
            return np.stack([uniforms(self._seed, name, loop, k) for k in range(NONSENSE_SAMPLES)])

        def anything(name: str, values: Floats) -> Floats:
            chosen: Floats = values[np.floor(drawn(name) * values.size).astype(int)]
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
            "misreported": np.where((drawn("as asked") < 0.97) | (loop % 4 < 2), 0.0, 1.0),
            "delivered": delivered,
            "asks": np.where(given < 0.2, anything("asks", _NONSENSE), 200.0 * given),
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


def run_nonsense(asked: Verification, progress: Progress) -> Iterator[dict[str, dict[str, Any]]]:
    """The loops of each guarded controller as plain values, each an ``arm``."""
    for name, number in asked.people().items():
        loop = np.arange(number) if asked.person is None else np.array([asked.person])
        broken = dict(zip(OF_CONTROLLER, _Loops(name, asked.seed).broken(loop, progress) > 0, strict=True))
        yield {
            "arm": {
                "controller": name,
                "loops": loop.size,
                "samples": NONSENSE_SAMPLES * loop.size,
                "broken": {promise: int(where.sum()) for promise, where in broken.items()},
                "told": {promise: loop[where][:LISTED].tolist() for promise, where in broken.items()},
            }
        }


SAME_BITS: Final = "the same bits again, in another order and other blocks"


def notes(asked: Verification) -> tuple[str, ...]:
    """Sentence on boluses into a vein, where controllers were chosen."""
    if asked.nonsense is not None or not asked.controllers:
        return ()
    chosen = tuple(Case(controller=CONTROLLERS.find(name).partial({})) for name in asked.controllers)
    return boluses_into_a_vein(ControlledSituation(patient=PATIENTS.parse(asked.patient), controller=chosen))


def amount(asked: Verification) -> int:
    """Number of loops that will be closed."""
    return (2 if asked.nonsense is None else 1) * sum(asked.people().values())


def found(asked: Verification, progress: Callable[[int], None]) -> Findings:
    """Close the loops, and count in how many each promise was broken.

    After an interrupt, of which `progress` tells, only controllers whose loops were all closed are among the findings.
    """
    began, interrupted = time.monotonic(), False
    arms: list[dict[str, Any]] = []
    guarding: list[dict[str, Any]] = []
    try:
        for part in run_campaign(asked, progress) if asked.nonsense is None else run_nonsense(asked, progress):
            arms.append(part["arm"])
            guarding += [part["guarding"]] if "guarding" in part else []
    except KeyboardInterrupt:
        interrupted = True
    promises = PROMISES if asked.nonsense is None else OF_CONTROLLER
    violations = {promise: sum(arm["broken"][promise] for arm in arms) for promise in promises}
    if asked.nonsense is None:
        violations[SAME_BITS] = sum(len(arm["not_repeated"]) for arm in arms)
    plain = {
        "seed": asked.seed,
        "loops": sum(arm["loops"] for arm in arms),
        "samples": sum(arm["samples"] for arm in arms),
        "seconds": time.monotonic() - began,
        "interrupted": interrupted,
        "holds": not any(violations.values()),
        "violations": violations,
        "arms": arms,
    }
    if asked.nonsense is None:
        plain["guarding"] = guarding
        if asked.person is not None:
            circumstances = {
                name: circumstances_of(name, asked.seed, asked.person, asked.patient) for name in asked.people()
            }
            plain["meets"] = circumstances
    return Findings(plain)


_effect = functools.partial(Column, only=lambda row: "better" in row)
_ARM_COLUMNS: Final = (
    Column(name="engine", short="Engine", text=str, left=True),
    Column(name="loops", short="Loops", text=whole),
    Column(name="samples", short="Samples", text=whole),
    Column(name="all_broken", short="Broken", text=whole),
    Column(name="below_60_pct", short="Below 60, %", text=decimals(2), only=lambda row: "below_60_pct" in row),
    _effect(name="better", short="Better", text=whole),
    _effect(name="worse", short="Worse", text=whole),
    _effect(name="worst_pct", short="Most, %", text="{:+.1f}".format),
    Column(name="worst_person", short="Person", text=whole, only=lambda row: row.get("worst_pct", 0.0) > 0.0),
)


def tables(asked: Verification, found: Findings) -> Iterator[FittingTable]:
    """Number of loops that broke each promise, and the loops of each controller."""
    arms, violations = found.plain["arms"], found.plain["violations"]
    if asked.nonsense is not None:
        columns = [Column(name=arm["controller"], short=arm["controller"], text=whole) for arm in arms]
        rows = [(promise, [{arm["controller"]: arm["broken"][promise] for arm in arms}]) for promise in violations]
        yield terminal_table("Promise", [("", rows)], columns)
        return
    column = Column(name="loops", short="Loops that broke it", text=whole)
    yield terminal_table("Promise", [("", [(promise, [{"loops": n}]) for promise, n in violations.items()])], [column])
    guarding = {effect["controller"]: effect for effect in found.plain["guarding"]}
    lines: list[Line] = []
    for arm in arms:
        row = {**arm, "all_broken": sum(arm["broken"].values()) + len(arm["not_repeated"])}
        effect = guarding.get(arm["controller"])
        if effect is not None:
            row["below_60_pct"] = effect["guarded_pct" if arm["guarded"] else "bare_pct"]
            if arm["guarded"]:
                row |= {name: effect[name] for name in ("better", "worse", "worst_pct", "worst_person")}
        lines.append((_called(arm), [row]))
    yield terminal_table("Controller", [("", lines)], _ARM_COLUMNS)


def sentences(asked: Verification, found: Findings) -> Iterator[str]:
    """A line for each broken loop that is listed, with the command that repeats it, and the verdict."""
    plain = found.plain
    for name, person in plain.get("meets", {}).items():
        meals = " ".join(f"{carbs:.1f}g@{t:.1f}min" for t, carbs in person["meals"]) or "no meal"
        yield (
            f"{name}: {person['population']}, basal rate {person['basal_insulin_mU_min']:.2f} mU/min; {meals}; noise "
            f"{person['noise_variance']:.3g} (mg/dl)² within {person['noise_bound_mg_dl']:.3g}; {_faults(person)}"
        )
    for arm in plain["arms"]:
        yield from _broken(asked, arm)
    seconds = f"{plain['seconds']:.1f} s"
    if asked.nonsense is not None:
        yield f"{plain['samples']} samples of guarded controllers with nonsense as readings, {seconds}."
    else:
        repeated = sum(arm["repeated"] for arm in plain["arms"])
        more = f"; {repeated} of them closed twice" if repeated else ""
        yield f"{how_many(plain['loops'], 'loop')}, {plain['samples']} samples, {seconds}{more}."
        yield (
            "Below 60: mean time below 60 mg/dl in percent of the run. Better, worse: number of people who spend less "
            f"or more time below 60 mg/dl with the guard than without it, by over {MARGIN_PCT:g} % of the run. Most, "
            "person: the largest such increase, and the number of that person."
        )
        yield from engine_notes({_called(arm): arm for arm in plain["arms"]})
    broken = [promise for promise, count in plain["violations"].items() if count]
    yield f"Broken: {'; '.join(broken)}." if broken else "Every promise was kept."


def _broken(asked: Verification, arm: Mapping[str, Any]) -> Iterator[str]:
    """Lines for the broken loops of a controller."""
    name, called = arm["controller"], _called(arm)
    if asked.nonsense is not None:
        for promise, loops in arm["told"].items():
            yield from (f"{called}, loop {loop}: {promise}; {asked.repeat(name, loop)}" for loop in loops)
        return
    for broken in arm["told"]:
        yield (
            f"{called}, person {broken['person']}: {broken['promise']}; broken at {broken['samples']} samples, first "
            f"at {broken['first_min']:g} min; {_faults(broken)}; {broken['repeat']}"
        )
    for person in arm["not_repeated"][:LISTED]:
        yield f"{called}, person {person}: other bits; {asked.repeat(name, person)}"


def _called(arm: Mapping[str, Any]) -> str:
    """Name of a controller with or without its guard, which all controllers of a nonsense test have."""
    return f"{arm['controller']}, guarded" if arm.get("guarded", True) else str(arm["controller"])


def _faults(person: Mapping[str, Any]) -> str:
    return " ".join(f"--fault {fault!r}" for fault in person["faults"]) or "no fault"
