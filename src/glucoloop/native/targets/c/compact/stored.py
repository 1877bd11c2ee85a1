"""Values of a function that is being translated, and the lines that put them where they can be read."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from glucoloop.native.targets.c.compact.flat import Flat, Operand, Variable
from glucoloop.native.targets.c.compact.values import LARGEST_EXPRESSION, Maker, Readable, Scalar, Tree, Value, View
from glucoloop.native.targets.c.compact.writer import Writer

Environment = dict[Variable, Value]


class ValueStore:
    """Reads values, and writes those to memory that are not there yet."""

    def __init__(self, writer: Writer) -> None:
        self._w = writer

    def _read(self, operand: Operand, environment: Environment) -> Value:
        return environment[operand] if isinstance(operand, Variable) else self._w.constant(operand)

    def _materialised(self, value: Value) -> View:
        return value if isinstance(value, View) else self._copied(value)

    def _copied(self, value: Value) -> View:
        to = self._w.array(value.shape, value.kind)
        self._w.write(value, to)
        return to

    def _scalar(self, value: Value) -> Scalar:
        """A value of one element as a number."""
        if isinstance(value, Maker):
            value = self._copied(value)
        if isinstance(value, Tree) and value.is_uniform:
            (value,) = value.parts
        return value if isinstance(value, Scalar) else Scalar(value.value(), value.kind)

    def _stored(self, operand: Operand, environment: Environment) -> Readable:
        """A value that may be read anywhere below, any number of times."""
        value = self._read(operand, environment)
        if math.prod(shape_of(operand)) == 1:
            value = self._w.local(self._scalar(value))
        elif not isinstance(value, View) and not (isinstance(value, Tree) and value.is_uniform):
            value = self._materialised(value)
        if isinstance(operand, Variable):
            environment[operand] = value
        return value

    def _view(self, operand: Operand, environment: Environment) -> View:
        value = self._stored(operand, environment)
        if isinstance(value, View):
            return value
        if isinstance(value, Scalar):
            return self._copied(Tree(shape_of(operand), value.kind, "{0}", (value,)))
        view = self._copied(value)
        if isinstance(operand, Variable):
            environment[operand] = view
        return view

    def _readable(self, operand: Operand, environment: Environment, flat: Flat) -> Readable:
        """A value whose elements are each read once."""
        value = self._read(operand, environment)
        if math.prod(shape_of(operand)) == 1:
            return self._scalar(value)
        once = isinstance(operand, Variable) and flat.uses[operand] == 1
        if isinstance(value, Tree) and (value.is_uniform or (once and value.size < LARGEST_EXPRESSION)):
            return value
        return self._stored(operand, environment)

    def _readable_or_maker(self, given: Operand, environment: Environment, flat: Flat) -> Value:
        """Value as of `_readable`, or a maker for a value that may be written once its place is known."""
        value = self._read(given, environment)
        once = isinstance(given, Variable) and flat.uses[given] == 1
        if once and math.prod(shape_of(given)) != 1 and isinstance(value, Maker):
            return value
        return self._readable(given, environment, flat)

    def _each(self, output: Variable, element: Callable[[list[str]], Scalar], reads: tuple[Any, ...]) -> Value:
        """An array each of whose elements is computed by lines of its own."""
        if math.prod(output.shape) == 1:
            return element(["0"] * len(output.shape))

        def write(to: View) -> None:
            with self._w.loops(output.shape) as indices:
                self._w.assign(to, indices, element(indices).text)

        return Maker(output.shape, output.kind, write, reads)


def shape_of(operand: Operand) -> tuple[int, ...]:
    """Shape of an array that is computed or known."""
    return tuple(operand.shape)


def permuted(value: Any, axes: Sequence[int]) -> Any:
    """Value with its axes in another order."""
    if isinstance(value, Scalar):
        return value
    return value.mapped(lambda view: view.permuted(axes), tuple(value.shape[i] for i in axes))
