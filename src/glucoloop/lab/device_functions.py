"""Sensors and pumps of the page with their faults, as functions of one sample.

A fault of a sensor takes the reading of what is inside it, so that the page can put any number of them around one
another; a fault of a pump is compiled with the default pump inside. Times and settings of faults are inputs. Nothing
is drawn: the onset is an input, and the draw that would move it moves nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.build.surroundings import put_around
from glucoloop.component.request import Request, completed
from glucoloop.control.protocol import Status
from glucoloop.faults import FAULTS, FaultComponent
from glucoloop.lab.lowered_function import PageFunction, page_function, start_function
from glucoloop.lab.patient_functions import SAMPLE_TIME_MIN
from glucoloop.pumps import LimitedPump, Pump
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.pumps.protocol import deliver
from glucoloop.refusal import Refusal
from glucoloop.sensors import SENSORS, Lag, Reading, Sensor, WhiteNoise
from glucoloop.sensors.cgm import Display
from glucoloop.sensors.cgm.model import Ticks
from glucoloop.sensors.cgm.monitor import MonitorErrors

_OF_ANOTHER: Final = ("out-of-order",)
"""Faults that have no function of their own."""
MONITORS: Final = ("dexcom-g6", "dexcom-g5", "facchinetti-2014")
"""Continuous glucose monitors of the page, whose errors have one form; the one that it offers first."""
_PROCESSES: Final = 2
"""Maximum number of processes of their noise."""
_EACH_SAMPLE: Final = Ticks(1, 1)
_NOTICED: Final = "noticed"


def _fault_name(fault: FaultComponent) -> str:
    """Name under which the function of a fault is exported."""
    ending = f"_{_NOTICED}" if fault.values().get(_NOTICED) else ""
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


def sensor_functions() -> dict[str, PageFunction]:
    """Sensors, and the faults of a sensor, each with its state at the start."""
    result: dict[str, PageFunction] = {}
    for name, sensor in _sensors().items():
        result |= _reading_functions(f"sensor_{name}", sensor)
    for entry in FAULTS.values():
        if entry.part == "sensor" and entry.name not in _OF_ANOTHER:
            delay = {"delay_min": SAMPLE_TIME_MIN} if entry.name == "late" else {}
            result |= _fault_functions(completed(Request(entry, {"start_min": 0.0, **delay})))
    return result


def _sensors() -> dict[str, Sensor]:
    """Sensors by the names of their functions, each around one whose reading is what it is shown.

    A monitor of the page is the lag, the errors of its model and the display, one after another.
    """
    passed = _Passed(valid=jnp.asarray(True))
    return {
        "white_noise": WhiteNoise(inner=passed),
        "lag": Lag(inner=passed, sample_time_min=SAMPLE_TIME_MIN),
        "monitor": errors_of(MONITORS[0]),
        "display": Display(inner=passed, sample_time_min=SAMPLE_TIME_MIN),
    }


def errors_of(name: str) -> MonitorErrors:
    """Errors of a monitor of the page alone, without its lag and its display.

    A model of one process has a second one that is always zero, so that all monitors have one program.
    """
    alone = completed(Request(SENSORS[name], {"lag_min": 0.0, "display": False}))
    monitor: MonitorErrors = alone.made(
        inner=_Passed(valid=jnp.asarray(True)), site=None, sample_time_min=SAMPLE_TIME_MIN
    )
    if monitor.constants is None or monitor.shape is not None or monitor.steps != _EACH_SAMPLE:
        raise Refusal(f"the page has no program for the errors of {name}, which differ or are not of each sample")
    wide = {
        of: jnp.zeros(_PROCESSES).at[: numbers.size].set(numbers)
        for of, numbers in vars(monitor.constants).items()
        if of in ("alpha1", "alpha2", "sigma")
    }
    return dataclasses.replace(monitor, constants=dataclasses.replace(monitor.constants, **wide))


def _fault_functions(fault: FaultComponent) -> dict[str, PageFunction]:
    """The two functions of a fault of a sensor."""
    return _reading_functions(_fault_name(fault), put_around(_Passed(valid=jnp.asarray(True)), fault, SAMPLE_TIME_MIN))


def _around(sensor: Any, inner: Any) -> Any:
    """A sensor around another one than its own."""
    return sensor.replaced(inner=inner) if hasattr(sensor, "replaced") else dataclasses.replace(sensor, inner=inner)


def _reading_functions(name: str, sensor: Any) -> dict[str, PageFunction]:
    """The two functions of what is around a sensor: its state at the start, and its step, by what that sensor read."""
    zero = jnp.zeros(())
    reading = Reading(glucose_mg_dl=zero, valid=jnp.asarray(True))
    numbers = jax.tree.map(jnp.asarray, sensor)

    def init(sensor: Any, glucose_mg_dl: Any, rng: Any) -> Any:
        return sensor.init(glucose_mg_dl, rng)

    def step(sensor: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared
        inner = _Passed(valid=own.valid)
        around = _around(sensor, inner)
        state, reading = around.read(carry, own.glucose_mg_dl, rng)
        return state, reading

    return _start_and_step(name, init, step, numbers, zero, reading)


def _pumps() -> dict[str, Pump]:
    """Pumps by the names of their functions: the default one, and each fault around it."""
    default_pump = LimitedPump(limits=PARKER_1999_LIMITS)
    result: dict[str, Pump] = {"pump": default_pump}
    for entry in FAULTS.values():
        if entry.part != "pump":
            continue
        times = {"start_min": 0.0} if entry.timed else {}
        noticing = _NOTICED in entry.settings()
        for notice in ({_NOTICED: False}, {_NOTICED: True}) if noticing else ({},):
            fault = completed(Request(entry, {**times, **notice}))
            result[_fault_name(fault)] = put_around(default_pump, fault, SAMPLE_TIME_MIN, PARKER_1999_LIMITS)
    return result


def pump_functions() -> dict[str, PageFunction]:
    """Pumps, each with its state at the start: from a decision to what is delivered and what is reported.

    A controller without boluses asks for none at each sample.
    """
    result: dict[str, PageFunction] = {}
    zero = jnp.zeros(())
    decided = {"insulin_mU_min": zero, "status": jnp.zeros((), int), "bolus_mU": zero}

    def init(pump: Any, insulin_mU_min: Any, rng: Any) -> Any:
        return pump.init(insulin_mU_min, rng)

    def step(pump: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        """Deliver a dose, as `simulation.loop.sample` passes it to the pump."""
        del shared
        requested, bolus = own["insulin_mU_min"], own["bolus_mU"]
        finite = jnp.isfinite(requested) & jnp.isfinite(bolus)
        command, bolus = jnp.where(finite, requested, 0.0), jnp.where(finite, bolus, 0.0)
        state, delivery = deliver(pump, carry, command, rng, bolus)
        bolus_given = jnp.zeros(()) if delivery.bolus_mU is None else delivery.bolus_mU
        return state, {
            "insulin_mU_min": delivery.insulin_mU_min,
            "bolus_mU": bolus_given,
            "infused_mU_min": delivery.insulin_mU_min + bolus_given / SAMPLE_TIME_MIN,
            "reported_mU_min": delivery.reported_mU_min,
            "reported_bolus_mU": delivery.reported_bolus_mU,
            "status": jnp.where(finite, own["status"], int(Status.NO_FINITE_DOSE)),
        }

    for name, pump in _pumps().items():
        result |= _start_and_step(name, init, step, jax.tree.map(jnp.asarray, pump), zero, decided)
    return result


def _start_and_step(
    name: str, init: Callable[..., Any], step: Callable[..., Any], person: Any, at_start: Any, own: Any
) -> dict[str, PageFunction]:
    """Two functions of the page by their names: one that gives the state at the start, and the step."""
    state = jax.eval_shape(init, person, at_start, jax.random.key(0))
    return {f"{name}_start": start_function(init, person, at_start), name: page_function(step, person, state, own)}
