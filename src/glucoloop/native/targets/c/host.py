"""Execution of the C on this machine: compiled by its C compiler, and called with arrays."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.native.targets.c.source import HEADER, Source
from glucoloop.private_folder import private_temporary_folder

Array = npt.NDArray[Any]

_FLAGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")


def compiler() -> str | None:
    """The C compiler of this machine, if it has one."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


class Library:
    """A controller in C, compiled for this machine; what the C compiler refuses is refused with its words."""

    def __init__(self, source: Source, precision: str, optimise: str = "-O1") -> None:
        result = compiler()
        if result is None:
            raise FileNotFoundError("there is no C compiler on this machine")
        self._source, self._precision = source, precision
        with private_temporary_folder("glucoloop-c-") as folder:
            (folder / HEADER).write_text(source.header)
            (folder / "controller.c").write_text(source.code)
            command = [result, *_FLAGS, *optimise.split(), "-shared", "-fPIC", "-o", "controller.so", "controller.c"]
            process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            if process.returncode:
                raise ValueError(f"the C compiler refuses the code: {process.stderr.strip()[:2000]}")
            self._code = ctypes.CDLL(str(folder / "controller.so"))
        w, k, b = source.workspace.values()
        self._workspace = np.zeros(w * np.dtype(precision).itemsize + 4 * k + b + 64, np.uint8)

    def init(self, observation: Sequence[Any]) -> list[Array]:
        """The leaves of the state of a controller that starts at an observation."""
        state, observation_memory = self._empty("state"), self._filled("observation", observation)
        self._code.gl_init(*map(_pointer, (self._workspace, state, observation_memory)))
        return self._leaves("state", state)

    def step(self, state: Sequence[Any], observation: Sequence[Any]) -> tuple[list[Array], list[Array]]:
        """The leaves of the next state and of the decision."""
        state_memory, observation_memory = self._filled("state", state), self._filled("observation", observation)
        decision = self._empty("decision")
        self._code.gl_step(*map(_pointer, (self._workspace, state_memory, observation_memory, decision)))
        return self._leaves("state", state_memory), self._leaves("decision", decision)

    def saved(self, state: Sequence[Any]) -> bytes:
        """Record of a state."""
        room = np.zeros(self._source.record_bytes, np.uint8)
        self._code.gl_save(_pointer(self._filled("state", state)), _pointer(room))
        return room.tobytes()

    def restored(self, record: bytes) -> list[Array] | None:
        """Leaves of the state of a record; None if it is refused."""
        room = np.zeros(self._source.record_bytes, np.uint8)
        room[: len(record)] = np.frombuffer(record, np.uint8)
        state = self._empty("state")
        self._code.gl_restore.restype = ctypes.c_bool
        return self._leaves("state", state) if self._code.gl_restore(_pointer(state), _pointer(room)) else None

    def _empty(self, name: str) -> Array:
        return np.zeros((), self._source.records[name].memory(self._precision))

    def _filled(self, name: str, leaves: Sequence[Any]) -> Array:
        return self._source.records[name].filled(leaves, self._precision)

    def _leaves(self, name: str, room: Array) -> list[Array]:
        return self._source.records[name].leaves(room, self._precision)


def _pointer(memory: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(memory.ctypes.data)
