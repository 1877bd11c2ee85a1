"""Elements of arrays taken from other places: slices, joins, gathers and scatters."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np

from glucoloop.native import primitives
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.c.compact.arithmetic import gather_places, places_of
from glucoloop.native.targets.c.compact.flat import Flat, Operand, Operation, Variable
from glucoloop.native.targets.c.compact.values import (
    Maker,
    Places,
    Scalar,
    Tree,
    Value,
    View,
    dense,
    places_at,
    regular_places,
)
from glucoloop.native.targets.c.compact.writer import Environment, ValueStore, shape_of
from glucoloop.native.targets.c.numbers import WHOLE


class Moves(ValueStore):
    """Writes what moves elements and computes nothing."""

    def _moved(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        shapes = [shape_of(operand) for operand in operation.inputs]
        if len(operation.inputs) > 1:
            return [self._joined(operation, environment, flat)]
        (operand,) = operation.inputs
        used = [v for v in operation.outputs if v in flat.uses]
        if all(math.prod(v.shape) == 1 for v in operation.outputs) and math.prod(shapes[0]) == 1:
            return [self._scalar(self._read(operand, environment))]
        maps = places_of(operation.equation, shapes)
        results: list[Value] = []
        for output, places in zip(operation.outputs, maps, strict=True):
            if output not in flat.uses:
                results.append(Scalar("0", output.kind))
                continue
            grows = places.size > math.prod(shapes[0])
            results.append(self._elements(operand, places, environment, flat, whole=len(used) == 1 and not grows))
        return results

    def _elements(
        self, operand: Operand, places: Places, environment: Environment, flat: Flat, *, whole: bool
    ) -> Value:
        """Elements of an array, by their places."""
        if math.prod(shape_of(operand)) == 1:
            number = self._w.local(self._scalar(self._stored(operand, environment)))
            return number if places.size == 1 else Tree(places.shape, number.kind, "{0}", (number,))
        value = self._readable(operand, environment, flat) if whole else self._stored(operand, environment)
        moved = value.mapped(lambda view: view.moved(places), places.shape)
        if moved is None:
            view = self._view(operand, environment)
            moved = view.moved(places)
            if moved is None:
                return self._looked_up(view, places)
        return self._scalar(moved) if places.size == 1 else moved

    def _looked_up(self, source: View, places: Places) -> Value:
        """Elements at irregular places, by a table of these."""
        index = self._w.constant(places.astype(np.int32))
        if source.strides != dense(source.shape):
            source = self._copied(source)
        line = replace(source, shape=(math.prod(source.shape),), strides=(1,))

        def write(to: View) -> None:
            with self._w.loops(places.shape) as result:
                self._w.assign(to, result, line.value([index.value(result)]))

        return Maker(places.shape, source.kind, write, (source,))

    def _joined(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,) = operation.outputs
        shapes = [shape_of(operand) for operand in operation.inputs]
        (places,) = places_of(operation.equation, shapes)
        pieces: list[tuple[Value, tuple[int, tuple[int, ...]], tuple[int, ...]]] = []
        begin = 0
        for operand, shape in zip(operation.inputs, shapes, strict=True):
            size = math.prod(shape)
            there = np.flatnonzero((begin <= places.ravel()) & (places.ravel() < begin + size))
            begin += size
            if there.size == 0:
                continue
            if there.size > size == 1:  # a number that is repeated; the others are written over it
                whole = (0, dense(output.shape))
                pieces.insert(0, (self._w.local(self._scalar(self._read(operand, environment))), whole, output.shape))
                continue
            destinations = np.empty(size, np.int64)
            destinations[places.ravel()[there] - begin + size] = there
            regular = regular_places(destinations.reshape(shape))
            if regular is None:
                raise UnsupportedError(f"the operation {operation.name!r} of such shapes")
            value = self._readable_or_maker(operand, environment, flat)
            pieces.append((value, regular, shape))

        def write(to: View) -> None:
            for value, (first, strides), shape in pieces:
                self._w.write(value, _part(to, first, strides, shape))

        return Maker(output.shape, output.kind, write, tuple(value for value, _, _ in pieces))

    def _dynamic_slice(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        del flat
        operand, *starts = operation.inputs
        view = self._view(operand, environment)
        sizes = primitives.slice_sizes(operation.equation)
        for start, stride, n, size in zip(starts, view.strides, view.shape, sizes, strict=True):
            text = self._scalar(self._stored(start, environment)).text
            at = self._w.local(Scalar(f"gl_within({text}, {n - size})", WHOLE))
            view = replace(view, terms=(*view.terms, f"{stride} * {at.text}" if stride != 1 else at.text))
        view = replace(view, shape=tuple(sizes))
        return [self._scalar(view) if math.prod(sizes) == 1 else view]

    def _gather(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (output,), (operand, indices) = operation.outputs, operation.inputs
        if not isinstance(indices, Variable):
            places = gather_places(operation.equation, shape_of(operand), indices)
            return [self._elements(operand, places, environment, flat, whole=False)]
        axis = primitives.gathered_axis(operation.equation)
        if axis is None:
            raise UnsupportedError("a gather along several axes")
        view, index = self._view(operand, environment), self._view(indices, environment)
        out = primitives.gathered_offsets(operation.equation)
        size = view.shape[axis]

        def element(result: list[str]) -> Scalar:
            batch = [i for n, i in enumerate(result) if n not in out]
            at = self._w.local(Scalar(f"gl_within({index.value([*batch, '0'])}, {size - 1})", WHOLE))
            row = view.row(axis, at.text)
            return Scalar(row.value([i for n, i in enumerate(result) if n in out]), view.kind)

        return [self._each(output, element, (view, index))]

    def _scattered(self, operation: Operation, environment: Environment, flat: Flat, *, adds: bool) -> list[Value]:
        (output,), (target, indices, updates) = operation.outputs, operation.inputs
        if isinstance(indices, Variable):
            raise UnsupportedError("a scatter to places that are not known")
        places = primitives.scatter_places(operation.equation, output.shape, indices, shape_of(updates))
        regular = regular_places(places)
        if regular is None:
            raise UnsupportedError("a scatter to irregular places")
        operand = self._readable_or_maker(target, environment, flat)
        update = self._readable_or_maker(updates, environment, flat)
        if adds and isinstance(update, Maker):
            update = self._materialised(update)

        def write(to: View) -> None:
            self._w.write(operand, to)
            part = _part(to, *regular, shape_of(updates))
            value: Value = update
            if adds and not isinstance(update, Maker):
                if math.prod(part.shape) == 1:
                    text = self._scalar(update).text
                    value = Scalar(f"({part.element()} + {text})", output.kind)
                else:
                    number = self._w.local(update) if isinstance(update, Scalar) else update
                    value = Tree(part.shape, output.kind, "({0} + {1})", (part, number))
            self._w.write(value, part)

        return [Maker(output.shape, output.kind, write, (operand, update))]

    _scatter = functools.partialmethod(_scattered, adds=False)
    _scatter_add = functools.partialmethod(_scattered, adds=True)


def _part(to: View, first: int, strides: tuple[int, ...], shape: tuple[int, ...]) -> View:
    """A part of an array, given by places in the whole as if it stood row by row."""
    part = to.moved(places_at(first, strides, shape))
    if part is None:
        raise UnsupportedError("a part of an array at irregular places")
    return part
