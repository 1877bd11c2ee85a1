"""Ladder of checks: each rung runs if its tools are installed, and otherwise names the package that brings them."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.firmware.analysis import bounds_proved, change_proved, misra
from glucoloop.firmware.chips import CHIPS, SMALL, Chip
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.folder import build_command, run_command
from glucoloop.firmware.rung import Rung, ran, written
from glucoloop.firmware.samples import Record, arithmetic, replayed
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.native.targets.products import STRICT

INTERPRETED: Final = {"unrolled": 10_000, "compact": 12}
"""Largest number of samples that are computed in NumPy when a folder is written."""
CHECKED: Final = {"unrolled": None, "compact": 60}
"""The same for `--check`; NumPy takes a second and more for one sample of the compact form."""
_CLOCK_MHZ: Final = 64.0
_CYCLES: Final = 1.5
"""Assumed cycles per instruction; QEMU has no model of them."""


def ladder(exported: Exported, record: Record, chips: list[Chip], *, samples: int | None, deep: bool) -> Iterator[Rung]:
    """Run the checks in order.

    Parameters
    ----------
    exported : Exported
    record : Record
        Samples and the expected decisions.
    chips : list of Chip
        Chips that are emulated.
    samples : int or None
        Number of samples that are computed in NumPy, or None for all.
    deep : bool
        Whether Frama-C and cppcheck are run too, which takes minutes.
    """
    yield _interpreted(exported, record, samples)
    yield _native(exported, record)
    yield _here(exported, record)
    for chip in chips:
        yield emulated(exported, record, chip)
    if deep:
        yield misra(exported, record)
        yield bounds_proved(exported, record)
        yield change_proved(exported, record)


def _compared(name: str, record: Record, other: Record, extra: str = "") -> Rung:
    short = Record(record.observations[: len(other.decisions)], record.decisions[: len(other.decisions)])
    first = short.differs(other)
    number = len(other.decisions)
    if first is not None:
        return Rung(name, False, f"the decision of sample {first} differs", {"samples": number})
    return Rung(name, True, f"{number} samples, every dose and status equal to the bit{extra}", {"samples": number})


def _interpreted(exported: Exported, record: Record, samples: int | None) -> Rung:
    what = "operation by operation in NumPy"
    return _compared(what, record, replayed(record, *arithmetic(exported), samples))


def _native(exported: Exported, record: Record) -> Rung:
    name = "native engine (LLVM), strict products"
    if exported.source.lowered is None:
        return Rung(name, None, "the compact form has loops, which the native engine does not have", {})
    first, each = (compile_kernel(of, products=STRICT) for of in exported.source.lowered)
    real = np.dtype(exported.precision)
    width = each.lanes

    def column(leaves: Any) -> Any:
        flat = np.concatenate([np.ravel(leaf).astype(real) for leaf in leaves] + [np.zeros(0, real)])
        return np.ascontiguousarray(np.repeat(flat[:, None], width, axis=1))

    def run(kernel: Any, carry: Any, seen: Any) -> tuple[Any, Any]:
        outputs = np.zeros((1, kernel.sizes["outputs"], width), real)
        kernel.run(np.zeros((0, width), real), carry, column(seen)[None], np.zeros((1, 0), real), outputs)
        return carry, outputs[0]

    def init(seen: Any) -> Any:
        return [run(first, np.zeros((0, width), real), seen)[1]]

    def step(state: Any, seen: Any) -> Any:
        carry, outputs = run(each, np.array(state[0]), seen)
        return [carry], [row[0] for row in outputs]

    return _compared(name, record, replayed(record, init, step))


def _here(exported: Exported, record: Record) -> Rung:
    name = "C on this computer"
    if compiler() is None:
        return Rung(name, None, "there is no C compiler; Debian's package gcc brings one", {})
    library = Library(exported.source, exported.precision)
    return _compared(name, record, replayed(record, library.init, library.step))


def emulated(exported: Exported, record: Record, chip: Chip) -> Rung:
    """Run the self-test on an emulated chip, and measure its size and its instructions."""
    name = f"C on an emulated {chip.name}"
    for tool, package in ((chip.compiler, chip.package), (chip.emulator, chip.emulator_package)):
        if shutil.which(tool) is None:
            return Rung(name, None, f"{tool} is not installed; Debian's package {package} brings it", {})
    with tempfile.TemporaryDirectory(prefix="glucoloop-chip-") as made:
        folder = Path(made)
        written(exported, record, chip, folder)
        code, said = ran(build_command(chip), folder)
        if code:
            return Rung(name, False, f"the compiler refuses it: {said.strip()[:500]}", {})
        code, said = ran(run_command(chip), folder)
        sizes = _flash(chip, folder)
    found = dict(re.findall(r"(\w+)=(\d+)", said))
    if code or "samples" not in found:
        return Rung(name, False, f"the self-test fails: {' '.join(said.split())[:500]}", sizes)
    instructions = int(found["instructions"])
    ram = int(found["state"]) + int(found["workspace"])
    milliseconds = instructions * _CYCLES / (_CLOCK_MHZ * 1e3)
    measured = {
        "samples": int(found["samples"]),
        "instructions": instructions,
        "ram_bytes": ram,
        **sizes,
        "ms_assumed": round(milliseconds, 3),
    }
    told = (
        f"{found['samples']} samples, every dose and status equal to the bit; {sizes.get('flash_bytes', 0)} bytes of "
        f"program and tables, {ram} bytes of state and workspace, {sizes.get('stack_bytes', 0)} bytes of stack; at "
        f"most {instructions} instructions a step, which is {milliseconds:.3g} ms at {_CLOCK_MHZ:g} MHz if one takes "
        f"{_CYCLES:g} cycles"
    )
    return Rung(name, True, told, measured)


def _flash(chip: Chip, folder: Path) -> dict[str, int]:
    """Size of program, tables and stack of the controller alone."""
    flags = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", *SMALL, "-fstack-usage", *chip.flags]
    code, _ = ran([chip.compiler, *flags, "-c", "-o", "controller.o", "controller.c"], folder)
    code_size, said = ran([chip.compiler.replace("gcc", "size"), "controller.o"], folder)
    if code or code_size:
        return {}
    text, data = said.splitlines()[1].split()[:2]
    uses = {
        line.split("\t")[0].split(":")[-1]: int(line.split("\t")[1])
        for file in folder.glob("controller*.su")
        for line in file.read_text().splitlines()
    }
    helpers = [size for name, size in uses.items() if name not in ("gl_step", "gl_init", "gl_save", "gl_restore")]
    stack = uses.get("gl_step", 0) + max(helpers, default=0)
    return {"flash_bytes": int(text) + int(data), "stack_bytes": stack}


def chips_for(target: Chip | None) -> list[Chip]:
    """The chips that a check emulates."""
    return list(CHIPS.values()) if target is None else [target]
