"""WebAssembly of lowered functions: a module with one exported function for each of them, for browsers and node.

It is the vector code of `glucoloop.native.targets.llvm`, or C. WebAssembly has no fused multiply-add that rounds alike
everywhere, so products are strict, and every engine gives the bits of strict code on any other processor. Only the bits
of what is not a number may differ.

A scalar program keeps long loops, but writes out what is done in a round, product by product, so that a controller
which solves a program of its own at each sample would be more than a megabyte long. The compact form of its C has
products of matrices as loops too, and is 20 kB; clang compiles it, with `entry.c` for what is exported.

The target needs LLVM's linker, ``wasm-ld``, and clang for functions in C; who only runs a module needs nothing but the
module. `kernels.mjs`, beside this file, runs one from JavaScript.

What is computed once for a person is apart from what is computed at every sample, so that a caller can go through the
samples of several functions in turn. A lowered function is therefore exported as two, which take 32-bit whole numbers:

- ``NAME_per_person``: the address of `per_person`, which begins with the numbers of `person` and has room for
  `numbers_per_person` more, which it computes.
- ``NAME``: the addresses of `per_person`, `carry`, `own`, `shared` and `outputs`, and the number of samples.

Both take one vector of people, `lanes` of them: `per_person` and `carry` are (numbers, lanes) arrays, `own` and
`outputs` (samples, numbers, lanes), and `shared` (samples, numbers).

A module exports its ``memory`` and ``__heap_base``, the address from which the caller may use it; addresses have to be
multiples of 16.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered
from glucoloop.native.targets import STRICT
from glucoloop.native.targets.c.numbers import FORMATS, REAL
from glucoloop.native.targets.c.records import Field
from glucoloop.native.targets.c.source import HEADER, Source
from glucoloop.native.targets.llvm.emit import Emitter
from glucoloop.private_folder import private_temporary_folder
from glucoloop.refusal import Refusal

_HOST: Final = Path(__file__).with_name("kernels.mjs")
"""JavaScript that runs the functions of a module."""
_VECTOR_BYTES: Final = 16
_LINKER: Final = "wasm-ld"
_TRIPLE: Final = "wasm32-unknown-unknown"
# The oldest processor model: newer ones have features that older linkers do not know.
_PROCESSOR, _FEATURES = "mvp", "+simd128"
_STACK_BYTES: Final = 1 << 20


def lanes(precision: str) -> int:
    """Number of people side by side in one vector."""
    return _VECTOR_BYTES // (8 if precision == DOUBLE else 4)


def _linker_path() -> str | None:
    """Path of LLVM's linker for WebAssembly, or None where it is not installed."""
    return shutil.which(_LINKER)


def _linker() -> str:
    program = _linker_path()
    if program is None:
        raise Refusal(f"{_LINKER} is not installed, and WebAssembly needs it; on Debian: apt install lld")
    return program


