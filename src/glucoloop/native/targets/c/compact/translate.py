"""Translation of a traced function to C with loops: its lines, its tables and the workspace that it needs."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from glucoloop.native import primitives
from glucoloop.native.flatten import MOVES, REDUCTIONS
from glucoloop.native.targets.c.compact.arithmetic import ELEMENTWISE
from glucoloop.native.targets.c.compact.expressions import template
from glucoloop.native.targets.c.compact.flat import CLIP, INSIDE, Flat, Operation, Variable, flatten
from glucoloop.native.targets.c.compact.linear import LinearAlgebra
from glucoloop.native.targets.c.compact.loops import Loops
from glucoloop.native.targets.c.compact.memory import placed
from glucoloop.native.targets.c.compact.moves import Moves
from glucoloop.native.targets.c.compact.reductions import Reductions
from glucoloop.native.targets.c.compact.stored import Environment
from glucoloop.native.targets.c.compact.values import Scalar, Tree, Value, View, dense
from glucoloop.native.targets.c.compact.writer import Tables, Writer
from glucoloop.native.targets.c.numbers import FORMATS
from glucoloop.native.targets.c.records import Structure

_LONGEST: Final = 160
"""Largest number of letters in an expression of one number."""


_LOCAL: Final = re.compile(r"\bv\d+\b")
_DEFINED: Final = re.compile(r"const \w+ (v\d+) = ")


class Translator(LinearAlgebra, Moves, Reductions, Loops):
    """Writes the C of a flat function."""

    def translate(self, flat: Flat, given: Sequence[View], returned: Sequence[View]) -> None:
        """Write the whole function; its results are stored after everything was read."""
        environment: Environment = dict(zip(flat.inputs, given, strict=True))
        values = self._body(flat, environment)
        waiting = []
        for value, to in zip(values, returned, strict=True):
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
        text = template(operation, self._w)
        parts = [self._readable(given, environment, flat) for given in operation.inputs]
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
    closed: Any, given: Sequence[Structure], returned: Sequence[Structure], precision: str, tables: Tables
) -> Body:
    """Write a traced function in the compact form, with its arguments and results in records, leaf by leaf."""
    writer = Writer(FORMATS[precision], tables)
    Translator(writer).translate(flatten(closed, precision), _views(given), _views(returned))
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
