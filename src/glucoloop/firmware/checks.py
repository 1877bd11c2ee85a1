"""Checks of an exported controller; each runs if its tools are installed, or names the package that brings them.

Some run it: in NumPy, in the native engine, in C here and on an emulated chip. Others analyse its C without running it:
MISRA C:2012 by cppcheck, and proofs by Frama-C EVA.
"""

from __future__ import annotations

import functools
import math
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.control.protocol import Status
from glucoloop.firmware.chips import CHIPS, SMALL, Chip, template
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.folder import build_command, code_files, run_command
from glucoloop.firmware.samples import SampleRecord, arithmetic, by_columns
from glucoloop.native.lower import Lowered
from glucoloop.native.targets import STRICT
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.c.numbers import FORMATS, helpers
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.private_folder import private_temporary_folder

_LONGEST_S: Final = 600.0


@dataclass(frozen=True)
class Check:
    """Result of one check of an exported controller."""

    name: str
    holds: bool | None
    """Whether the check passed, or None if it was not run."""
    finding: str
    measured: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"check": self.name, "holds": self.holds, "found": self.finding, **self.measured}


def _ran(command: list[str], folder: Path) -> tuple[int, str]:
    """Exit code of a command, 124 after ten minutes, and what it printed."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        return 124, f"no answer in {_LONGEST_S:g} s"
    return done.returncode, f"{done.stdout}{done.stderr}"


MISRA: Final = "MISRA C:2012, by cppcheck"
BOUNDS: Final = "bounds of the dose for any state and observation, by Frama-C EVA"
CHANGE: Final = "largest change of the rate, by Frama-C EVA"
_ADVISORY: Final = frozenset({
    "1.2", "2.3", "2.4", "2.5", "2.6", "2.7", "5.9", "8.7", "8.9", "8.11", "8.13", "10.5", "11.4", "11.5", "12.1",
    "12.3", "12.4", "13.3", "15.1", "15.4", "15.5", "17.5", "17.8", "18.4", "18.5", "19.2", "20.1", "20.5", "21.12",
})  # fmt: skip
"""Advisory rules of MISRA C:2012; the others are required."""
_SLICES: Final = 512
"""Number of parts of the range of delivered rates; Frama-C keeps one interval for each number, not their difference."""
_EVA: Final = ("-eva", "-eva-precision", "0", "-eva-auto-loop-unroll", "4", "-warn-special-float", "none")
_PACKAGE: Final = "frama-c is not installed; Debian's package frama-c-base brings it"


def misra(exported: Exported) -> Check:
    """Messages of cppcheck's add-on in the controller; one of a required rule fails the check."""
    return _misra_of(_code(exported), "controller.c")


def _misra_of(files: Mapping[str, str], *checked: str) -> Check:
    """The same for those of the files that are checked."""
    name = MISRA
    if shutil.which("cppcheck") is None:
        return Check(name, None, "cppcheck is not installed; Debian's package cppcheck brings it", {})
    with private_temporary_folder("glucoloop-misra-") as folder:
        _write(folder, files)
        flags = ["--std=c99", "--enable=style", "--addon=misra", "--quiet", "--template={id}", "--inline-suppr"]
        code, output = _ran(["cppcheck", *flags, *checked], folder)
    if code == 124:
        return Check(name, None, output, {})
    result: dict[str, int] = {}
    for rule in re.findall(r"misra-c2012-([\d.]+)", output):
        result[rule] = result.get(rule, 0) + 1
    if "misra" in output and not result:
        return Check(name, None, f"the add-on does not run: {' '.join(output.split())[:300]}", {})
    required = {rule: count for rule, count in result.items() if rule not in _ADVISORY}
    advisory = {rule: count for rule, count in result.items() if rule in _ADVISORY}
    findings = "; ".join(
        f"{kind} rules: {', '.join(f'{rule} ({count} times)' for rule, count in sorted(rules.items())) or 'no finding'}"
        for kind, rules in (("required", required), ("advisory", advisory))
    )
    return Check(name, not required, findings, {"required": required, "advisory": advisory})


