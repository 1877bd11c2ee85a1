"""Analysis of an exported controller's C without running it: MISRA C:2012 by cppcheck, and proofs by Frama-C EVA."""

from __future__ import annotations

import functools
import math
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from glucoloop.control.protocol import Status
from glucoloop.firmware.chips import template
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.rung import Rung, ran
from glucoloop.native.targets.c.helpers import helpers
from glucoloop.native.targets.c.numbers import FORMATS
from glucoloop.private_folder import private_temporary_folder

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


def misra(exported: Exported) -> Rung:
    """Findings of cppcheck's add-on in the controller; one of a required rule fails the check."""
    return misra_of(_code(exported), "controller.c")


def misra_of(files: Mapping[str, str], *checked: str) -> Rung:
    """The same for those of the files that are checked."""
    name = MISRA
    if shutil.which("cppcheck") is None:
        return Rung(name, None, "cppcheck is not installed; Debian's package cppcheck brings it", {})
    with private_temporary_folder("glucoloop-misra-") as folder:
        _write(folder, files)
        flags = ["--std=c99", "--enable=style", "--addon=misra", "--quiet", "--template={id}", "--inline-suppr"]
        code, output = ran(["cppcheck", *flags, *checked], folder)
    if code == 124:
        return Rung(name, None, output, {})
    result: dict[str, int] = {}
    for rule in re.findall(r"misra-c2012-([\d.]+)", output):
        result[rule] = result.get(rule, 0) + 1
    if "misra" in output and not result:
        return Rung(name, None, f"the add-on does not run: {' '.join(output.split())[:300]}", {})
    required = {rule: count for rule, count in result.items() if rule not in _ADVISORY}
    advisory = {rule: count for rule, count in result.items() if rule in _ADVISORY}
    findings = "; ".join(
        f"{kind} rules: {', '.join(f'{rule} ({count} times)' for rule, count in sorted(rules.items())) or 'no finding'}"
        for kind, rules in (("required", required), ("advisory", advisory))
    )
    return Rung(name, not required, findings, {"required": required, "advisory": advisory})


def bounds_proved(exported: Exported) -> Rung:
    """Proof that a step gives a dose and a status within their bounds without a run-time error, for any bits."""
    lines = []
    for structure in ("state", "observation"):
        for field in exported.source.records[structure].fields:
            if field.size:
                at = f"&{structure}.{field.name}{'[0]' if field.is_array else ''}"
                lines.append(f"  anything({at}, sizeof({structure}.{field.name}));")
    last = exported.last
    bounds = {last.rate: (last.least.hex(), last.most.hex()), "status": (0, max(Status).value)}
    if last.bolus is not None:
        bounds[last.bolus[0]] = ("0.0", last.bolus[1].hex())
    assertions = [f"  /*@ assert {least} <= decision.{name} <= {most}; */" for name, (least, most) in bounds.items()]
    text = template("any_step.c").replace("@ANYTHING@", template("anything.h")).replace("@FILL@", "\n".join(lines))
    text = text.replace("@BOUNDS@", "\n".join(assertions))
    dose = f"rate from {last.least:g} to {last.most:g} mU/min"
    dose += "" if last.bolus is None else f", bolus from 0 to {last.bolus[1]:g} mU"
    what = f"{dose}, a known status"
    return _analysed(BOUNDS, {**_code(exported), "main.c": text}, what, len(bounds))


def change_proved(exported: Exported) -> Rung:
    """Proof that the rate changes by no more than the pump may from a delivered rate within its limits."""
    last, format = exported.last, FORMATS[exported.precision]
    of_step = exported.source.code.split("void gl_step(")[1].split("\n}")[0].rstrip()
    function = "\n".join(last.function(format))
    if function not in exported.source.code or not of_step.endswith("\n  ".join(last.lines(format))):
        return Rung(CHANGE, False, "the step does not end by the function that bounds the rate", {})
    width = (last.most - last.least) / _SLICES * (1.0 + 1e-6)
    bound = math.nextafter(last.change + 1.01 * width, math.inf)
    text = template("any_rate.c").replace("@SLICES@", str(_SLICES)).replace("@REAL@", format.type)
    text = text.replace("@MAX@", "FLT_MAX" if format.type == "float" else "DBL_MAX")
    text = text.replace("@LEAST@", format.literal(last.least)).replace("@MOST@", format.literal(last.most))
    text = text.replace("@WIDTH@", format.literal(width)).replace("@BOUND@", bound.hex())
    text = text.replace("@FUNCTION@", "\n".join([*helpers([function], format), function]))
    claim = f"at most {bound:.4g} mU/min from any delivered rate within the limits"
    return _analysed(CHANGE, {"main.c": text}, claim, 1)


def firmware_proved(files: Mapping[str, str]) -> Rung:
    """Proof that a firmware of these files, which every board uses as they are, has no run-time error.

    It holds however long the firmware runs, for any bytes on its line and in its memory.
    """
    name = "firmware for any bytes on the line and in memory, by Frama-C EVA"
    board = template("any_board.c").replace("@ANYTHING@", template("anything.h"))
    return _analysed(name, {**files, "board.c": board}, "whatever is received", 0)


def _analysed(name: str, files: Mapping[str, str], claim: str, assertions: int) -> Rung:
    if shutil.which("frama-c") is None:
        return Rung(name, None, _PACKAGE, {})
    code, output = _eva(tuple(files.items()))
    if code:
        return Rung(name, None, f"Frama-C does not run: {' '.join(output.split())[-300:]}", {})
    alarms = len(re.findall(r"\[eva:alarm\]", output))
    valid = re.search(r"Assertions +(\d+) valid +(\d+) unknown +(\d+) invalid", output)
    proved = valid is not None and int(valid[1]) == assertions and valid[2] == valid[3] == "0"
    if alarms or not proved:
        output = f"{alarms} alarms are left" + ("" if proved else "; a bound is not proved")
        return Rung(name, False, output, {"alarms": alarms})
    return Rung(name, True, f"{claim}, and no run-time error", {"alarms": 0})


@functools.lru_cache(maxsize=8)
def _eva(files: tuple[tuple[str, str], ...]) -> tuple[int, str]:
    """Exit code and output of Frama-C; the function that bounds the rate is the same in many controllers."""
    with private_temporary_folder("glucoloop-eva-") as folder:
        _write(folder, dict(files))
        return ran(["frama-c", *_EVA, *(str(folder / name) for name, _ in files if name.endswith(".c"))], folder)


def _code(exported: Exported) -> dict[str, str]:
    return {"controller.h": exported.source.header, "controller.c": exported.source.code}


def _write(folder: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        (folder / name).write_text(text)
