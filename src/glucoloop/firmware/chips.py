"""Chips for which a controller is exported: compilers, flags, and emulation by QEMU."""

from __future__ import annotations

import dataclasses
import importlib.resources
import shutil
import subprocess
from dataclasses import dataclass
from typing import Final

from glucoloop.refusal import Refusal


@dataclass(frozen=True)
class Chip:
    """A kind of microcontroller."""

    name: str
    summary: str
    compiler: str
    package: str
    """Debian package that brings the compiler."""
    library_package: str
    """Debian package that brings the headers of C for it."""
    flags: tuple[str, ...]
    emulator: str
    emulator_package: str
    machine: tuple[str, ...]
    flash: str
    ram: str
    doubles: bool = True
    """Whether the chip or its compiler's library rounds sums of float64 right; ``double.c`` does where they do not."""

    def support(self, precision: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Templates that are compiled with a controller of a precision, and the options of the linker for them."""
        return (("double.c",), MENDED_SUMS) if precision == "float64" and not self.doubles else ((), ())

    @property
    def packages(self) -> tuple[str, ...]:
        """Debian packages that bring all that it needs."""
        return self.package, self.library_package, self.emulator_package

    @property
    def missing(self) -> str:
        """Part of a sentence that names what is not installed and the package that brings it; empty if all is."""
        for tool, package in ((self.compiler, self.package), (self.emulator, self.emulator_package)):
            if shutil.which(tool) is None:
                return f"{tool} is not installed; Debian's package {package} brings it"
        headers = [self.compiler, *self.flags, "-E", "-x", "c", "-"]
        compiled = subprocess.run(headers, input=b"#include <string.h>\n", capture_output=True, check=False)
        if compiled.returncode:
            return (
                f"the C library of {self.compiler} is not installed; Debian's package {self.library_package} brings it"
            )
        return ""


MENDED_SUMS: Final = ("-Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub",)
"""Options of the linker that put the functions of ``double.c`` in the place of libgcc's."""
_MPS2: Final = ("-nographic", "-semihosting-config", "enable=on,target=native", "-icount", "shift=0")
_CORTEX_M4F: Final = Chip(
    name="cortex-m4f",
    summary="ARM Cortex-M4 with a unit for float32, emulated as the board mps2-an386",
    compiler="arm-none-eabi-gcc",
    package="gcc-arm-none-eabi",
    library_package="libnewlib-dev",
    flags=("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
    emulator="qemu-system-arm",
    emulator_package="qemu-system-arm",
    machine=("-machine", "mps2-an386", "-cpu", "cortex-m4", *_MPS2),
    flash="0x00000000",
    ram="0x20000000",
    doubles=False,
)
_CORTEX_M7: Final = dataclasses.replace(
    _CORTEX_M4F,
    name="cortex-m7",
    summary="ARM Cortex-M7 with a unit for float32 and float64, emulated as the board mps2-an500",
    flags=("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16"),
    machine=("-machine", "mps2-an500", "-cpu", "cortex-m7", *_MPS2),
    doubles=True,
)
_RV32: Final = Chip(
    name="rv32",
    summary="RISC-V of 32 bits with a unit for float32, emulated as the board virt",
    compiler="riscv64-unknown-elf-gcc",
    package="gcc-riscv64-unknown-elf",
    library_package="picolibc-riscv64-unknown-elf",
    flags=("-march=rv32imafc", "-mabi=ilp32f", "-mcmodel=medany", "--specs=picolibc.specs"),
    emulator="qemu-system-riscv32",
    emulator_package="qemu-system-misc",
    machine=("-machine", "virt", "-bios", "none", *_MPS2),
    flash="0x80000000",
    ram="0x80400000",
)
CHIPS: Final = {chip.name: chip for chip in (_CORTEX_M4F, _CORTEX_M7, _RV32)}
HOST: Final = "c"
"""Target name of C for any computer, without a chip."""
SMALL: Final = ("-Os", "-fno-inline", "-fno-thread-jumps", "-fno-reorder-blocks")
"""Flags for a small program: even the smallest functions are called, and no piece of code is repeated for speed."""
LINK: Final = ("-nostdlib", "-nostartfiles", "-fno-builtin", "-fno-math-errno", "-T", "chip.ld")


def chip_of(target: str) -> Chip | None:
    """The chip of a target; None for C alone."""
    if target == HOST:
        return None
    if target not in CHIPS:
        raise Refusal(f"the target is {target!r}; the known ones are: {', '.join((HOST, *CHIPS))}")
    return CHIPS[target]


def template(name: str, package: str = "glucoloop.firmware") -> str:
    """A file in C that folders of a package get."""
    return (importlib.resources.files(package) / "templates" / name).read_text(encoding="utf-8")
