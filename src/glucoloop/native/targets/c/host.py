"""Execution of the C on this machine: compiled by its C compiler, and called with arrays."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.native.targets.c.numbers import REAL
from glucoloop.native.targets.c.records import Structure
from glucoloop.native.targets.c.source import HEADER, Source

Array = npt.NDArray[Any]

FLAGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")


def compiler() -> str | None:
    """The C compiler of this machine, if it has one."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


class Library:
    """A controller in C, compiled for this machine; what the C compiler refuses is refused with its words."""

    def __init__(self, source: Source, precision: str, optimise: str = "-O1") -> None:
        found = compiler()
        if found is None:
            raise FileNotFoundError("there is no C compiler on this machine")
        self._source, self._real = source, np.dtype(precision)
        with tempfile.TemporaryDirectory(prefix="glucoloop-c-") as name:
            folder = Path(name)
            (folder / HEADER).write_text(source.header)
            (folder / "controller.c").write_text(source.code)
            command = [found, *FLAGS, *optimise.split(), "-shared", "-fPIC", "-o", "controller.so", "controller.c"]
            made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            if made.returncode:
                raise ValueError(f"the C compiler refuses the code: {made.stderr.strip()[:2000]}")
            self._code = ctypes.CDLL(str(folder / "controller.so"))
        real = ctypes.c_float if self._real.itemsize == 4 else ctypes.c_double
        self._structures = {name: _structure(name, of, real) for name, of in source.records.items()}
        w, k, b = source.workspace.values()
        self._workspace = np.zeros(w * self._real.itemsize + 4 * k + b + 64, np.uint8)

    def init(self, observation: Sequence[Any]) -> list[Array]:
        """The leaves of the state of a controller that starts at an observation."""
        state = self._structures["state"]()
        seen = self._filled("observation", observation)
        self._code.gl_init(ctypes.c_void_p(self._workspace.ctypes.data), ctypes.byref(state), ctypes.byref(seen))
        return self._leaves("state", state)

    def step(self, state: Sequence[Any], observation: Sequence[Any]) -> tuple[list[Array], list[Array]]:
        """The leaves of the next state and of the decision."""
        held, seen = self._filled("state", state), self._filled("observation", observation)
        decided = self._structures["decision"]()
        self._code.gl_step(
            ctypes.c_void_p(self._workspace.ctypes.data), ctypes.byref(held), ctypes.byref(seen), ctypes.byref(decided)
        )
        return self._leaves("state", held), self._leaves("decision", decided)

    def saved(self, state: Sequence[Any]) -> bytes:
        """Structure of a state."""
        room = (ctypes.c_uint8 * self._source.record_bytes)()
        self._code.gl_save(ctypes.byref(self._filled("state", state)), room)
        return bytes(room)

    def restored(self, record: bytes) -> list[Array] | None:
        """Leaves of the state of a record; None if it is refused."""
        room = (ctypes.c_uint8 * self._source.record_bytes)(*record)
        state = self._structures["state"]()
        self._code.gl_restore.restype = ctypes.c_bool
        return self._leaves("state", state) if self._code.gl_restore(ctypes.byref(state), room) else None

    def _filled(self, name: str, leaves: Sequence[Any]) -> Any:
        structure = self._structures[name]()
        for field, leaf in zip(self._source.records[name].fields, leaves, strict=True):
            if field.size:
                held = getattr(structure, field.name)
                np.frombuffer(held, held._type_)[:] = np.asarray(leaf).ravel()
        return structure

    def _leaves(self, name: str, structure: Any) -> list[Array]:
        return [
            np.array(getattr(structure, field.name, ()), None if field.size else self._real).reshape(field.shape)
            for field in self._source.records[name].fields
        ]


def _structure(name: str, of: Structure, real: Any) -> Any:
    """Structure with the layout of C: real numbers first."""
    held = [field for field in of.fields if field.size]
    ordered = sorted(held, key=lambda field: field.kind != REAL)
    fields = [(f.name, (real if f.kind == REAL else ctypes.c_int32) * f.size) for f in ordered]
    return type(name, (ctypes.Structure,), {"_fields_": fields or [("reserved", ctypes.c_int32)]})
