"""Functions that keep their loops, for WebAssembly: the compact form of C, compiled by clang.

A scalar program keeps long loops, but writes out what is done in a round, product by product, so that a controller
which solves a program of its own at each sample would be more than a megabyte long. Its C has products of matrices as
loops too, and is 20 kB. `wasm_module` exports it as it exports a lowered function; it holds nothing of a person beside
the numbers of `person`. `entry.c` has the functions that are exported.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

from glucoloop.native.functions import DOUBLE
from glucoloop.native.targets.c.numbers import FORMATS, REAL
from glucoloop.native.targets.c.records import Field
from glucoloop.native.targets.c.source import HEADER, Source
from glucoloop.refusal import Refusal

COMPILERS: Final = ("clang", "clang-14")
_FLAGS: Final = (
    *("--target=wasm32", "-std=c99", "-Os", "-ffp-contract=off", "-fno-builtin", "-nostdlibinc"),
    *("-mbulk-memory", "-ffunction-sections", "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror"),
)
_OWN_NAMES: Final = ("gl_init", "gl_step", "gl_save", "gl_restore")
_LIBRARY: Final = files("glucoloop.native.targets.wasm").joinpath("library")
"""The two headers of C's library that the code includes, as far as it uses them."""
_ENTRY: Final = files("glucoloop.native.targets.wasm").joinpath("entry.c")


@dataclass(frozen=True)
class Looped:
    """One of the two functions of a controller in C; its observation has the groups ``own`` and ``person``."""

    source: Source
    wakes: bool
    """Whether it is the one that gives the state at the start, as its outputs."""
    precision: str = DOUBLE


def c_compiler() -> str | None:
    """Path of clang, or None where it is not installed."""
    return next(filter(None, map(shutil.which, COMPILERS)), None)


def c_compiler_version() -> str:
    """First line of what clang tells of its version."""
    return subprocess.run([_compiler(), "--version"], capture_output=True, text=True, check=True).stdout.split("\n")[0]


def _compiler() -> str:
    program = c_compiler()
    if program is None:
        raise Refusal("clang is not installed, and functions with loops need it; on Debian: apt install clang")
    return program


def looped_object(name: str, looped: Looped, lanes: int, folder: Path) -> bytes:
    """Object file of a function, for the linker, made in a folder."""
    (folder / HEADER).write_text(looped.source.header)
    (folder / "function.c").write_text(f"{looped.source.code}\n{_entry(name, looped, lanes)}")
    renamed = [f"-D{own}={name}_{own}" for own in _OWN_NAMES]
    command = [_compiler(), *_FLAGS, f"-I{_LIBRARY}", *renamed, "-c", "-o", "function.o", "function.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Refusal(f"clang refuses the code of {name}: {done.stderr.strip()[:2000]}")
    return (folder / "function.o").read_bytes()


def _entry(name: str, looped: Looped, lanes: int) -> str:
    """The two exported functions."""
    records, format = looped.source.records, FORMATS[looped.precision]
    observed, state, decision = (records[group].fields for group in ("observation", "state", "decision"))
    own, person = ([f for f in observed if f.path.startswith(f"['{group}']")] for group in ("own", "person"))
    if len(own) + len(person) != len(observed):
        raise ValueError(f"the observation of {name} has fields beside those of own and person")
    carry = [] if looped.wakes else state
    results, result = (state, "state") if looped.wakes else (decision, "decision")
    groups = {"held": person, "own": own, "carry": carry, "outputs": results}
    taken = [*_moves("held", person, "seen"), *_moves("own", own, "seen"), *_moves("carry", carry, "state")]
    called = ["gl_init(&workspace, &state, &seen);"]
    if not looped.wakes:
        called = ["gl_decision decision;", "gl_step(&workspace, &state, &seen, &decision);"]
    given = [*_moves("carry", carry, "state", out=True), *_moves("outputs", results, result, out=True)]
    texts = {
        **{group: str(sum(field.size for field in fields)) for group, fields in groups.items()},
        **{"name": name, "lanes": str(lanes), "step": "\n      ".join([*taken, *called, *given])},
    }
    filled = re.sub(r"@(held|own|carry|outputs|name|lanes|step)@", lambda output: texts[output[1]], _ENTRY.read_text())
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
