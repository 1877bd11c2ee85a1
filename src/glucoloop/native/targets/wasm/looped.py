"""Functions that keep their loops, for WebAssembly: the compact form of C, compiled by clang.

A scalar program has every turn of a loop written out, so that a controller which solves a program of its own at each
sample would be megabytes long. Its C has the loops. `wasm_module` exports it as it exports a lowered function; it holds
nothing of a person beside the numbers of `person`.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

from glucoloop.native.functions import DOUBLE
from glucoloop.native.targets.c.numbers import FORMATS, REAL, Format
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
    code = "\n".join([looped.source.code, *_entry(name, looped, lanes), ""])
    (folder / "function.c").write_text(code)
    renamed = [f"-D{own}={name}_{own}" for own in _OWN_NAMES]
    command = [_compiler(), *_FLAGS, f"-I{_LIBRARY}", *renamed, "-c", "-o", "function.o", "function.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Refusal(f"clang refuses the code of {name}: {done.stderr.strip()[:2000]}")
    return (folder / "function.o").read_bytes()


def _entry(name: str, looped: Looped, lanes: int) -> list[str]:
    """The two exported functions, which go through the samples and people of a vector.

    Who is shown and keeps the same numbers as the first person of the vector gets the results of that person.
    """
    format, records = FORMATS[looped.precision], looped.source.records
    seen, state, decision = (records[group].fields for group in ("observation", "state", "decision"))
    own, person = ([field for field in seen if field.path.startswith(f"['{group}']")] for group in ("own", "person"))
    if len(own) + len(person) != len(seen):
        raise ValueError(f"the observation of {name} has fields beside those of own and person")
    rows = {"held": _size(person), "carry": 0 if looped.wakes else _size(state), "own": _size(own)}
    results = {"state": state} if looped.wakes else {"decision": decision}
    rows["outputs"] = sum(map(_size, results.values()))
    taken = [
        *_moves("held", person, "seen", "0", False, format),
        *_moves("own", own, "seen", "sample", False, format),
        *([] if looped.wakes else _moves("carry", state, "state", "0", False, format)),
    ]
    given = [
        *([] if looped.wakes else _moves("carry", state, "state", "0", True, format)),
        *(
            line
            for group, fields in results.items()
            for line in _moves("outputs", fields, group, "sample", True, format)
        ),
    ]
    call = "gl_init(&workspace, &state, &seen);" if looped.wakes else "gl_step(&workspace, &state, &seen, &decision);"
    inputs = [(group, "0" if group != "own" else "sample") for group in ("held", "own", "carry") if rows[group]]
    outputs = [(group, "0" if group == "carry" else "sample") for group in ("carry", "outputs") if rows[group]]
    exported = '__attribute__((visibility("default")))'
    real = format.type
    return [
        f"enum {{ LANES = {lanes}, {', '.join(f'{group.upper()} = {count}' for group, count in rows.items())} }};",
        "#define AT(group, rows, sample, i, lane) group[((sample) * (rows) + (i)) * LANES + (lane)]",
        f"{exported} void {name}_hold({real} *held);",
        f"{exported} void {name}(const {real} *held, {real} *carry, const {real} *own, const {real} *shared,",
        f"  {real} *outputs, uint32_t samples);",
        f"void {name}_hold({real} *held)",
        "{",
        "(void)held;",
        "}",
        f"void {name}(const {real} *held, {real} *carry, const {real} *own, const {real} *shared, {real} *outputs,",
        "  uint32_t samples)",
        "{",
        "static gl_workspace workspace;",
        "(void)held; (void)carry; (void)shared;",
        "for (uint32_t sample = 0; sample < samples; sample++)",
        "{",
        "bool alike[LANES];",
        "for (int lane = 0; lane < LANES; lane++)",
        "{",
        "alike[lane] = lane > 0;",
        *(
            f"for (int i = 0; i < {group.upper()}; i++) alike[lane] = alike[lane] && "
            f"(AT({group}, {group.upper()}, {sample}, i, lane) == AT({group}, {group.upper()}, {sample}, i, 0));"
            for group, sample in inputs
        ),
        "}",
        "for (int lane = 0; lane < LANES; lane++)",
        "{",
        "if (alike[lane])",
        "{",
        *(
            f"for (int i = 0; i < {group.upper()}; i++) "
            f"AT({group}, {group.upper()}, {sample}, i, lane) = AT({group}, {group.upper()}, {sample}, i, 0);"
            for group, sample in outputs
        ),
        "continue;",
        "}",
        "gl_observation seen;",
        "gl_state state;",
        *([] if looped.wakes else ["gl_decision decision;"]),
        *taken,
        call,
        *given,
        "}",
        "}",
        "}",
    ]


def _size(fields: Sequence[Field]) -> int:
    return sum(field.size for field in fields)


def _moves(group: str, fields: Sequence[Field], structure: str, sample: str, out: bool, format: Format) -> list[str]:
    """Statements that move the numbers of a group to a structure or, with `out`, back."""
    lines, at = [], 0
    for field in fields:
        inside = f"{structure}.{field.name}" + ("[i]" if field.is_array else "")
        there = f"AT({group}, {group.upper()}, {sample}, {at} + i, lane)"
        move = f"{there} = ({format.type}){inside};"
        if not out:
            move = f"{inside} = {there};" if field.kind == REAL else f"{inside} = (int32_t){there};"
        lines.append(f"for (int i = 0; i < {field.size}; i++) {move}")
        at += field.size
    return lines
