"""Rounding of a product that goes directly into a sum, as a property of a target.

==========  ==========================================================================================
name        meaning
==========  ==========================================================================================
``fused``   product and sum are rounded once, by a fused multiply-add, where `fused_products` says so
``strict``  every operation is rounded by itself, as every processor and WebAssembly can do it
==========  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from glucoloop.native.program import Program, Value

FUSED: Final = "fused"
STRICT: Final = "strict"


def fused_products(program: Program, order: Sequence[Value], results: Sequence[Value]) -> dict[Value, Value]:
    """Products that are rounded together with the sum which takes them, with that sum.

    These are the products that one sum alone uses, at most one for each sum; of two, the second. In `order` each value
    comes after its arguments, and `results` are needed as they are.
    """
    uses: dict[Value, int] = {}
    for value in order:
        for argument in program.operations[value][1]:
            uses[argument] = uses.get(argument, 0) + 1
    for value in results:
        uses[value] = uses.get(value, 0) + 1
    fused: dict[Value, Value] = {}
    for value in order:
        operation, arguments = program.operations[value]
        if operation not in ("add", "sub"):
            continue
        for argument in reversed(arguments):
            together = (
                program.levels[argument] == program.levels[value] and program.homes[argument] == program.homes[value]
            )
            if program.operations[argument][0] == "mul" and uses[argument] == 1 and together:
                fused[argument] = value
                break
    return fused
