"""Self-test of an exported controller on an emulated chip, with the sizes of its program and its memory."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Final

from glucoloop.firmware.chips import SMALL, Chip
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.folder import build_command, code_files, run_command
from glucoloop.firmware.rung import Rung, ran
from glucoloop.firmware.samples import SampleRecord

_CLOCK_MHZ: Final = 64.0
_CYCLES: Final = 1.5
"""Assumed cycles per instruction; QEMU has no model of them."""


def emulated(exported: Exported, record: SampleRecord, chip: Chip) -> Rung:
    """Run the self-test on an emulated chip, and measure its size and its instructions."""
    name = f"C on an emulated {chip.name}"
    if chip.missing:
        return Rung(name, None, chip.missing, {})
    with tempfile.TemporaryDirectory(prefix="glucoloop-chip-") as made:
        folder = Path(made)
        for file, text in code_files(exported, record, chip).items():
            (folder / file).write_text(text)
        code, said = ran(build_command(chip, exported.precision), folder)
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
