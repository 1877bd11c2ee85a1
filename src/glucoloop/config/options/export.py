"""Keys of an export: the writing and checking of C."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Literal

from glucoloop.config.key import Key

_chip = functools.partial(Key, panel="Chip")


@dataclass(frozen=True, kw_only=True)
class CodeKeys:
    """Keys of a controller in C."""

    precision: Annotated[Literal["float32", "float64"], _chip("Arithmetic on the chip.")] = "float32"
    form: Annotated[
        Literal["auto", "unrolled", "compact"],
        _chip(
            "unrolled: a statement for each operation, fast; compact: loops and tables, small; auto chooses by size."
        ),
    ] = "auto"


@dataclass(frozen=True, kw_only=True)
class ChipKeys(CodeKeys):
    """Keys of the writing and checking of C."""

    target: Annotated[
        Literal["c", "cortex-m4f", "cortex-m7", "rv32"], _chip("Target chip, which is emulated; c for none.")
    ] = "c"
    samples: Annotated[
        int,
        _chip("Number of recorded samples; with --check of those that are checked.", at_least=6, at_most=1_000_000),
    ] = 120
