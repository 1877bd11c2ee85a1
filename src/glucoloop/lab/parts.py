"""All functions of the page, lowered one by one, so that all controllers share one plant.

A sample is `simulation.loop.sample` taken apart: the sensor with noise and faults (`devices`), the controller
(`controllers`), the pump, and the patient (`body`). Dead time is a line of readings, which the page keeps. What a
person can change on the page is an input of a function, and not part of it: the numbers of the patients, the limits of
pump and guard, the noise, the faults, the meals, and the controllers with all that their designs compute.
"""

from __future__ import annotations

from typing import Final

import jax
import numpy as np

from glucoloop.lab.body import FAMILIES, meal_part, plant_part
from glucoloop.lab.controllers import CONTROLLERS, LONGEST_HORIZON, Adjustable, adjustable, controller_parts
from glucoloop.lab.devices import pump_parts, sensor_parts
from glucoloop.lab.part import CompiledPart
from glucoloop.lab.people import draw_part, person_part
from glucoloop.patients.settings import PATIENTS
from glucoloop.refusal import Refusal

GUARDED: Final = "_guarded"


def parts() -> dict[str, CompiledPart]:
    """All functions of the page, by the name under which the module exports them."""
    found = {**sensor_parts(), **pump_parts(), "draw": draw_part()}
    for family in FAMILIES:
        name = family.replace("-", "_")
        found |= {
            f"{name}_plant": plant_part(family),
            f"{name}_meal": meal_part(family),
            f"{name}_person": person_part(family),
        }
    for route in LONGEST_HORIZON:
        of_route = [family for family in FAMILIES if PATIENTS[family].insulin_route == route]
        for name in CONTROLLERS:
            for suffix, guard in (("", False), (GUARDED, True)):
                first, *others = (adjustable(name, family, guard=guard) for family in of_route)
                if any(_shape(other) != _shape(first) for other in others):
                    raise Refusal(f"the patients with {route} insulin have no common program of {name}")
                for what, compiled in controller_parts(first).items():
                    found[f"{route}_{name.replace('-', '_')}{suffix}_{what}"] = compiled
    return found


def _shape(controller: Adjustable) -> tuple[object, ...]:
    """Structure and shapes of a controller, which its program depends on."""
    leaves, structure = jax.tree.flatten(controller.example)
    return structure, *map(np.shape, leaves)