def bounds_proved(exported: Exported) -> Check:
    """Proof that a step gives a dose and a status within their bounds without a run-time error, for any bits."""
    lines = []
    for structure in ("state", "observation"):
        for field in exported.source.records[structure].fields:
            if field.size:
                at = f"&{structure}.{field.name}{'[0]' if field.is_array else ''}"
                lines.append(f"  anything({at}, sizeof({structure}.{field.name}));")
    last = exported.last
    bounds = {last.rate: (last.minimum.hex(), last.maximum.hex()), "status": (0, max(Status).value)}
    bounds |= {name: ("0.0", largest.hex()) for name, largest in last.amounts.items()}
    assertions = [
        f"  /*@ assert {minimum} <= decision.{name} <= {maximum}; */" for name, (minimum, maximum) in bounds.items()
    ]
    text = template("any_step.c").replace("@ANYTHING@", template("anything.h")).replace("@FILL@", "\n".join(lines))
    text = text.replace("@BOUNDS@", "\n".join(assertions))
    dose = f"rate from {last.minimum:g} to {last.maximum:g} mU/min"
    for name, largest in last.amounts.items():
        what, _, unit = name.partition("_")
        dose += f", {what} from 0 to {largest:g} {unit}"
    what = f"{dose}, a known status"
    return _analysed(BOUNDS, {**_code(exported), "main.c": text}, what, len(bounds))


def change_proved(exported: Exported) -> Check:
    """Proof that the rate changes by no more than the pump may from a delivered rate within its limits."""
    last, format = exported.last, FORMATS[exported.precision]
    of_step = exported.source.code.split("void gl_step(")[1].split("\n}")[0].rstrip()
    function = "\n".join(last.function(format))
    if function not in exported.source.code or not of_step.endswith("\n  ".join(last.lines(format))):
        return Check(CHANGE, False, "the step does not end by the function that bounds the rate", {})
    width = (last.maximum - last.minimum) / _SLICES * (1.0 + 1e-6)
    bound = math.nextafter(last.change + 1.01 * width, math.inf)
    text = template("any_rate.c").replace("@SLICES@", str(_SLICES)).replace("@REAL@", format.type)
    text = text.replace("@MAX@", "FLT_MAX" if format.type == "float" else "DBL_MAX")
    text = text.replace("@LEAST@", format.literal(last.minimum)).replace("@MOST@", format.literal(last.maximum))
    text = text.replace("@WIDTH@", format.literal(width)).replace("@BOUND@", bound.hex())
    text = text.replace("@FUNCTION@", "\n".join([*helpers([function], format), function]))
    claim = f"at most {bound:.4g} mU/min from any delivered rate within the limits"
    return _analysed(CHANGE, {"main.c": text}, claim, 1)


def firmware_proved(files: Mapping[str, str]) -> Check:
    """Proof that a firmware of these files, which every board uses as they are, has no run-time error.

    It holds however long the firmware runs, for any bytes on its line and in its memory.
    """
    name = "firmware for any bytes on the line and in memory, by Frama-C EVA"
    board = template("any_board.c").replace("@ANYTHING@", template("anything.h"))
    return _analysed(name, {**files, "board.c": board}, "whatever is received", 0)


def _analysed(name: str, files: Mapping[str, str], claim: str, assertions: int) -> Check:
    if shutil.which("frama-c") is None:
        return Check(name, None, _PACKAGE, {})
    code, output = _eva(tuple(files.items()))
    if code:
        return Check(name, None, f"Frama-C does not run: {' '.join(output.split())[-300:]}", {})
    alarms = len(re.findall(r"\[eva:alarm\]", output))
    valid = re.search(r"Assertions +(\d+) valid +(\d+) unknown +(\d+) invalid", output)
    proved = valid is not None and int(valid[1]) == assertions and valid[2] == valid[3] == "0"
    if alarms or not proved:
        output = f"{alarms} alarms are left" + ("" if proved else "; a bound is not proved")
        return Check(name, False, output, {"alarms": alarms})
    return Check(name, True, f"{claim}, and no run-time error", {"alarms": 0})


@functools.lru_cache(maxsize=8)
def _eva(files: tuple[tuple[str, str], ...]) -> tuple[int, str]:
    """Exit code and output of Frama-C; the function that bounds the rate is the same in many controllers."""
    with private_temporary_folder("glucoloop-eva-") as folder:
        _write(folder, dict(files))
        return _ran(["frama-c", *_EVA, *(str(folder / name) for name, _ in files if name.endswith(".c"))], folder)


def _code(exported: Exported) -> dict[str, str]:
    return {"controller.h": exported.source.header, "controller.c": exported.source.code}


