"""Text of an operation on numbers in C."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from glucoloop.native import primitives
from glucoloop.native.functions import SMALL_POWERS
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.c.compact.arithmetic import function_of
from glucoloop.native.targets.c.compact.flat import CLIP, INSIDE, Operation
from glucoloop.native.targets.c.compact.writer import Writer
from glucoloop.native.targets.c.numbers import CALLS, INFIX, REAL, WHOLE

_OF_WHOLE: Final = ("max", "min", "abs", "div", "rem")


def template(operation: Operation, writer: Writer) -> str:
    """The text of an operation on numbers, with places for its arguments."""
    name, equation = operation.name, operation.equation
    if name in (INSIDE, CLIP):
        return f"gl_{name}({_arguments(operation)})"
    first = equation.invars[0].aval.dtype
    real = np.issubdtype(first, np.floating)
    if name in _OF_WHOLE and not real:
        return f"gl_whole_{name}({_arguments(operation)})"
    called = function_of(name, equation)
    if called is not None:
        return f"gl_{called}({_arguments(operation)})"
    if name in INFIX:
        if first == np.bool_ and name in ("lt", "le", "gt", "ge", "add", "mul"):
            raise UnsupportedError(f"the operation {name!r} of truths")
        if name in ("and", "or", "xor") and first != np.bool_:
            raise UnsupportedError("bits of whole numbers")
        return f"({{0}} {INFIX[name]} {{1}})"
    if name in CALLS:
        return f"{CALLS[name]}({_arguments(operation)})"
    match name:
        case "neg":
            return "(-{0})"
        case "not":
            return "(!{0})"
        case "le_to":
            return "(!gl_below({1}, {0}))"
        case "clamp":
            return "gl_min(gl_max({0}, {1}), {2})" if real else "gl_whole_min(gl_whole_max({0}, {1}), {2})"
        case "integer_pow":
            return _power(primitives.exponent(equation), writer)
        case "pow":
            written = primitives.written_exponent(equation)
            if written in SMALL_POWERS:
                return _power(int(written), writer)
            return "gl_exp({1} * gl_log({0}))"
        case "select_n":
            return _choice(operation)
        case _:
            return _conversion(equation, writer)


def _arguments(operation: Operation) -> str:
    return ", ".join(f"{{{i}}}" for i in range(len(operation.inputs)))


def _power(n: int, writer: Writer) -> str:
    one = writer.format.constant(1, REAL)
    if n == 0:
        return one
    text = "{0}" if abs(n) == 1 else "gl_square({0})" if abs(n) == 2 else f"gl_power({{0}}, {abs(n)})"
    return text if n > 0 else f"({one} / {text})"


def _choice(operation: Operation) -> str:
    if operation.equation.invars[0].aval.dtype == np.bool_:
        return "({0} ? {2} : {1})"
    last = len(operation.inputs) - 1
    text = f"{{{last}}}"
    for i in range(last - 1, 0, -1):
        text = f"(({{0}} == {i - 1}) ? {{{i}}} : {text})"
    return text


def _conversion(equation: Any, writer: Writer) -> str:
    source, target = equation.invars[0].aval.dtype, primitives.new_dtype(equation)
    real_source, real_target = np.issubdtype(source, np.floating), np.issubdtype(target, np.floating)
    if target == np.bool_:
        return f"({{0}} != {writer.format.constant(0, REAL if real_source else WHOLE)})"
    if source == np.bool_:
        kind = REAL if real_target else WHOLE
        if kind == WHOLE:  # MISRA C:2012, rule 10.6: a small literal has a narrower type
            return "({0} ? (int32_t)1 : (int32_t)0)"
        return f"({{0}} ? {writer.format.constant(1, kind)} : {writer.format.constant(0, kind)})"
    if real_source and not real_target:
        return "gl_whole({0})"
    return f"(({writer.format.type}){{0}})" if real_target else "{0}"
