"""Links to a chip: an emulated one as a process, whose power can be cut, or a board at a serial port."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Protocol

from glucoloop.firmware.hil.build import NVM
from glucoloop.firmware.hil.protocol import Plan
from glucoloop.refusal import Refusal

try:
    import termios
except ImportError:  # Windows
    termios = None  # type: ignore[assignment]

_PLAN: Final = struct.Struct("<II")
_CHUNK: Final = 4096
_LONGEST_SEND_S: Final = 1.0
_LONGEST_RESET_S: Final = 10.0
_LONGEST_QUIT_S: Final = 2.0
_GATHER_S: Final = 30e-6
_TALK: Final = b'{"execute": "qmp_capabilities"}\n'
_RESET: Final = b'{"execute": "system_reset"}\n'
_QUIT: Final = b'{"execute": "quit"}\n'
_WAS_RESET: Final = b"host-qmp-system-reset"
"""Reason of a reset from here, in the words of QEMU; the chip's own resets have another one."""


class Link(Protocol):
    """Bytes to and from a chip."""

    def send(self, data: bytes) -> None:
        """Send bytes. They are lost if there is nobody to receive them."""

    def receive(self, wait_s: float) -> bytes:
        """Bytes that have come, after waiting for some; none if none came in that time."""

    def close(self) -> None:
        """Leave the chip; nothing goes on running."""


class ProcessLink:
    """An emulated chip: a process whose standard input and output are the line, in the folder of its memory.

    Its standard error is the switch of its power: it is reset there by the protocol of QEMU's monitor, QMP. The planned
    failure stands at the place `plan_at` of its non-volatile memory.
    """

    def __init__(self, command: Sequence[str], folder: Path, plan_at: int) -> None:
        self._command, self._folder, self._plan_at = command, folder, plan_at
        self._process: subprocess.Popen[bytes] | None = None
        self._switch: socket.socket | None = None
        (folder / NVM).write_bytes(b"\xff" * (plan_at + _PLAN.size))
        self.power_on()

    def power_on(self, plan: Plan = Plan.NONE, after_bytes: int = 0) -> None:
        """Start the chip, which perhaps fails once it has written so many bytes to its memory."""
        self._write_plan(plan, after_bytes)
        self._switch, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                self._command,
                cwd=self._folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=theirs.fileno(),
                bufsize=0,
                start_new_session=True,  # Ctrl-C is for this program, which ends the chip itself
            )
        _on_one_core(self._process.pid)
        self._switch.settimeout(_LONGEST_RESET_S)
        self._switch.sendall(_TALK)

    def cut_power(self, plan: Plan = Plan.NONE, after_bytes: int = 0) -> None:
        """Cut the power for a moment, wherever the chip is; `plan` and `after_bytes` are as for `power_on`.

        What is in non-volatile memory stays, and so do bytes on the line that the chip has not read yet.
        """
        self._write_plan(plan, after_bytes)
        if self._switch is None or not _was_reset(self._switch):
            self.power_off()
            raise Refusal(f"the emulator did not reset the chip within {_LONGEST_RESET_S:g} s; run it again")

    def power_off(self) -> None:
        """Cut the power: the process ends at once, wherever it is."""
        process, self._process = self._process, None
        if process is None:
            return
        if self._switch is not None:
            with contextlib.suppress(OSError), self._switch as switch:
                switch.sendall(_QUIT)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            process.wait(_LONGEST_QUIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def send(self, data: bytes) -> None:
        """Send bytes; without power they are lost."""
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(data)

    def receive(self, wait_s: float) -> bytes:
        """Bytes from the chip. One that was reset, or whose power failed, is started again."""
        if self._process is None or self._process.stdout is None:
            return b""
        line = self._process.stdout.fileno()
        if not select.select([line], [], [], wait_s)[0]:
            return b""
        time.sleep(_GATHER_S)  # bytes come one by one, and each reading takes the core from the emulator
        data = os.read(line, _CHUNK)
        if not data:
            self.power_off()
            self.power_on()
        return data

    def close(self) -> None:
        """End the process."""
        self.power_off()

    def _write_plan(self, plan: Plan, after_bytes: int) -> None:
        with (self._folder / NVM).open("r+b") as memory:
            memory.seek(self._plan_at)
            memory.write(_PLAN.pack(plan, after_bytes))


def _on_one_core(pid: int) -> None:
    """Bind a process that has just begun to one core.

    The chip and its line are threads of the emulator, of which one waits for the other at every byte. On two cores that
    takes several times as long as on one.
    """
    if sys.platform == "linux":
        cores = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):
            os.sched_setaffinity(pid, {cores[pid % len(cores)]})


def _was_reset(switch: socket.socket) -> bool:
    """Ask for a reset, and wait until it has happened; False if it does not."""
    output = b""
    try:
        switch.sendall(_RESET)
        while _WAS_RESET not in output:
            more = switch.recv(_CHUNK)
            if not more:
                return False
            output += more
    except OSError:
        return False
    return True


class SerialLink:
    """A board at a serial port, such as ``/dev/ttyACM0``, by the standard library's termios."""

    def __init__(self, path: str, baud: int = 115200) -> None:
        if termios is None:
            raise Refusal("serial ports are supported on POSIX systems only; take --chip host")
        rate = getattr(termios, f"B{baud}", None)
        if rate is None:
            raise Refusal(f"a serial port cannot have {baud} baud; 9600, 115200 and 921600 are usual")
        try:
            self._port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise Refusal(f"the serial port {path} cannot be opened: {error.strerror}; check --chip") from None
        try:
            # input, output, control, local, input rate, output rate, characters: raw, 8 bits, no parity, one stop bit
            settings = termios.tcgetattr(self._port)
            control = termios.CS8 | termios.CREAD | termios.CLOCAL
            termios.tcsetattr(self._port, termios.TCSANOW, [0, 0, control, 0, rate, rate, settings[6]])
            termios.tcflush(self._port, termios.TCIOFLUSH)
        except termios.error:
            os.close(self._port)
            raise Refusal(f"{path} is no serial port; check --chip") from None

    def send(self, data: bytes) -> None:
        """Send bytes; those that the port does not take within a second are lost."""
        until = time.monotonic() + _LONGEST_SEND_S
        while data and time.monotonic() < until:
            select.select([], [self._port], [], _LONGEST_SEND_S)
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._port, data) :]

    def receive(self, wait_s: float) -> bytes:
        """Bytes from the board."""
        if not select.select([self._port], [], [], wait_s)[0]:
            return b""
        with contextlib.suppress(BlockingIOError):
            return os.read(self._port, _CHUNK)
        return b""

    def close(self) -> None:
        """Close the port; the board keeps its power."""
        os.close(self._port)
