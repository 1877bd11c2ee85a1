"""Numbers in C: their types, constants and operations, and the small functions that carry these out."""

from __future__ import annotations

import functools
import importlib.resources
import math
import re
from collections.abc import Iterable
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


COLUMNS: Final = 10
"""Number of columns that functions of matrices take at once, whose sums stay in registers."""


def template(name: str) -> str:
    """A file in C that generated code is made of."""
    return (importlib.resources.files("glucoloop.native.targets.c") / "templates" / name).read_text(encoding="utf-8")


def _for_each_column(result: re.Match[str]) -> str:
    """A line that is marked, for each of the columns."""
    # MISRA C:2012, rule 2.2: nothing is added to the first place.
    texts = (result[2].replace(" + #", f" + {i}" if i else "").replace("#", str(i)) for i in range(COLUMNS))
    return "\n".join(f"{result[1]}{text}" for text in texts)


@functools.cache
def _sources() -> dict[str, str]:
    """Text of each function by its name."""
    text = re.sub(r"^( *)@each@ (.*)$", _for_each_column, template("helpers.c"), flags=re.MULTILINE)
    functions = text.replace("@COLUMNS@", str(COLUMNS)).strip().split("\n\n")
    return {re.findall(r"^static \S+ (\w+)\(", function, re.MULTILINE)[0]: function for function in functions}


def helpers(text: Iterable[str], format: Format) -> list[str]:
    """Definitions of the functions that lines of C call, each after those that it calls itself."""
    sources, needed = _sources(), set[str]()
    waiting = ["\n".join(text)]
    while waiting:
        for name in set(re.findall(r"\bgl_\w+(?=\()", waiting.pop())) & sources.keys() - needed:
            needed.add(name)
            waiting.append(sources[name])
    lines: list[str] = []
    for name, source in sources.items():
        if name in needed:
            lines += [*_filled(source, format).splitlines(), ""]
    return lines


def _filled(source: str, format: Format) -> str:
    shift = format.mantissa_bits
    texts = {
        "real": format.type,
        "f": format.suffix,
        "bits": format.bits,
        "u": format.bits_suffix,
        "shift": str(shift),
        "signbit": str(31 if format.type == "float" else 63),
        "bias": str(format.bias),
        "mask": str(2 * format.bias + 1),
        "magic": f"0x1p+{shift}{format.suffix}",
        "MAX": "FLT_MAX" if format.type == "float" else "DBL_MAX",
    }
    return re.sub(r"@(\w+)@", lambda result: texts[result.group(1)], source)
