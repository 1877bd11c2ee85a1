"""Sensors and pumps of the page with their faults, as functions of one sample.

A fault of a sensor takes the reading of what is inside it, so that the page can put any number of them around one
another; a fault of a pump is compiled with the usual pump inside. Times and settings of faults are inputs. Random draws
are none: the onset is given, and the draw that would move it moves nothing.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.arguments import random_key
from glucoloop.control.protocol import Status
from glucoloop.experiments.faulty import put_around
from glucoloop.faults import FAULTS, FaultPart
from glucoloop.lab.body import SAMPLE_TIME_MIN
from glucoloop.lab.part import CompiledPart, part, with_start
from glucoloop.pumps import LimitedPump, Pump
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.sensors import Reading, white_noise

_OF_ANOTHER: Final = ("out-of-order",)
"""Faults that have no function of their own."""
NOTICED: Final = "noticed"


def part_name(fault: FaultPart) -> str:
    """Name under which the function of a fault is exported."""
    ending = f"_{NOTICED}" if fault.values().get(NOTICED) else ""
    return f"{fault.part}_{fault.name.replace('-', '_')}{ending}"


@pytree
class _Passed:
    """A sensor whose reading is what it is shown, for a fault around it."""

    valid: jax.Array

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[()]:
        del glucose_mg_dl, key
        return ()

    def read(self, state: tuple[()], glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[tuple[()], Reading]:
        del key
        return state, Reading(glucose_mg_dl=glucose_mg_dl, valid=self.valid)


def sensor_parts() -> dict[str, CompiledPart]:
    """Noise, and the faults of a sensor, each with its state at the start."""
    found = {"noise": noise_part()}
    for entry in FAULTS.values():
        if entry.part == "sensor" and entry.name not in _OF_ANOTHER:
            delay = {"delay_min": SAMPLE_TIME_MIN} if entry.name == "late" else {}
            found |= fault_parts(entry.partial({"start_min": 0.0, **delay}).completed())
    return found


def fault_parts(fault: FaultPart) -> dict[str, CompiledPart]:
    """The two functions of a fault of a sensor: its state at the start, and its step."""
    zero = jnp.zeros(())
    shown = Reading(glucose_mg_dl=zero, valid=jnp.asarray(True))
    numbers = jax.tree.map(jnp.asarray, put_around(_Passed(valid=shown.valid), fault, SAMPLE_TIME_MIN))

    def init(sensor: Any, glucose_mg_dl: Any, rng: Any) -> Any:
        return sensor.init(glucose_mg_dl, rng)

    def step(sensor: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared
        faulty = dataclasses.replace(sensor, inner=_Passed(valid=own.valid))
        state, reading = faulty.read(carry, own.glucose_mg_dl, rng)
        return state, reading

    return with_start(part_name(fault), init, step, numbers, zero, shown)


def noise_part() -> CompiledPart:
    """The reading of glucose with bounded white noise, from a normal number that was drawn before."""

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared
        sensor = white_noise(person["variance"], person["bound_mg_dl"])
        _, reading = sensor.read((), own, rng)
        return carry, reading.glucose_mg_dl

    zero = jnp.zeros(())
    return part(step, {"variance": zero, "bound_mg_dl": zero}, (), zero)


def normals(seed: int, samples: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Normal numbers of the readings of a run with a seed, in the order in which `noise_part` takes them."""
    drawing = noise_part().lowered.drawing
    _, reading_key = jax.random.split(random_key(seed))
    keys = jax.vmap(lambda index: jax.random.fold_in(reading_key, index))(jnp.arange(samples))
    [drawn] = jax.vmap(drawing)(keys)
    return np.asarray(drawn).reshape(samples)


def pumps() -> dict[str, Pump]:
    """Pumps by the names of their functions: the usual one, and each fault around it."""
    usual = LimitedPump(limits=PARKER_1999_LIMITS)
    found: dict[str, Pump] = {"pump": usual}
    for entry in FAULTS.values():
        if entry.part != "pump":
            continue
        times = {"start_min": 0.0} if entry.timed else {}
        noticing = NOTICED in entry.settings()
        for notice in ({NOTICED: False}, {NOTICED: True}) if noticing else ({},):
            fault = entry.partial({**times, **notice}).completed()
            found[part_name(fault)] = put_around(usual, fault, SAMPLE_TIME_MIN, PARKER_1999_LIMITS)
    return found


def pump_parts() -> dict[str, CompiledPart]:
    """Pumps, each with its state at the start: from a decision to what is delivered and what is reported."""
    found: dict[str, CompiledPart] = {}
    zero = jnp.zeros(())
    decided = {"insulin_mU_min": zero, "status": jnp.zeros((), int)}

    def init(pump: Any, insulin_mU_min: Any, rng: Any) -> Any:
        return pump.init(insulin_mU_min, rng)

    def step(pump: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        """Deliver a dose, as `simulation.loop.sample` passes it to the pump."""
        del shared
        asked = own["insulin_mU_min"]
        finite = jnp.isfinite(asked)
        state, delivery = pump.deliver(carry, jnp.where(finite, asked, 0.0), rng)
        return state, {
            "insulin_mU_min": delivery.insulin_mU_min,
            "reported_mU_min": delivery.reported_mU_min,
            "status": jnp.where(finite, own["status"], int(Status.NO_FINITE_DOSE)),
        }

    for name, pump in pumps().items():
        found |= with_start(name, init, step, jax.tree.map(jnp.asarray, pump), zero, decided)
    return found
