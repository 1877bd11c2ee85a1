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
    "sin": "The sine; not a number where x is too large for it.",
    "cos": "The cosine; not a number where x is too large for it.",
    "tan": "The tangent; not a number where x is too large for it.",
    "sinh": "The hyperbolic sine.",
    "cosh": "The hyperbolic cosine.",
    "atan2": "The angle of the point whose second coordinate is x and whose first is y.",
    "cbrt": "The cube root.",
    "logistic": "1 / (1 + exp(-x)).",
    "ceil": "The smallest whole number that is not below x.",
    "rem": "The remainder of x / y, exact, with the sign of x.",
    "round_even": "The nearest whole number; of two, the even one.",
    "round_away": "The nearest whole number; of two, that further from zero.",
}


def elementary(text: Iterable[str], format: Format) -> list[str]:
    """Definitions of the elementary functions that lines of C call."""
    joined = "\n".join(text)
    lines: list[str] = []
    for name in FUNCTIONS:
        if re.search(rf"\bgl_{name}\(", joined):
            program = function(name, format.precision)
            given = ("x", "y")[: len(program.layout.own)]
            taken = ", ".join(f"{format.type} {argument}" for argument in given)
            lines += [f"/* {_TOLD[name]} */", f"static {format.type} gl_{name}({taken})", "{"]
            lines += expression_of(program, given)
            lines += ["}", ""]
    return lines
