"""Files of an exported controller."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import jax
import numpy as np

from glucoloop import __version__
from glucoloop.control.protocol import Controller, Status
from glucoloop.firmware.chips import CHIPS, LINK, MENDED_SUMS, SMALL, Chip, template
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.samples import SampleRecord
from glucoloop.native.targets.c.numbers import FORMATS, REAL
from glucoloop.native.targets.c.source import MEANINGS
from glucoloop.spreadsheet import write_rows

OUTCOMES: Final = {True: "held", False: "did not hold", None: "not run"}
"""Outcome of a check in words."""
_GUARDED: Final = "The guard judges readings and insulin on board, and mends a damaged state by itself."
_BARE: Final = "This controller has no guard: nobody judges its readings, nor the insulin on board."
_SUPPORT: Final = {
    "double.c": (
        "| `double.c` | differences of float64 that libgcc rounds wrongly where a chip of ARM has no unit for float64; "
        f"link it with `{' '.join(MENDED_SUMS)}` |\n"
    )
}


def code_files(exported: Exported, record: SampleRecord, chip: Chip | None) -> dict[str, str]:
    """Files that a compiler reads."""
    target = chip or CHIPS["cortex-m4f"]
    support, _ = target.support(exported.precision)
    return {
        "controller.h": exported.source.header,
        "controller.c": exported.source.code,
        "samples.h": _samples(exported, record),
        "selftest.c": template("selftest.c"),
        "chip.c": template("chip.c"),
        "chip.h": template("chip.h"),
        "chip.ld": template("chip.ld").replace("@FLASH@", target.flash).replace("@RAM@", target.ram),
        **{name: template(name) for name in support},
        "Makefile": _makefile(target, exported.precision),
    }


def build_command(chip: Chip, precision: str, output: str = "selftest.elf") -> list[str]:
    """The command that makes the self-test for a chip."""
    support, extra = chip.support(precision)
    flags = ["-std=c99", "-Wall", "-Wextra", "-ffp-contract=off", *SMALL, "-DCHIP", *chip.flags]
    files = ["controller.c", "selftest.c", "chip.c", *support]
    return [chip.compiler, *flags, *LINK, *extra, "-fno-tree-loop-distribute-patterns", "-o", output, *files, "-lgcc"]


def run_command(chip: Chip, file: str = "selftest.elf") -> list[str]:
    """The command that runs it in QEMU."""
    return [chip.emulator, *chip.machine, "-kernel", file]


def _makefile(chip: Chip, precision: str) -> str:
    elf = f"{chip.name}.elf"
    build = " ".join(build_command(chip, precision, "$@")).replace(" ".join(SMALL), "$(OPTIMISE)")
    support, _ = chip.support(precision)
    sources = " ".join(["controller.c controller.h samples.h selftest.c chip.c chip.h chip.ld", *support])
    rules = f"{elf}: {sources}\n\t{build}\n"
    run = " ".join(run_command(chip, elf))
    text = (
        template("Makefile").replace("@CHIP@", chip.name).replace("@SMALL@", " ".join(SMALL)).replace("@RULES@", rules)
    )
    return text.replace("@RUN@", run)


def _samples(exported: Exported, record: SampleRecord) -> str:
    """Recorded samples as a header: inputs and expected outputs, in bits."""
    format, records = FORMATS[exported.precision], exported.source.records
    inputs, expected = records["observation"].fields, records["decision"].fields
    word = np.dtype(format.bits.removesuffix("_t"))

    def bits(leaf: Any, kind: str) -> str:
        if kind != REAL:
            return f"{int(leaf)}{format.bits_suffix}"
        return f"0x{int(np.asarray(leaf, exported.precision).reshape(()).view(word)):X}{format.bits_suffix}"

    def rows(records: Sequence[Sequence[Any]], fields: Sequence[Any]) -> Iterator[str]:
        for leaves in records:
            texts = ", ".join(bits(leaf, field.kind) for leaf, field in zip(leaves, fields, strict=True))
            yield f"  {{{texts}}},"

    def read(field: Any, i: int) -> str:
        if field.kind == REAL:
            return f"  (void)memcpy(&to->{field.name}, &inputs[i][{i}], sizeof(to->{field.name}));"
        return f"  to->{field.name} = (int32_t)inputs[i][{i}];"

    def compared(field: Any, i: int) -> str:
        if field.kind == REAL:
            return (
                f"  (void)memcpy(&bits, &of->{field.name}, sizeof(bits));\n"
                f"  equal = equal && (bits == expected[i][{i}]);"
            )
        return f"  equal = equal && (of->{field.name} == (int32_t)expected[i][{i}]);"

    limits = exported.limits
    texts = {
        "SAMPLES": f"{len(record.observations)}",
        "RUN": f"{record.run}",
        "MIN_RATE": format.literal(float(limits.min_mU_min)),
        "MAX_RATE": format.literal(float(limits.max_mU_min)),
        "BITS": format.bits,
        "INPUTS": f"{len(inputs)}",
        "EXPECTED": f"{len(expected)}",
        "INPUT_NAMES": ", ".join(field.name for field in inputs),
        "EXPECTED_NAMES": ", ".join(field.name for field in expected),
        "INPUT_ROWS": "\n".join(rows(record.observations, inputs)),
        "EXPECTED_ROWS": "\n".join(rows(record.decisions, expected)),
        "READ": "\n".join(read(field, i) for i, field in enumerate(inputs)),
        "COMPARED": "\n".join(compared(field, i) for i, field in enumerate(expected)),
    }
    return re.sub(r"@(\w+)@", lambda result: texts[result[1]], template("samples.h"))


def numbers_table(controller: Controller) -> str:
    """All numbers of a controller, as CSV: name, row, column, value in float64."""
    rows = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(controller):
        name = jax.tree_util.keystr(path).lstrip(".")
        array = np.atleast_1d(np.asarray(leaf))
        flat = array.reshape(array.shape[0], -1)
        for (i, j), value in np.ndenumerate(flat):
            rows.append([name, i if np.ndim(leaf) else "", j if np.ndim(leaf) > 1 else "", value.item()])
    out = io.StringIO()
    write_rows(out, ["name", "row", "column", "value"], rows)
    return out.getvalue()


def proof(exported: Exported, name: str, checks: Sequence[Mapping[str, Any]]) -> str:
    """Report of the checks that were made, and of those that were not, with the reason."""
    source = exported.source
    lines = [
        "# What was checked",
        "",
        f"{name}, in the {source.form} form and in {exported.precision}, by glucoloop {__version__}.",
        "",
        f"Design `{source.design}`: SHA-256 of the statements of `controller.c` and of its structures.",
        "",
        'Only what was run when this folder was written stands under "held".',
        "",
    ]
    for title, holds in (("Held", True), ("Did not hold", False), ("Not run", None)):
        items = [f"- **{check['check']}**: {check['found']}" for check in checks if check["holds"] is holds]
        lines += [f"## {title}", "", *(items or ["- nothing"]), ""]
    return "\n".join(lines)


def readme(
    exported: Exported,
    name: str,
    sample_time_min: float,
    chip: Chip | None,
    checks: Sequence[Mapping[str, Any]],
    *,
    guarded: bool,
) -> str:
    """Instructions for an engineer."""
    target, limits = chip or CHIPS["cortex-m4f"], exported.limits
    fields = "\n".join(
        f"| {structure} | `{field.name}` | {MEANINGS[structure].get(field.name, field.path)} |"
        for structure in ("observation", "decision")
        for field in exported.source.records[structure].fields
        if field.size
    )
    statuses = "\n".join(f"| {status.value} | {status.name} | {status.text} |" for status in Status)
    return template("README.md").format(
        name=name,
        form=exported.source.form,
        precision=exported.precision,
        sample_time=sample_time_min,
        summary=target.summary,
        packages=", ".join(target.packages),
        checked="\n".join(f"- {OUTCOMES[check['holds']]}: {check['check']}" for check in checks),
        support="".join(_SUPPORT[name] for name in target.support(exported.precision)[0]),
        fields=fields,
        least=float(limits.min_mU_min),
        most=float(limits.max_mU_min),
        change=float(limits.max_change_mU_min),
        guard=_GUARDED if guarded else _BARE,
        statuses=statuses,
    )