def _write(folder: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        (folder / name).write_text(text)


INTERPRETED: Final = {"unrolled": 10_000, "compact": 12}
"""Largest number of samples that are computed in NumPy when a folder is written."""
CHECKED: Final = {"unrolled": None, "compact": 60}
"""The same for `--check`; NumPy takes a second and more for one sample of the compact form."""
_CLOCK_MHZ: Final = 64.0
_CYCLES: Final = 1.5
"""Assumed cycles per instruction; QEMU has no model of them."""


def checks_of(
    exported: Exported, record: SampleRecord, chips: list[Chip], *, samples: int | None, deep: bool
) -> Iterator[Check]:
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
        yield from (Check(name, None, later, {}) for name in (MISRA, BOUNDS, CHANGE))


def _compared(name: str, samples: int, first: int | None, what: str = "dose and status") -> Check:
    if first is not None:
        return Check(name, False, f"sample {first} differs", {"samples": samples})
    return Check(name, True, f"{samples} samples, every {what} equal to the bit", {"samples": samples})


def interpreted(exported: Exported, record: SampleRecord, samples: int | None) -> Check:
    """Compute samples, spread over the record, in NumPy as the form is defined; None for all."""
    name, number = "operation by operation in NumPy", len(record.observations)
    first = record.wrong_step(*arithmetic(exported), samples)
    return _compared(name, number if samples is None else min(samples, number), first, "dose, status and state")


def native(exported: Exported, record: SampleRecord) -> Check:
    """Compute all samples in the native engine, which the compact form has none of."""
    name = "native engine (LLVM), strict products"
    if exported.source.lowered is None:
        return Check(name, None, "the compact form is not made from the program that the native engine carries out", {})
    init, step = by_columns(exported, *map(_compiled, exported.source.lowered))
    return _compared(name, len(record.observations), record.wrong_decision(init, step))


def _compiled(lowered: Lowered) -> Callable[..., Any]:
    """Native code of a function of one column of numbers, which stands in all lanes of a vector."""
    kernel = compile_kernel(lowered, products=STRICT)
    none = np.zeros((0, 1), kernel.dtype)

    def run(own: Any, carry: Any = none) -> tuple[Any, Any]:
        person, carry_, own_ = (np.repeat(rows, kernel.lanes, axis=1) for rows in (none, carry, own))
        outputs = np.zeros((1, kernel.sizes["outputs"], kernel.lanes), kernel.dtype)
        kernel.run(person, carry_, kernel.by_vector(own_[None]), np.zeros((1, 0), kernel.dtype), outputs)
        return carry_, outputs[0]

    return run


def on_this_computer(exported: Exported, record: SampleRecord) -> Check:
    """Compute all samples in C on this computer, optimised more than where they were recorded."""
    name = "C on this computer"
    if compiler() is None:
        return Check(name, None, "there is no C compiler; Debian's package gcc brings one", {})
    library = Library(exported.source, exported.precision, "-O3")
    return _compared(name, len(record.observations), record.wrong_decision(library.init, library.step))


def emulated(exported: Exported, record: SampleRecord, chip: Chip) -> Check:
    """Run the self-test on an emulated chip, and measure its size and its instructions."""
    name = f"C on an emulated {chip.name}"
    if chip.missing:
        return Check(name, None, chip.missing, {})
    with private_temporary_folder("glucoloop-chip-") as folder:
        for file, text in code_files(exported, record, chip).items():
            (folder / file).write_text(text)
        code, output = _ran(build_command(chip, exported.precision), folder)
        if code:
            return Check(name, False, f"the compiler refuses it: {output.strip()[:500]}", {})
        code, output = _ran(run_command(chip), folder)
        sizes = _sizes_of(chip, folder)
    result = dict(re.findall(r"(\w+)=(\d+)", output))
    if code or "samples" not in result:
        return Check(name, False, f"the self-test fails: {' '.join(output.split())[:500]}", sizes)
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
    return Check(name, True, output, measured)


def _sizes_of(chip: Chip, folder: Path) -> dict[str, int]:
    """Size of program, tables and stack of the controller alone."""
    flags = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", *SMALL, "-fstack-usage", *chip.flags]
    code, _ = _ran([chip.compiler, *flags, "-c", "-o", "controller.o", "controller.c"], folder)
    code_size, output = _ran([chip.compiler.replace("gcc", "size"), "controller.o"], folder)
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
