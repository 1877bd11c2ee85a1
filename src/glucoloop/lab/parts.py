"""All functions of the page, lowered one by one, so that all controllers share one plant.

A sample is `simulation.loop.sample` taken apart: the sensor with noise and faults (`devices`), the controller, the
pump, and the patient (`body`). Dead time is a line of readings, which the page keeps. What a person can change on the
page is an input of a function, and not part of it: the numbers of the patients, the limits of pump and guard, the
noise, the faults, the meals, and the controllers with all that their designs compute.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.control import Controller
from glucoloop.control.guard import Guard, guarded
from glucoloop.control.imc import design_imc
from glucoloop.control.pid import PIDTuning, design_pid
from glucoloop.control.protocol import Observation
from glucoloop.experiments.case import usual_case
from glucoloop.experiments.designs import controller_of
from glucoloop.lab.body import FAMILIES, SAMPLE_TIME_MIN, meal_part, patients, plant_part, situation
from glucoloop.lab.devices import pump_parts, sensor_parts
from glucoloop.lab.part import Part, part, starting
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.registry.guard import GuardSettings

LONGEST_HORIZON: Final = 24
"""Samples that a predictive controller of the page can look ahead; shorter horizons are padded without weight."""
CONTROLLERS: Final = ("pid", "imc", "mpc", "mpc-se")
GUARDED: Final = "_guarded"
FIXED_LIMITS: Final = ("on_board_tau_min", "doubt_tau_min")
"""Limits of the guard from which it computes tables when it is made, so that they are part of its program."""
FREE_LIMITS: Final = tuple(field.name for field in dataclasses.fields(GuardSettings) if field.name not in FIXED_LIMITS)


def example_controller(name: str) -> Controller:
    """A controller of a kind, with room for the longest horizon of the page."""
    if name == "pid":
        return design_pid(PIDTuning(1.0, 60.0, 1.0), PARKER_1999_LIMITS)
    if name == "imc":
        return design_imc(-3.0, 80.0, SAMPLE_TIME_MIN, PARKER_1999_LIMITS)
    around = situation(FAMILIES[0], next(iter(patients(FAMILIES[0]))))
    controller: Any = controller_of(around, usual_case(name, around))
    moves, _ = controller.horizons
    padded: Controller = controller.padded(moves, LONGEST_HORIZON)
    return padded


class _FreeLimits:
    """Limits of a guard that are inputs of the program, beside those that are not; stands for `GuardSettings`."""

    def __init__(self, free: dict[str, Any], fixed: GuardSettings) -> None:
        for name in FIXED_LIMITS:
            setattr(self, name, getattr(fixed, name))
        for name, value in free.items():
            setattr(self, name, value)


@dataclass(frozen=True)
class Adjustable:
    """A controller whose numbers are inputs of a program, the limits of a guard among them."""

    example: Controller

    @property
    def numbers(self) -> dict[str, Any]:
        """Example of the numbers."""
        limits = dict.fromkeys(FREE_LIMITS, jnp.zeros(())) if isinstance(self.example, Guard) else {}
        return {"controller": jax.tree.map(jnp.asarray, self.example), "guard": limits}

    def of(self, numbers: dict[str, Any]) -> Any:
        """The controller with other numbers; the guard's limits are no part of its tree."""
        controller = numbers["controller"]
        if not isinstance(controller, Guard):
            return controller
        limits: Any = _FreeLimits(numbers["guard"], controller.settings)
        return dataclasses.replace(controller, settings=limits)


def adjustable(name: str, *, guard: bool) -> Adjustable:
    """A controller of the page, in a guard or not."""
    bare = example_controller(name)
    return Adjustable(guarded(bare, None, PARKER_1999_LIMITS) if guard else bare)


def controller_parts(adjusted: Adjustable) -> dict[str, Part]:
    """The two functions of a controller: its state at the start, and its step."""
    zero = jnp.zeros(())
    observation = Observation(
        glucose_mg_dl=zero,
        valid=jnp.asarray(True),
        setpoint_mg_dl=zero,
        delivered_mU_min=zero,
        announced_carbs_g=zero,
    )

    def init(person: Any, own: Any, rng: Any) -> Any:
        del rng
        return adjusted.of(person).init(own)

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        state, decision = adjusted.of(person).step(carry, own)
        return state, {"insulin_mU_min": decision.insulin_mU_min, "status": decision.status}

    person = adjusted.numbers
    state = jax.eval_shape(lambda: adjusted.of(person).init(observation))
    return {"start": starting(init, person, observation), "step": part(step, person, state, observation)}


def parts() -> dict[str, Part]:
    """All functions of the page, by the name under which the module exports them."""
    found = {**sensor_parts(), **pump_parts()}
    for family in FAMILIES:
        found |= {f"{prefix(family)}plant": plant_part(family), f"{prefix(family)}meal": meal_part(family)}
    for name in CONTROLLERS:
        for suffix, guard in (("", False), (GUARDED, True)):
            for what, of in controller_parts(adjustable(name, guard=guard)).items():
                found[f"{name.replace('-', '_')}{suffix}_{what}"] = of
    return found


def prefix(family: str) -> str:
    """Beginning of the names of the functions that only one patient has."""
    return f"{family.replace('-', '_')}_"
