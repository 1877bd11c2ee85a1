"""Package data of the page: the module, and the numbers with the layout of the module's functions.

    python -m glucoloop.lab.build

writes both into the package. It needs clang and LLVM's linker, which users of the package do not; run it again
when a definition that the page uses has changed. The tests compare what is there with what would be written.
"""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Mapping
from typing import Any

from glucoloop.lab.lowered_function import CompiledPart
from glucoloop.lab.lowered_functions import parts
from glucoloop.lab.pack import DATA, MODULE
from glucoloop.lab.page_data import numbers
from glucoloop.native.targets.wasm.looped import c_compiler_version
from glucoloop.native.targets.wasm.module import held_numbers, linker_version, wasm_module


def tools() -> dict[str, str]:
    """Versions on which the bytes of the module depend."""
    return {
        "llvmlite": importlib.metadata.version("llvmlite"),
        "clang": c_compiler_version(),
        "linker": linker_version(),
    }


def module(of_page: Mapping[str, CompiledPart]) -> bytes:
    """The module with the functions of the page."""
    return wasm_module({name: part.lowered for name, part in of_page.items()})


def functions(of_page: Mapping[str, CompiledPart]) -> dict[str, Any]:
    """Names and counts of the numbers that each function takes and gives, and how many it keeps of a person."""
    return {
        name: {**{group: dict(names) for group, names in part.names.items()}, "held": held_numbers(part.lowered)}
        for name, part in of_page.items()
    }


def main() -> None:
    """Write the package data."""
    of_page = parts()
    data = {"tools": tools(), "functions": functions(of_page), **numbers()}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False) + "\n"
    MODULE.write_bytes(module(of_page))
    DATA.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
