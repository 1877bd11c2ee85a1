"""Sensors and pumps of a situation and of its cases, shared as far as possible.

Compiling a loop takes seconds, so cases that differ only in one fault each share a loop: the faults of all of them wrap
its sensor and pump, and each case has numbers by which only its own fault ever begins.
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

from glucoloop.faults import FaultComponent
from glucoloop.pumps import DoseLimits, LimitedPump, Pump, with_resolution
from glucoloop.refusal import Refusal
from glucoloop.sensors import IdealSensor, Sensor, SensorComponent
from glucoloop.sensors.protocol import site_of
from glucoloop.situations.case import Case
from glucoloop.situations.situation import Situation


@dataclass(frozen=True)
class Surroundings:
    """Sensor and pump around a controller and its patient."""

    sensor: Sensor
    pump: Pump

    def of_people(self, others: Iterable[Surroundings], people: int) -> Surroundings:
        """The same for a number of people, with a trailing axis on the values that differ from any of the others."""
        alike = [jax.tree.leaves((other.sensor, other.pump)) for other in others]
        leaves, tree = jax.tree.flatten((self.sensor, self.pump))
        differs = [any(not np.array_equal(leaf, other[i]) for other in alike) for i, leaf in enumerate(leaves)]
        many = [jnp.full(people, leaf) if varies else leaf for leaf, varies in zip(leaves, differs, strict=True)]
        sensor, pump = jax.tree.unflatten(tree, many)
        return Surroundings(sensor=sensor, pump=pump)


def sensor_of(situation: Situation) -> Sensor:
    """Sensor of a situation without its faults: its components, each around the one before."""
    return _chain(situation, situation.sensor)


def _chain(situation: Situation, components: Iterable[SensorComponent]) -> Sensor:
    site = situation.site
    sensor: Sensor = IdealSensor(site=site)
    for place, component in enumerate(one for one in components if not isinstance(one, IdealSensor)):
        if place and not component.takes("inner"):
            raise Refusal(
                f"the sensor {component.display_name} has no other one inside; give it first, as the innermost"
            )
        sensor = component.made(site=site, inner=sensor, sample_time_min=situation.sample_time_min)
        if site is not None and site_of(sensor) != site:
            raise Refusal(
                f"the sensor {component.display_name} does not read glucose at the site {site!r}; leave the site out"
            )
    return sensor


def record_sensor(situation: Situation, noise_variance: float) -> Sensor:
    """Sensor of a record from which a model is identified: that of the situation with other noise, on time."""
    return _chain(situation, situation.record_sensor(noise_variance))


def pump_of(situation: Situation) -> Pump:
    """Pump of a situation without its faults: the one that is named, and the smallest step of its rate around it."""
    limits, bolus = situation.limits, situation.bolus
    pump: Pump = situation.pump.made(
        inner=LimitedPump(limits=limits, bolus=bolus, glucagon=situation.glucagon_limits),
        limits=limits,
        bolus=bolus,
        glucagon=situation.glucagon_limits,
        sample_time_min=situation.sample_time_min,
    )
    resolution = situation.pump.resolution_mU_min
    return pump if resolution is None else with_resolution(resolution, pump, limits=limits)


def surroundings_of(situation: Situation, faults: Iterable[FaultComponent] = ()) -> Surroundings:
    """Sensor and pump of a situation, wrapped in the faults of a case."""
    limits, every = situation.limits, (*situation.events, *situation.faults, *faults)
    pump = pump_of(situation)
    return Surroundings(
        sensor=faulty_sensor(sensor_of(situation), every, situation.sample_time_min, situation.warm_up_min),
        pump=faulty_pump(pump, every, situation.sample_time_min, limits, situation.warm_up_min),
    )


def shared_surroundings(situation: Situation, cases: Iterable[Case]) -> list[Mapping[str, Surroundings]]:
    """Groups of cases that can share a loop, by label; the components in a group have the same structure."""
    alike: dict[str, list[Case]] = {}
    for case in cases:
        shareable = len(case.faults) <= 1 and all(fault.comes_and_goes for fault in case.faults)
        same = repr(dataclasses.replace(case, label="shared" if shareable else case.label, faults=()))
        alike.setdefault(same, []).append(case)
    return [_together(situation, cases) for cases in alike.values()]


def _together(situation: Situation, cases: list[Case]) -> dict[str, Surroundings]:
    each = {case.label: surroundings_of(situation, case.faults) for case in cases}
    if len(cases) == 1:
        return each
    bare = surroundings_of(situation)
    sensors = _with_faults_of_all(bare.sensor, {label: component.sensor for label, component in each.items()})
    pumps = _with_faults_of_all(bare.pump, {label: component.pump for label, component in each.items()})
    return {label: Surroundings(sensor=sensors[label], pump=pumps[label]) for label in each}


def _with_faults_of_all(bare: Any, each: Mapping[str, Any]) -> dict[str, Any]:
    """Part of each case wrapped in the faults of all cases, of which only its own ever begins."""
    nothing, kind_of = _kind(bare), {label: _kind(component) for label, component in each.items()}
    kinds = {kind_of[label]: component for label, component in each.items() if kind_of[label] != nothing}
    by_label = {}
    for label, component in each.items():
        whole = bare
        for kind, example in kinds.items():
            whole = (component if kind == kind_of[label] else _idle(example)).replaced(inner=whole)
        by_label[label] = whole
    return by_label


def _kind(component: Any) -> tuple[type, Any]:
    """Type and structure of a component, the same within a loop; JAX ignores the class where numbers agree."""
    return type(component), jax.tree.structure(component)


def _idle(fault: Any) -> Any:
    """A fault that never begins."""
    episodes = dataclasses.replace(fault.episodes, earliest=math.inf, latest=math.inf, probability=0.0)
    return fault.replaced(schedule=episodes)  # from which its episodes follow, whatever else is replaced


def faulty_sensor(
    sensor: Sensor, faults: Iterable[FaultComponent], sample_time_min: float, warm_up_min: float = 0.0
) -> Sensor:
    """A sensor wrapped in faults, the first one innermost; faults of a pump are skipped."""
    for fault in faults:
        if fault.part == "sensor":
            sensor = put_around(sensor, fault, sample_time_min, warm_up_min=warm_up_min)
    return sensor


def faulty_pump(
    pump: Pump, faults: Iterable[FaultComponent], sample_time_min: float, limits: DoseLimits, warm_up_min: float = 0.0
) -> Pump:
    """A pump wrapped in faults, the first one innermost; faults of a sensor are skipped."""
    for fault in faults:
        if fault.part == "pump":
            pump = put_around(pump, fault, sample_time_min, limits, warm_up_min=warm_up_min)
    return pump


def put_around(
    inner: Any,
    fault: FaultComponent,
    sample_time_min: float,
    limits: DoseLimits | None = None,
    *,
    warm_up_min: float = 0.0,
) -> Any:
    """A sensor or pump wrapped in one fault, whose times count from the end of the warm-up."""
    return fault.made(inner=inner, sample_time_min=sample_time_min, limits=limits, warm_up_min=warm_up_min)
