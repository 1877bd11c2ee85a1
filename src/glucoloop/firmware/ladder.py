"""Ladder of checks: each rung runs if its tools are installed, and otherwise names the package that brings them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.firmware.analysis import BOUNDS, CHANGE, MISRA, bounds_proved, change_proved, misra
from glucoloop.firmware.chips import CHIPS, SMALL, Chip
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.folder import build_command, code_files, run_command
from glucoloop.firmware.rung import Rung, ran
from glucoloop.firmware.samples import SampleRecord, arithmetic, by_columns
from glucoloop.native.lower import Lowered
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.native.targets.products import STRICT
from glucoloop.private_folder import private_temporary_folder

INTERPRETED: Final = {"unrolled": 10_000, "compact": 12}
"""Largest number of samples that are computed in NumPy when a folder is written."""
CHECKED: Final = {"unrolled": None, "compact": 60}
"""The same for `--check`; NumPy takes a second and more for one sample of the compact form."""
_CLOCK_MHZ: Final = 64.0
_CYCLES: Final = 1.5
"""Assumed cycles per instruction; QEMU has no model of them."""


def ladder(
    exported: Exported, record: SampleRecord, chips: list[Chip], *, samples: int | None, deep: bool
) -> Iterator[Rung]:
    """Run the checks in order, the first for so many samples in NumPy, None for all; the deep ones take minutes."""
    yield interpreted(exported, record, samples)
    yield native(exported, record)
    yield on_this_computer(exported, record)
    for chip in chips:
        yield emulated(exported, record, chip)
    if deep:
        yield misra(exported)
        yield bounds_proved(exported)
        yield change_proved(exported)
    else:
        later = "it takes minutes; `glucoloop export --check` of the folder runs it"
        yield from (Rung(name, None, later, {}) for name in (MISRA, BOUNDS, CHANGE))


def _compared(name: str, samples: int, first: int | None, what: str = "dose and status") -> Rung:
    if first is not None:
        return Rung(name, False, f"sample {first} differs", {"samples": samples})
    return Rung(name, True, f"{samples} samples, every {what} equal to the bit", {"samples": samples})


def interpreted(exported: Exported, record: SampleRecord, samples: int | None) -> Rung:
    """Compute samples, spread over the record, in NumPy as the form is defined; None for all."""
    name, number = "operation by operation in NumPy", len(record.observations)
    first = record.wrong_step(*arithmetic(exported), samples)
    return _compared(name, number if samples is None else min(samples, number), first, "dose, status and state")


def native(exported: Exported, record: SampleRecord) -> Rung:
    """Compute all samples in the native engine, which the compact form has none of."""
    name = "native engine (LLVM), strict products"
    if exported.source.lowered is None:
        return Rung(name, None, "the compact form is not made from the program that the native engine carries out", {})
    init, step = by_columns(exported, *map(_compiled, exported.source.lowered))
    return _compared(name, len(record.observations), record.wrong_decision(init, step))


def _compiled(lowered: Lowered) -> Callable[..., Any]:
    """Native code of a function of one column of numbers, which stands in all lanes of a vector."""
    kernel = compile_kernel(lowered, products=STRICT)
    none = np.zeros((0, 1), kernel.dtype)

    def run(own: Any, carry: Any = none) -> tuple[Any, Any]:
        person, carry_, seen = (np.repeat(rows, kernel.lanes, axis=1) for rows in (none, carry, own))
        outputs = np.zeros((1, kernel.sizes["outputs"], kernel.lanes), kernel.dtype)
        kernel.run(person, carry_, kernel.by_vector(seen[None]), np.zeros((1, 0), kernel.dtype), outputs)
        return carry_, outputs[0]

    return run


def on_this_computer(exported: Exported, record: SampleRecord) -> Rung:
    """Compute all samples in C on this computer, optimised more than where they were recorded."""
    name = "C on this computer"
    if compiler() is None:
        return Rung(name, None, "there is no C compiler; Debian's package gcc brings one", {})
    library = Library(exported.source, exported.precision, "-O3")
    return _compared(name, len(record.observations), record.wrong_decision(library.init, library.step))


def emulated(exported: Exported, record: SampleRecord, chip: Chip) -> Rung:
    """Run the self-test on an emulated chip, and measure its size and its instructions."""
    name = f"C on an emulated {chip.name}"
    if chip.missing:
        return Rung(name, None, chip.missing, {})
    with private_temporary_folder("glucoloop-chip-") as folder:
        for file, text in code_files(exported, record, chip).items():
            (folder / file).write_text(text)
        code, output = ran(build_command(chip, exported.precision), folder)
        if code:
            return Rung(name, False, f"the compiler refuses it: {output.strip()[:500]}", {})
        code, output = ran(run_command(chip), folder)
        sizes = _sizes_of(chip, folder)
    result = dict(re.findall(r"(\w+)=(\d+)", output))
    if code or "samples" not in result:
        return Rung(name, False, f"the self-test fails: {' '.join(output.split())[:500]}", sizes)
    instructions = int(result["instructions"])
    ram = int(result["state"]) + int(result["workspace"])
    milliseconds = instructions * _CYCLES / (_CLOCK_MHZ * 1e3)
    measured = {
        "samples": int(result["samples"]),
        "instructions": instructions,
        "ram_bytes": ram,
        **sizes,
        "ms_assumed": round(milliseconds, 3),
    }
    output = (
        f"{result['samples']} samples, every dose and status equal to the bit; {sizes.get('flash_bytes', 0)} bytes of "
        f"program and tables, {ram} bytes of state and workspace, {sizes.get('stack_bytes', 0)} bytes of stack; at "
        f"most {instructions} instructions a step, which is {milliseconds:.3g} ms at {_CLOCK_MHZ:g} MHz if one takes "
        f"{_CYCLES:g} cycles"
    )
    return Rung(name, True, output, measured)


def _sizes_of(chip: Chip, folder: Path) -> dict[str, int]:
    """Size of program, tables and stack of the controller alone."""
    flags = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", *SMALL, "-fstack-usage", *chip.flags]
    code, _ = ran([chip.compiler, *flags, "-c", "-o", "controller.o", "controller.c"], folder)
    code_size, output = ran([chip.compiler.replace("gcc", "size"), "controller.o"], folder)
    if code or code_size:
        return {}
    text, data = output.splitlines()[1].split()[:2]
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
