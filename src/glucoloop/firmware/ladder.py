"""Ladder of checks: each rung runs if its tools are installed, and otherwise names the package that brings them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from glucoloop.firmware.analysis import BOUNDS, CHANGE, MISRA, bounds_proved, change_proved, misra
from glucoloop.firmware.chips import CHIPS, Chip
from glucoloop.firmware.emulation import emulated
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.rung import Rung
from glucoloop.firmware.samples import SampleRecord, arithmetic, by_columns
from glucoloop.native.lower import Lowered
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.native.targets.products import STRICT

INTERPRETED: Final = {"unrolled": 10_000, "compact": 12}
"""Largest number of samples that are computed in NumPy when a folder is written."""
CHECKED: Final = {"unrolled": None, "compact": 60}
"""The same for `--check`; NumPy takes a second and more for one sample of the compact form."""


def ladder(
    exported: Exported, record: SampleRecord, chips: list[Chip], *, samples: int | None, deep: bool
) -> Iterator[Rung]:
    """Run the checks in order, the first for so many samples in NumPy, None for all; the deep ones take minutes."""
    yield interpreted(exported, record, samples)
    yield native(exported, record)
    yield here(exported, record)
    for chip in chips:
        yield emulated(exported, record, chip)
    if deep:
        yield misra(exported)
        yield bounds_proved(exported)
        yield change_proved(exported)
    else:
        later = "it takes minutes; `glucoloop export --check` of the folder runs it"
        yield from (Rung(name, None, later, {}) for name in (MISRA, BOUNDS, CHANGE))


def _told(name: str, samples: int, first: int | None, what: str = "dose and status") -> Rung:
    if first is not None:
        return Rung(name, False, f"sample {first} differs", {"samples": samples})
    return Rung(name, True, f"{samples} samples, every {what} equal to the bit", {"samples": samples})


def interpreted(exported: Exported, record: SampleRecord, samples: int | None) -> Rung:
    """Compute samples, spread over the record, in NumPy as the form is defined; None for all."""
    name, number = "operation by operation in NumPy", len(record.observations)
    first = record.wrong_step(*arithmetic(exported), samples)
    return _told(name, number if samples is None else min(samples, number), first, "dose, status and state")


def native(exported: Exported, record: SampleRecord) -> Rung:
    """Compute all samples in the native engine, which the compact form has none of."""
    name = "native engine (LLVM), strict products"
    if exported.source.lowered is None:
        return Rung(name, None, "the compact form has loops, which the native engine does not have", {})
    init, step = by_columns(exported, *map(_compiled, exported.source.lowered))
    return _told(name, len(record.observations), record.wrong_decision(init, step))


def _compiled(lowered: Lowered) -> Callable[..., Any]:
    """Native code of a function of one column of numbers, which stands in all lanes of a vector."""
    kernel = compile_kernel(lowered, products=STRICT)
    none = np.zeros((0, 1), kernel.dtype)

    def run(own: Any, carry: Any = none) -> tuple[Any, Any]:
        person, held, seen = (np.repeat(rows, kernel.lanes, axis=1) for rows in (none, carry, own))
        outputs = np.zeros((1, kernel.sizes["outputs"], kernel.lanes), kernel.dtype)
        kernel.run(person, held, seen[None], np.zeros((1, 0), kernel.dtype), outputs)
        return held, outputs[0]

    return run


def here(exported: Exported, record: SampleRecord) -> Rung:
    """Compute all samples in C on this computer, optimised more than where they were recorded."""
    name = "C on this computer"
    if compiler() is None:
        return Rung(name, None, "there is no C compiler; Debian's package gcc brings one", {})
    library = Library(exported.source, exported.precision, "-O3")
    return _told(name, len(record.observations), record.wrong_decision(library.init, library.step))


def chips_for(target: Chip | None) -> list[Chip]:
    """The chips that a check emulates."""
    return list(CHIPS.values()) if target is None else [target]
