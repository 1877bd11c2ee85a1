"""A WebAssembly module with one exported function for each lowered function, or each function that keeps its loops.

The target needs LLVM's linker, ``wasm-ld``, and clang for functions with loops (`looped`); who only runs a module needs
nothing but the module. `kernels.mjs`, beside
this file, runs one from JavaScript.

What is computed once for a person is apart from what is computed at every sample, so that a caller can go through the
samples of several functions in turn. A lowered function is therefore exported as two, which take 32-bit whole numbers:

- ``NAME_hold``: the address of `held`, which begins with the numbers of `person` and has room for `held_numbers` more.
- ``NAME``: the addresses of `held`, `carry`, `own`, `shared` and `outputs`, and the number of samples.

Both take one vector of people, `lanes` of them: `held` and `carry` are (numbers, lanes) arrays, `own` and `outputs`
(samples, numbers, lanes), and `shared` (samples, numbers).

A module exports its ``memory`` and ``__heap_base``, the address from which the caller may use it; addresses have to be
multiples of 16.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered
from glucoloop.native.targets.llvm.emit import Emitter
from glucoloop.native.targets.products import STRICT
from glucoloop.native.targets.wasm.looped import Looped, looped_object
from glucoloop.private_folder import private_temporary_folder
from glucoloop.refusal import Refusal

HOST: Final = Path(__file__).with_name("kernels.mjs")
"""JavaScript that runs the functions of a module."""
VECTOR_BYTES: Final = 16
LINKER: Final = "wasm-ld"
_TRIPLE: Final = "wasm32-unknown-unknown"
# The oldest processor model: newer ones have features that older linkers do not know.
_PROCESSOR, _FEATURES = "mvp", "+simd128"
_STACK_BYTES: Final = 1 << 20


def lanes(precision: str) -> int:
    """Number of people side by side in one vector."""
    return VECTOR_BYTES // (8 if precision == DOUBLE else 4)


def linker() -> str | None:
    """Path of LLVM's linker for WebAssembly, or None where it is not installed."""
    return shutil.which(LINKER)


def linker_version() -> str:
    """Version of the linker, as it tells it."""
    return subprocess.run([_linker(), "--version"], capture_output=True, text=True, check=True).stdout.strip()


def _linker() -> str:
    program = linker()
    if program is None:
        raise Refusal(f"{LINKER} is not installed, and WebAssembly needs it; on Debian: apt install lld")
    return program


def wasm_module(functions: Mapping[str, Lowered | Looped]) -> bytes:
    """Compile and link functions as one module, by the names under which it exports them, identifiers of C.

    The module is the same for the same functions and versions of llvmlite, of clang and of the linker.
    """
    for name in functions:
        if not name.isidentifier() or not name.isascii():
            raise Refusal(f"{name!r} cannot be the name of a function; give letters, digits and _")
    program = _linker()
    with private_temporary_folder("glucoloop-wasm-") as place:
        objects = []
        for name, function in functions.items():
            objects.append(place / f"{name}.o")
            if isinstance(function, Looped):
                code = looped_object(name, function, lanes(function.precision), place)
            else:
                code = object_code(name, function)
            objects[-1].write_bytes(code)
        linked = place / "module.wasm"
        options = ["--no-entry", "--strip-all", "--export=__heap_base", "-z", f"stack-size={_STACK_BYTES}"]
        exports = [f"--export={name}{ending}" for name in functions for ending in ("", "_hold")]
        command = [program, *options, *exports, "-o", str(linked), *map(str, objects)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Refusal(f"{LINKER} failed: {done.stderr.strip()}")
        return linked.read_bytes()


def held_numbers(function: Lowered | Looped) -> int:
    """Number of values that a function holds for each person from sample to sample."""
    return 0 if isinstance(function, Looped) else _emitter(function, "function").held


def object_code(name: str, lowered: Lowered) -> bytes:
    """Object file of one lowered function, for the linker."""
    from llvmlite import binding

    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    module = binding.parse_assembly(f'target triple = "{_TRIPLE}"\n{_emitter(lowered, name).text()}')
    module.verify()
    target = binding.Target.from_triple(_TRIPLE)
    code: bytes = target.create_target_machine(cpu=_PROCESSOR, features=_FEATURES, opt=2).emit_object(module)
    return code


def _emitter(lowered: Lowered, name: str) -> Emitter:
    return Emitter(lowered, STRICT, lanes(lowered.precision), apart=name)
