"""Ladder of checks: each rung runs if its tools are installed, and otherwise names the package that brings them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.firmware.chips import CHIPS, SMALL, Chip
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.folder import build_command, code_files, run_command
from glucoloop.firmware.samples import Record, arithmetic, replayed
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.native.targets.products import STRICT

INTERPRETED: Final = {"unrolled": 10_000, "compact": 12}
"""Number of samples that are computed in NumPy when a folder is written; `--check` takes all that are asked for."""
_CLOCK_MHZ: Final = 64.0
_CYCLES: Final = 1.5
"""Assumed cycles per instruction; QEMU has no model of them."""
_LONGEST_S: Final = 600.0


@dataclass(frozen=True)
class Rung:
    """One check of the ladder."""

    check: str
    holds: bool | None
    """Whether the check passed, or None if it was not run."""
    found: str
    measured: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"check": self.check, "holds": self.holds, "found": self.found, **self.measured}


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
        yield _emulated(exported, record, chip)
    if deep:
        yield _misra(exported, record)
        yield _proved(exported, record)


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


def _ran(command: list[str], folder: Path) -> tuple[int, str]:
    try:
        ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        return 124, f"no answer in {_LONGEST_S:g} s"
    return ran.returncode, f"{ran.stdout}{ran.stderr}"


def _written(exported: Exported, record: Record, chip: Chip | None, folder: Path) -> None:
    for name, text in code_files(exported, record, chip).items():
        (folder / name).write_text(text)


def _emulated(exported: Exported, record: Record, chip: Chip) -> Rung:
    name = f"C on an emulated {chip.name}"
    for tool, package in ((chip.compiler, chip.package), (chip.emulator, chip.emulator_package)):
        if shutil.which(tool) is None:
            return Rung(name, None, f"{tool} is not installed; Debian's package {package} brings it", {})
    with tempfile.TemporaryDirectory(prefix="glucoloop-chip-") as made:
        folder = Path(made)
        _written(exported, record, chip, folder)
        code, said = _ran(build_command(chip), folder)
        if code:
            return Rung(name, False, f"the compiler refuses it: {said.strip()[:500]}", {})
        code, said = _ran(run_command(chip), folder)
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
    code, _ = _ran([chip.compiler, *flags, "-c", "-o", "controller.o", "controller.c"], folder)
    code_size, said = _ran([chip.compiler.replace("gcc", "size"), "controller.o"], folder)
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


def _misra(exported: Exported, record: Record) -> Rung:
    name = "MISRA C:2012, by cppcheck"
    if shutil.which("cppcheck") is None:
        return Rung(name, None, "cppcheck is not installed; Debian's package cppcheck brings it", {})
    with tempfile.TemporaryDirectory(prefix="glucoloop-misra-") as made:
        folder = Path(made)
        _written(exported, record, None, folder)
        flags = ["--std=c99", "--enable=style", "--addon=misra", "--quiet", "--template={id}", "--inline-suppr"]
        code, said = _ran(["cppcheck", *flags, "controller.c"], folder)
    if code == 124:
        return Rung(name, None, said, {})
    found: dict[str, int] = {}
    for rule in re.findall(r"misra-c2012-([\d.]+)", said):
        found[rule] = found.get(rule, 0) + 1
    if "misra" in said and not found:
        return Rung(name, None, f"the add-on does not run: {' '.join(said.split())[:300]}", {})
    required = {rule: count for rule, count in found.items() if rule not in _ADVISORY}
    advisory = {rule: count for rule, count in found.items() if rule in _ADVISORY}
    told = "; ".join(
        f"{kind} rules: {', '.join(f'{rule} ({count} times)' for rule, count in sorted(of.items())) or 'no finding'}"
        for kind, of in (("required", required), ("advisory", advisory))
    )
    return Rung(name, not required, told, {"required": required, "advisory": advisory})


_ADVISORY: Final = frozenset({
    "1.2", "2.3", "2.4", "2.5", "2.6", "2.7", "5.9", "8.7", "8.9", "8.11", "8.13", "10.5", "11.4", "11.5", "12.1",
    "12.3", "12.4", "13.3", "15.1", "15.4", "15.5", "17.5", "17.8", "18.4", "18.5", "19.2", "20.1", "20.5", "21.12",
})  # fmt: skip
"""Advisory rules of MISRA C:2012; the others are required."""
_MAIN: Final = """\
#include "controller.h"
extern void anything(void *to, unsigned long size);
/*@ assigns ((char *)to)[0 .. size - 1] \\from \\nothing; */
void anything(void *to, unsigned long size);
static gl_workspace workspace;
static gl_state state;
static gl_observation observation;
static gl_decision decision;
int main(void)
{
@FILL@
  gl_step(&workspace, &state, &observation, &decision);
  /*@ assert dose: @LEAST@ <= decision.insulin_mU_min <= @MOST@; */
  /*@ assert status: 0 <= decision.status <= 11; */
  return 0;
}
"""


def _proved(exported: Exported, record: Record) -> Rung:
    name = "bounds of the dose for any state and observation, by Frama-C EVA"
    if shutil.which("frama-c") is None:
        return Rung(name, None, "frama-c is not installed; Debian's package frama-c-base brings it", {})
    lines = []
    for structure in ("state", "observation"):
        for field in exported.source.records[structure].fields:
            if field.size:
                at = f"&{structure}.{field.name}{'[0]' if field.is_array else ''}"
                lines.append(f"  anything({at}, sizeof({structure}.{field.name}));")
    limits = exported.limits
    text = _MAIN.replace("@FILL@", "\n".join(lines))
    text = text.replace("@LEAST@", float(limits.min_mU_min).hex())
    text = text.replace("@MOST@", float(np.dtype(exported.precision).type(limits.max_mU_min)).hex())
    with tempfile.TemporaryDirectory(prefix="glucoloop-eva-") as made:
        folder = Path(made)
        _written(exported, record, None, folder)
        (folder / "main.c").write_text(text)
        flags = ["-eva", "-eva-precision", "0", "-eva-auto-loop-unroll", "4", "-warn-special-float", "none"]
        code, said = _ran(["frama-c", *flags, str(folder / "main.c"), str(folder / "controller.c")], folder)
    if code:
        return Rung(name, None, f"Frama-C does not run: {' '.join(said.split())[-300:]}", {})
    alarms = len(re.findall(r"\[eva:alarm\]", said))
    open_ = len(re.findall(r"assertion '(?:dose|status)' got status (?:unknown|invalid)", said))
    told = "dose and status within bounds and no run-time error" if not alarms else f"{alarms} alarms are left"
    if open_:
        told += f"; {open_} of the 2 bounds are not proved"
    return Rung(name, alarms == 0 and open_ == 0, told, {"alarms": alarms})


def chips_for(target: Chip | None) -> list[Chip]:
    """The chips that a check emulates."""
    return list(CHIPS.values()) if target is None else [target]
