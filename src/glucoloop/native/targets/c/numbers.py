"""Types, constants and names as C text."""

from __future__ import annotations

import keyword
import math
import re
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from glucoloop.native.functions import DOUBLE, SINGLE

REAL: Final = "real"
WHOLE: Final = "whole"
TRUTH: Final = "truth"
"""The kinds of numbers in C: floating-point numbers, whole numbers of 32 bits, and truths."""
INFIX: Final = {
    "add": "+", "add_any": "+", "sub": "-", "exact_sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">",
    "ge": ">=", "eq": "==", "ne": "!=", "and": "&&", "or": "||", "xor": "!=",
}  # fmt: skip
"""Operations of programs and of traced functions that are written between two numbers."""
CALLS: Final = {
    **{name: f"gl_{name}" for name in ("abs", "sqrt", "floor", "square", "sign", "max", "min")},
    **{name: f"gl_{name}" for name in ("copy_sign", "mantissa", "exponent", "power_of_two")},
    "is_finite": "gl_finite", "lt_to": "gl_below",
}  # fmt: skip
"""Operations of both that are functions of `helpers`."""


@dataclass(frozen=True)
class Format:
    """A floating-point format in C."""

    precision: str
    type: str
    suffix: str
    """Suffix of a constant of this type."""
    bits: str
    """The unsigned type of the same size."""
    bits_suffix: str
    mantissa_bits: int
    bias: int
    decimals: int

    def literal(self, number: float) -> str:
        """A constant, rounded to the format and written in hexadecimal, so that no digit is lost."""
        with np.errstate(over="ignore"):
            rounded = float(np.dtype(self.precision).type(number))
        if math.isnan(rounded):
            return "NAN"
        if math.isinf(rounded):
            return "INFINITY" if rounded > 0.0 else "(-INFINITY)"
        text = re.sub(r"\.?0*p", "p", rounded.hex()) if "." in rounded.hex() else rounded.hex()
        return f"({text}{self.suffix})" if text.startswith("-") else f"{text}{self.suffix}"

    def constant(self, number: Any, kind: str) -> str:
        """A constant of any kind."""
        if kind == TRUTH:
            return "true" if number else "false"
        return self.literal(float(number)) if kind == REAL else str(int(number))


FORMATS: Final = {
    SINGLE: Format(SINGLE, "float", "F", "uint32_t", "U", 23, 127, 9),
    DOUBLE: Format(DOUBLE, "double", "", "uint64_t", "ULL", 52, 1023, 17),
}


def kind_of(dtype: Any) -> str:
    """The kind of an array's elements."""
    if np.dtype(dtype) == np.bool_:
        return TRUTH
    return WHOLE if np.issubdtype(np.dtype(dtype), np.integer) else REAL


def type_of(kind: str, format: Format) -> str:
    """The C type of a local variable of a kind."""
    return {REAL: format.type, WHOLE: "int32_t", TRUTH: "bool"}[kind]


_C_WORDS: Final = frozenset(
    re.findall(r"\w+", """
    auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    bool
    """)
)  # fmt: skip


def identifier(*parts: object) -> str:
    """A name in C of the parts of a path."""
    text = re.sub(r"\W+", "_", "_".join(str(part) for part in parts)).strip("_")
    text = text or "value"
    return f"n{text}" if text[0].isdigit() or text in _C_WORDS or keyword.iskeyword(text) else text
