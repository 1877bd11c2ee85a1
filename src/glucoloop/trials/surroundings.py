"""Sensors and pumps of the cases of a trial, shared as far as they can be.

Compiling a loop costs seconds, so cases that differ in nothing but one fault each share a loop: the faults of all of
them are around its sensor and pump, and each case has numbers of its own, by which only its own fault ever begins.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.pumps import DoseLimits, Pump
from glucoloop.sensors import Sensor
from glucoloop.trials.fault_text import parse_fault
from glucoloop.trials.faulty import faulty_pump, faulty_sensor
from glucoloop.trials.situation import pump_of, sensor_of
from glucoloop.trials.trial import Trial, TrialCase


@dataclass(frozen=True)
class Surroundings:
    """What is around a controller and its patient."""

    sensor: Sensor
    pump: Pump

    def of_people(self, others: Iterable[Surroundings], people: int) -> Surroundings:
        """The same for so many people, who trail where this differs from any of the others."""
        alike = [jax.tree.leaves((other.sensor, other.pump)) for other in others]
        leaves, tree = jax.tree.flatten((self.sensor, self.pump))
        differs = [any(not np.array_equal(leaf, of[i]) for of in alike) for i, leaf in enumerate(leaves)]
        many = [jnp.full(people, leaf) if own else leaf for leaf, own in zip(leaves, differs, strict=True)]
        sensor, pump = jax.tree.unflatten(tree, many)
        return Surroundings(sensor=sensor, pump=pump)


def surroundings_of(trial: Trial, case: TrialCase, limits: DoseLimits) -> Surroundings:
    """Sensor and pump of a case.

    Raises
    ------
    ValueError
        For a fault that is not possible.
    """
    faults = [parse_fault(text) for text in (*trial.faults, *case.faults)]
    sensor = sensor_of(trial.noise_variance, trial.noise_bound_mg_dl, trial.dead_time_samples)
    pump = pump_of(limits, trial.pump_resolution_mU_min)
    return Surroundings(
        sensor=faulty_sensor(sensor, faults, trial.sample_time_min),
        pump=faulty_pump(pump, faults, trial.sample_time_min, limits),
    )


def shared_surroundings(trial: Trial, limits: DoseLimits) -> list[Mapping[str, Surroundings]]:
    """The cases of a trial by label, those together that can share a loop; these are of one structure.

    Raises
    ------
    ValueError
        For a fault that is not possible.
    """
    alike: dict[str, list[TrialCase]] = {}
    for case in trial.cases:
        own = [parse_fault(text) for text in case.faults]
        shareable = len(own) <= 1 and all(fault.entry.comes_and_goes for fault in own)
        same = repr(dataclasses.replace(case, label="" if shareable else case.label, faults=()))
        alike.setdefault(same, []).append(case)
    return [_together(trial, cases, limits) for cases in alike.values()]


def _together(trial: Trial, cases: list[TrialCase], limits: DoseLimits) -> dict[str, Surroundings]:
    each = {case.label: surroundings_of(trial, case, limits) for case in cases}
    if len(cases) == 1:
        return each
    bare = surroundings_of(trial, dataclasses.replace(cases[0], faults=()), limits)
    sensors = _around(bare.sensor, {label: of.sensor for label, of in each.items()})
    pumps = _around(bare.pump, {label: of.pump for label, of in each.items()})
    return {label: Surroundings(sensor=sensors[label], pump=pumps[label]) for label in each}


def _around(bare: Any, each: Mapping[str, Any]) -> dict[str, Any]:
    """Every case's part with the faults of all, of which only its own ever begins."""
    nothing, kind_of = _kind(bare), {label: _kind(part) for label, part in each.items()}
    kinds = {kind_of[label]: part for label, part in each.items() if kind_of[label] != nothing}
    told = {}
    for label, part in each.items():
        whole = bare
        for kind, example in kinds.items():
            whole = dataclasses.replace(part if kind == kind_of[label] else _idle(example), inner=whole)
        told[label] = whole
    return told


def _kind(part: Any) -> tuple[type, Any]:
    """What cannot differ within a loop; JAX takes the structures of two classes with as many numbers for the same."""
    return type(part), jax.tree.structure(part)


def _idle(fault: Any) -> Any:
    """A fault that never begins."""
    episodes = dataclasses.replace(fault.episodes, earliest=math.inf, latest=math.inf, probability=0.0)
    return dataclasses.replace(fault, episodes=episodes)
