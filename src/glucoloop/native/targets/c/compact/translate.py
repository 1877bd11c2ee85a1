"""Translation of a traced function to C with loops: its lines, its tables and the workspace that it needs."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from glucoloop.native import primitives
from glucoloop.native.flatten import MOVES, REDUCTIONS
from glucoloop.native.functions import SMALL_POWERS
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.c.compact.arithmetic import ELEMENTWISE, function_of
from glucoloop.native.targets.c.compact.flat import CLIP, INSIDE, Flat, Operation, Variable, flatten
from glucoloop.native.targets.c.compact.linear import LinearAlgebra, Reductions
from glucoloop.native.targets.c.compact.loops import Loops
from glucoloop.native.targets.c.compact.memory import placed
from glucoloop.native.targets.c.compact.moves import Moves
from glucoloop.native.targets.c.compact.values import Scalar, Tree, Value, View, dense
from glucoloop.native.targets.c.compact.writer import Environment, Tables, Writer
from glucoloop.native.targets.c.numbers import CALLS, FORMATS, INFIX, REAL, WHOLE
from glucoloop.native.targets.c.records import Structure

_LONGEST: Final = 160
"""Largest number of letters in an expression of one number."""


_LOCAL: Final = re.compile(r"\bv\d+\b")
_DEFINED: Final = re.compile(r"const \w+ (v\d+) = ")


class _Translator(LinearAlgebra, Moves, Reductions, Loops):
    """Writes the C of a flat function."""

    def translate(self, flat: Flat, arguments: Sequence[View], results: Sequence[View]) -> None:
        """Write the whole function; its results are stored after everything was read."""
        environment: Environment = dict(zip(flat.inputs, arguments, strict=True))
        values = self._body(flat, environment)
        waiting = []
        for value, to in zip(values, results, strict=True):
            if math.prod(to.shape) == 0 or value == to:
                continue
            if isinstance(value, Scalar) or math.prod(to.shape) == 1:
                value = self._w.local(self._scalar(value))
            elif any(view.is_field for view in value.views()):
                value = self._materialised(value)
            waiting.append((value, to))
        for value, to in waiting:
            self._w.write(value, to)

    def _body(self, flat: Flat, environment: Environment) -> list[Value]:
        for operation in flat.operations:
            self._operation(operation, environment, flat)
        return [self._read(output, environment) for output in flat.outputs]

    def _operation(self, operation: Operation, environment: Environment, flat: Flat) -> None:
        name = operation.name
        if name in ELEMENTWISE or name in (INSIDE, CLIP):
            results: Sequence[Value] = [self._elementwise(operation, environment, flat)]
        elif name in MOVES:
            results = self._moved(operation, environment, flat)
        elif name in REDUCTIONS:
            results = [self._reduced(operation, environment, flat)]
        else:
            results = primitives.method(self, name)(operation, environment, flat)
        environment.update(zip(operation.outputs, results, strict=True))

    def _elementwise(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,) = operation.outputs
        text = _template(operation, self._w)
        parts = [self._readable(operand, environment, flat) for operand in operation.inputs]
        if math.prod(output.shape) == 1:
            return self._number(text, [self._scalar(part).text for part in parts], output, flat)
        whole = tuple(
            self._w.local(part) if isinstance(part, Scalar) else self._widened(part, output.shape) for part in parts
        )
        return Tree(output.shape, output.kind, text, whole)

    def _widened(self, part: View | Tree, shape: tuple[int, ...]) -> View | Tree:
        """An array repeated along axes of which it has one element."""
        if part.shape == shape:
            return part
        if isinstance(part, Tree) and part.is_uniform:
            return replace(part, shape=shape)
        view = self._materialised(part)
        strides = tuple(0 if n == 1 else stride for n, stride in zip(view.shape, view.strides, strict=True))
        return replace(view, shape=shape, strides=strides)

    def _number(self, text: str, parts: Sequence[str], output: Variable, flat: Flat) -> Scalar:
        scalar = Scalar(text.format(*parts), output.kind)
        if flat.uses.get(output, 0) > 1 or len(scalar.text) > _LONGEST:
            return self._w.local(scalar)
        return scalar


@dataclass(frozen=True)
class Body:
    """The lines of a C function."""

    lines: Sequence[str]
    workspace: Mapping[str, int]
    """Count of numbers of each kind in the workspace."""


def compact(
    closed: Any, arguments: Sequence[Structure], results: Sequence[Structure], precision: str, tables: Tables
) -> Body:
    """Write a traced function in the compact form, with its arguments and results in records, leaf by leaf."""
    writer = Writer(FORMATS[precision], tables)
    _Translator(writer).translate(flatten(closed, precision), _views(arguments), _views(results))
    lines, workspace = placed(_used(writer.lines), writer.arrays)
    return Body(lines=lines, workspace=workspace)


def _used(lines: Sequence[str]) -> list[str]:
    """Lines without local constants that nothing reads."""
    while True:
        read = Counter(name for line in lines for name in _LOCAL.findall(line))
        remaining = [line for line in lines if not ((result := _DEFINED.match(line)) and read[result.group(1)] == 1)]
        if len(remaining) == len(lines):
            return remaining
        lines = remaining


def _views(records: Sequence[Structure]) -> list[View]:
    """Leaves of structures as arrays."""
    return [
        View(f"{record.pointer}->{f.name}", f.kind, f.shape, dense(f.shape), is_plain=not f.is_array, is_field=True)
        for record in records
        for f in record.fields
    ]


_OF_WHOLE: Final = ("max", "min", "abs", "div", "rem")


def _template(operation: Operation, writer: Writer) -> str:
    """The text of an operation on numbers, with places for its arguments."""
    name, equation = operation.name, operation.equation
    if name in (INSIDE, CLIP):
        return f"gl_{name}({_arguments(operation)})"
    first = equation.invars[0].aval.dtype
    real = np.issubdtype(first, np.floating)
    if name in _OF_WHOLE and not real:
        return f"gl_whole_{name}({_arguments(operation)})"
    function_name = function_of(name, equation)
    if function_name is not None:
        return f"gl_{function_name}({_arguments(operation)})"
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
