"""The firmware of a controller: its files in C, and the program that they make for a chip or for this computer."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from glucoloop.firmware.chips import CHIPS, LINK, Chip, template
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.hil.protocol import Payloads, header
from glucoloop.native.targets.c.host import compiler
from glucoloop.refusal import Refusal

_HERE: Final = "glucoloop.firmware.hil"
HOST: Final = "host"
"""Name of this computer as a chip."""
NVM: Final = "nvm.bin"
"""Non-volatile memory of an emulated board, in the folder in which it runs."""
_PORTABLE: Final = ("frame.h", "frame.c", "store.h", "store.c", "board.h", "hil.c")
"""Files that every board uses as they are."""
_WARNINGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic")
_EMULATED: Final = ("emulated.h", "emulated.c")
_BOARDS: Final = {
    HOST: (*_EMULATED, "host.c"),
    "cortex-m4f": (*_EMULATED, "semihosting.c", "mps2.c"),
    "cortex-m7": (*_EMULATED, "semihosting.c", "mps2.c"),
    "rv32": (*_EMULATED, "semihosting.c", "virt.c"),
}
_IMAGE: Final = "image.bin"
_VECTORS: Final = "vectors.bin"
_VECTORS_BYTES: Final = 8
"""Stack and first instruction of a Cortex-M, at address 0."""


@dataclass(frozen=True)
class _Memory:
    """The memory of an emulated board that holds the program; QEMU takes its content from a file.

    A program that QEMU loads itself is written to memory again with each reset, and translated again.
    """

    at: str
    size: int
    vectors: bool


_MEMORY: Final = {
    "cortex-m4f": _Memory("0x21000000", 16 << 20, vectors=True),
    "cortex-m7": _Memory("0x60000000", 16 << 20, vectors=True),
    "rv32": _Memory("0x80000000", 128 << 20, vectors=False),
}
_INSTRUCTION_TIME: Final = "shift=6"
"""Each instruction takes 64 ns of the emulated time: a loaded computer delays no step beyond the watchdog's time."""


def portable_files(exported: Exported) -> dict[str, str]:
    """Files of the firmware for any board, which brings the functions of ``board.h``."""
    source = exported.source
    return {
        "controller.h": source.header,
        "controller.c": source.code,
        "link.h": header(source, Payloads(source, exported.precision)),
        **{name: template(name, _HERE) for name in _PORTABLE},
    }


def files(exported: Exported, chip: str) -> dict[str, str]:
    """All files of the firmware for an emulated chip."""
    of_board = {name: template(name, _HERE) for name in _BOARDS[chip]}
    if chip in CHIPS:
        target = CHIPS[chip]
        of_board |= {name: template(name) for name in ("chip.c", "chip.h", *target.support(exported.precision)[0])}
        of_board["chip.ld"] = template("chip.ld").replace("@FLASH@", _MEMORY[chip].at).replace("@RAM@", target.ram)
    return portable_files(exported) | of_board


def refuse_missing_tools(chip: str) -> None:
    """Refuse an emulated chip whose tools are not installed, with the package that brings the first missing one."""
    if chip == HOST:
        if compiler() is None:
            raise Refusal("there is no C compiler on this machine; Debian's package gcc brings one")
    elif missing := CHIPS[chip].missing:
        raise Refusal(f"{chip} cannot be emulated: {missing}, or take --chip host")


def build(exported: Exported, chip: str, folder: Path, extra: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Write and compile the firmware for an emulated chip in an empty folder, and give the command that runs it."""
    refuse_missing_tools(chip)
    texts = files(exported, chip)
    for name, text in texts.items():
        (folder / name).write_text(text)
    sources = sorted(name for name in texts if name.endswith(".c"))
    if chip == HOST:
        _compile([str(compiler()), *_WARNINGS, *extra, "-O1", "-ffp-contract=off", "-o", "firmware", *sources], folder)
        return (str(folder / "firmware"),)
    target = CHIPS[chip]
    _, support_flags = target.support(exported.precision)
    flags = [*_WARNINGS, *extra, "-O2", "-ffp-contract=off", *target.flags, *LINK, *support_flags]
    flags += ["-fno-tree-loop-distribute-patterns"]
    _compile([target.compiler, *flags, "-o", "firmware.elf", *sources, "-lgcc"], folder)
    _compile([target.compiler.replace("gcc", "objcopy"), "-O", "binary", "firmware.elf", _IMAGE], folder)
    with (folder / _IMAGE).open("r+b") as image:
        (folder / _VECTORS).write_bytes(image.read(_VECTORS_BYTES))
        image.truncate(_MEMORY[chip].size)
    return _emulation(target)


def _emulation(chip: Chip) -> tuple[str, ...]:
    """QEMU with the serial port at its standard input and output, and the switch of the power at its standard error."""
    memory = _MEMORY[chip.name]
    option, board, *rest = chip.machine[: chip.machine.index("-nographic")]
    machine = (option, f"{board},memory-backend=image", *rest)
    image = f"memory-backend-file,id=image,mem-path={_IMAGE},size={memory.size},share=off"
    program = ("-object", image, *(("-kernel", _VECTORS) if memory.vectors else ()))
    semihosting = ("-semihosting-config", "enable=on,target=native")
    line = ("-chardev", "stdio,id=line,signal=off", "-serial", "chardev:line")
    switch = ("-chardev", "socket,id=switch,fd=2", "-mon", "chardev=switch,mode=control")
    no_display = ("-display", "none", "-icount", _INSTRUCTION_TIME)
    return (*_bound_to_us(), chip.emulator, *machine, *program, *semihosting, *line, *switch, *no_display)


def _bound_to_us() -> tuple[str, ...]:
    """Words before a command so that it does not outlive this program, even if that is killed; Linux only."""
    result = shutil.which("setpriv") if sys.platform == "linux" else None
    return () if result is None else (result, "--pdeathsig", "KILL")


def _compile(command: list[str], folder: Path) -> None:
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if process.returncode:
        raise Refusal(f"the C compiler refuses the firmware: {' '.join(process.stderr.split())[:500]}")