def wasm_module(functions: Mapping[str, Lowered | CFunction]) -> bytes:
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
            if isinstance(function, CFunction):
                code = _object_of_c(name, function, lanes(function.precision), place)
            else:
                code = _object_of_program(name, function)
            objects[-1].write_bytes(code)
        linked = place / "module.wasm"
        options = ["--no-entry", "--strip-all", "--export=__heap_base", "-z", f"stack-size={_STACK_BYTES}"]
        exports = [f"--export={name}{ending}" for name in functions for ending in ("", "_per_person")]
        command = [program, *options, *exports, "-o", str(linked), *map(str, objects)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Refusal(f"{_LINKER} failed: {done.stderr.strip()}")
        return linked.read_bytes()


def numbers_per_person(function: Lowered | CFunction) -> int:
    """Number of values that a function computes once for each person."""
    return 0 if isinstance(function, CFunction) else _emitter(function, "function").per_person


def tool_versions() -> dict[str, str]:
    """Versions of clang and of the linker, as they print them."""
    programs = {"clang": _compiler(), "linker": _linker()}
    outputs = {name: _run([program, "--version"]) for name, program in programs.items()}
    return {"clang": outputs["clang"].split("\n")[0], "linker": outputs["linker"].strip()}


def _run(command: list[str]) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def _object_of_program(name: str, lowered: Lowered) -> bytes:
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


_COMPILERS: Final = ("clang", "clang-14")
_FLAGS: Final = (
    *("--target=wasm32", "-std=c99", "-Os", "-ffp-contract=off", "-fno-builtin", "-nostdlibinc"),
    *("-mbulk-memory", "-ffunction-sections", "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror"),
)
_OWN_NAMES: Final = ("gl_init", "gl_step", "gl_save", "gl_restore")
_LIBRARY: Final = files("glucoloop.native.targets.wasm").joinpath("library")
"""The two headers of C's library that the code includes, as far as it uses them."""
_ENTRY: Final = files("glucoloop.native.targets.wasm").joinpath("entry.c")


@dataclass(frozen=True)
class CFunction:
    """One of the two functions of a controller in C; its observation has the groups ``own`` and ``person``."""

    source: Source
    is_init: bool
    """Whether it is init, whose outputs are the state at the start; otherwise it is step."""
    precision: str = DOUBLE


def _clang_path() -> str | None:
    """Path of clang, or None where it is not installed."""
    return next(filter(None, map(shutil.which, _COMPILERS)), None)


def _compiler() -> str:
    program = _clang_path()
    if program is None:
        raise Refusal("clang is not installed, and functions with loops need it; on Debian: apt install clang")
    return program


def _object_of_c(name: str, function: CFunction, lanes: int, folder: Path) -> bytes:
    """Object file of a function, for the linker, made in a folder."""
    (folder / HEADER).write_text(function.source.header)
    (folder / "function.c").write_text(f"{function.source.code}\n{_entry(name, function, lanes)}")
    renamed = [f"-D{own}={name}_{own}" for own in _OWN_NAMES]
    command = [_compiler(), *_FLAGS, f"-I{_LIBRARY}", *renamed, "-c", "-o", "function.o", "function.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Refusal(f"clang refuses the code of {name}: {done.stderr.strip()[:2000]}")
    return (folder / "function.o").read_bytes()


def _entry(name: str, function: CFunction, lanes: int) -> str:
    """The two exported functions."""
    records, format = function.source.records, FORMATS[function.precision]
    observed, state, decision = (records[group].fields for group in ("observation", "state", "decision"))
    own, person = ([f for f in observed if f.path.startswith(f"['{group}']")] for group in ("own", "person"))
    if len(own) + len(person) != len(observed):
        raise ValueError(f"the observation of {name} has fields beside those of own and person")
    carry = [] if function.is_init else state
    results, result = (state, "state") if function.is_init else (decision, "decision")
    groups = {"per_person": person, "own": own, "carry": carry, "outputs": results}
    inputs = [
        *_moves("per_person", person, "observation"),
        *_moves("own", own, "observation"),
        *_moves("carry", carry, "state"),
    ]
    calls = ["gl_init(&workspace, &state, &observation);"]
    if not function.is_init:
        calls = ["gl_decision decision;", "gl_step(&workspace, &state, &observation, &decision);"]
    results_out = [*_moves("carry", carry, "state", out=True), *_moves("outputs", results, result, out=True)]
    texts = {
        **{group: str(sum(field.size for field in fields)) for group, fields in groups.items()},
        **{"name": name, "lanes": str(lanes), "step": "\n      ".join([*inputs, *calls, *results_out])},
    }
    filled = re.sub(
        r"@(per_person|own|carry|outputs|name|lanes|step)@", lambda output: texts[output[1]], _ENTRY.read_text()
    )
    return filled.replace("@real@", format.type)


def _moves(group: str, fields: Sequence[Field], structure: str, *, out: bool = False) -> list[str]:
    """Statements that move the numbers of a group to a structure or, with `out`, back."""
    lines, at = [], 0
    for field in fields:
        inside, there = f"{structure}.{field.name}" + ("[i]" if field.is_array else ""), f"AT({group}, {at} + i)"
        to, of = (there, inside) if out else (inside, there)
        cast = "(@real@)" if out else "" if field.kind == REAL else "(int32_t)"
        lines.append(f"for (int32_t i = 0; i < {field.size}; i++) {to} = {cast}{of};")
        at += field.size
    return lines
