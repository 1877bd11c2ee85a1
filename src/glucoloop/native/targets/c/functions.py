"""The project's elementary functions as C functions, written from the same programs that the other targets compile."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from glucoloop.native.targets.c.compact.arithmetic import FUNCTIONS, function
from glucoloop.native.targets.c.numbers import Format
from glucoloop.native.targets.c.unrolled import expression_of

_TOLD: Final = {
    "exp": "e to the power x; beyond the range of numbers the largest or smallest of them.",
    "expm1": "exp(x) - 1, exact to rounding near zero too.",
    "tanh": "The hyperbolic tangent.",
    "log": "The natural logarithm; not a number below zero.",
}


def elementary(text: Iterable[str], format: Format) -> list[str]:
    """Definitions of the elementary functions that lines of C call."""
    joined = "\n".join(text)
    lines: list[str] = []
    for name in FUNCTIONS:
        if re.search(rf"\bgl_{name}\(", joined):
            lines += [f"/* {_TOLD[name]} */", f"static {format.type} gl_{name}({format.type} x)", "{"]
            lines += expression_of(function(name, format.precision), "x")
            lines += ["}", ""]
    return lines
