"""Package data of the page: the module, and the numbers with the layout of the module's functions.

    python -m glucoloop.lab.build

writes both into the package. It needs clang and LLVM's linker, which users of the package do not; run it again
when a definition that the page uses has changed. The tests compare what is there with what would be written.

Designs are computed with the instructions of an older processor, whichever computes them: with others the last digits
of a table differ, and where a number is exactly zero the length of the module as well.

Functions are lowered one by one, so that all controllers share one plant: `simulation.loop.sample` taken apart. What a
person can change on the page is an input of a function, and not part of it: the numbers of the patients, the limits of
pump and guard, the noise, the faults, the meals, and the controllers with all that their designs compute.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np

from glucoloop.lab.controllers import (
    LOOPED,
    Adjustable,
    adjustable,
    controller_functions,
    controllers_of,
    guard_functions,
    guard_program_of,
    looped_functions,
    program_of,
)
from glucoloop.lab.device_functions import pump_functions, sensor_functions
from glucoloop.lab.lowered_function import PageFunction
from glucoloop.lab.pack import DATA, MODULE
from glucoloop.lab.page_data import numbers
from glucoloop.lab.patient_functions import FAMILIES, by_equations, meal_functions, plant_function
from glucoloop.lab.people import draw_function, person_function
from glucoloop.native.targets.wasm import numbers_per_person, tool_versions, wasm_module
from glucoloop.refusal import Refusal

_GUARDED: Final = "_guarded"
INSTRUCTIONS: Final = {"XLA_FLAGS": "--xla_cpu_max_isa=AVX2", "OPENBLAS_CORETYPE": "Haswell"}
"""Settings by which XLA and the linear algebra of NumPy use the instructions of 2013, on any newer processor."""


def _functions(families: Sequence[str] = FAMILIES) -> dict[str, PageFunction]:
    """All functions of the page, by the name under which the module exports them."""
    result = {**sensor_functions(), **pump_functions(), "draw": draw_function()}
    for family in families:
        name = re.sub(r"\W", "_", family)
        result[f"{name}_plant"] = plant_function(family)
        result |= {f"{name}_{what}": compiled for what, compiled in meal_functions(family).items()}
        if not by_equations(family):
            result[f"{name}_person"] = person_function(family)
    shapes: dict[str, tuple[object, ...]] = {}
    of_families = ((family, name) for family in families for name in controllers_of(family))
    for (family, name), guard in itertools.product(of_families, (False, True)):
        if name in LOOPED:
            program = guard_program_of(family) if guard else program_of(name, family)
            if f"{program}_step" not in result:
                additions = guard_functions(family) if guard else looped_functions(name, family)
                result |= {f"{program}_{what}": compiled for what, compiled in additions.items()}
            continue
        program, adjusted = (
            program_of(name, family) + (_GUARDED if guard else ""),
            adjustable(name, family, guard=guard),
        )
        shape = _shape(adjusted)
        if program not in shapes:
            result |= {f"{program}_{what}": compiled for what, compiled in controller_functions(adjusted).items()}
        if shapes.setdefault(program, shape) != shape:
            raise Refusal(f"{name} of {family} is not of the form of the program {program}")
    return result


def _shape(controller: Adjustable) -> tuple[object, ...]:
    """Structure and shapes of a controller, which its program depends on."""
    leaves, structure = jax.tree.flatten(controller.example)
    return structure, *map(np.shape, leaves)


def _tools() -> dict[str, str]:
    """Versions on which the bytes of the module depend."""
    return {"llvmlite": importlib.metadata.version("llvmlite"), **tool_versions()}


def _module(functions: Mapping[str, PageFunction]) -> bytes:
    """The module with the functions of the page."""
    return wasm_module({name: part.lowered for name, part in functions.items()})


def _layout(functions: Mapping[str, PageFunction]) -> dict[str, Any]:
    """Names and counts of the numbers that each function takes and gives, and how many it keeps of a person."""
    return {
        name: {
            **{group: dict(names) for group, names in part.names.items()},
            "per_person": numbers_per_person(part.lowered),
        }
        for name, part in functions.items()
    }


def main() -> None:
    """Write the package data, or into a folder that is given as the argument."""
    if any(value not in os.environ.get(name, "").split() for name, value in INSTRUCTIONS.items()):
        command = [sys.executable, "-m", "glucoloop.lab.build", *sys.argv[1:]]
        raise SystemExit(subprocess.run(command, env={**os.environ, **INSTRUCTIONS}, check=False).returncode)
    functions = _functions()
    data = {"tools": _tools(), "functions": _layout(functions), **numbers()}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False) + "\n"
    folders = [Path(argument) for argument in sys.argv[1:]] or [MODULE.parent]
    (folders[0] / MODULE.name).write_bytes(_module(functions))
    (folders[0] / DATA.name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
