"""Sums, extremes and products along axes of arrays, and linear equations, in C."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from glucoloop.native import primitives
from glucoloop.native.flatten import REDUCTIONS
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.c.compact.arithmetic import banded_factor, constant_band
from glucoloop.native.targets.c.compact.flat import Flat, Operand, Operation, Variable
from glucoloop.native.targets.c.compact.values import Maker, Scalar, Value, View, dense
from glucoloop.native.targets.c.compact.writer import FEW, Environment, ValueStore, permuted, shape_of
from glucoloop.native.targets.c.numbers import COLUMNS, INFIX, REAL, TRUTH, WHOLE


class Reductions(ValueStore):
    """Writes what leaves one number of many."""

    def _reduced(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,), (operand,) = operation.outputs, operation.inputs
        axes = primitives.axes(operation.equation)
        value = self._readable(operand, environment, flat)
        if isinstance(value, Scalar) or not axes:
            return value
        remaining = [axis for axis in range(len(value.shape)) if axis not in axes]
        turned = permuted(value, [*remaining, *axes])
        inner = [value.shape[axis] for axis in axes]
        name, nothing = REDUCTIONS[operation.name]
        start = self._w.format.constant(nothing, output.kind)
        step = f"{{0}} {INFIX[name]} {{1}}" if name in INFIX else f"gl_{name}({{0}}, {{1}})"

        def total(indices: list[str]) -> Scalar:
            result = self._w.variable(output.kind, start)
            with self._w.loops(inner) as of_inner:
                text = turned.value([*indices, *of_inner])
                self._w.say(f"{result.text} = {step.format(result.text, text)};")
            return result

        return self._each(output, total, (value,))

    def _cumsum(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (output,), (operand,) = operation.outputs, operation.inputs
        axis, reverse = primitives.running(operation.equation)
        value = self._readable(operand, environment, flat)
        if isinstance(value, Scalar):
            return [value]
        order = [*(i for i in range(len(value.shape)) if i != axis), axis]
        turned = permuted(value, order)
        last = len(order) - 1
        turned = turned.mapped(lambda view: view.reversed(last), turned.shape) if reverse else turned

        def write(to: View) -> None:
            to = to.permuted(order)
            to = to.reversed(last) if reverse else to
            with self._w.loops(turned.shape[:-1]) as outer:
                result = self._w.variable(output.kind, self._w.format.constant(0, output.kind))
                with self._w.loops(turned.shape[-1:]) as along:
                    self._w.say(f"{result.text} = {result.text} + {turned.value([*outer, *along])};")
                    self._w.assign(to, [*outer, *along], result.text)

        return [Maker(output.shape, output.kind, write, (value,))]

    def _first(self, operation: Operation, environment: Environment, flat: Flat, *, sign: str) -> list[Value]:
        del flat
        (output,), (operand,) = operation.outputs, operation.inputs
        (axis,) = primitives.axes(operation.equation)
        view = self._view(operand, environment)
        turned = view.permuted([*(i for i in range(len(view.shape)) if i != axis), axis])

        def number(text: str) -> str:
            return f"({text} ? 1 : 0)" if view.kind == TRUTH else text

        kind = WHOLE if view.kind == TRUTH else view.kind

        def place(indices: list[str]) -> Scalar:
            best = self._w.variable(kind, number(turned.value([*indices, "0"])))
            result = self._w.variable(WHOLE, "0")
            i = self._w.fresh("i")
            with self._w.counted(i, turned.shape[-1], 1):
                element = self._w.local(Scalar(number(turned.value([*indices, i])), kind))
                new = (
                    f" || (({element.text} != {element.text}) && ({best.text} == {best.text}))" if kind == REAL else ""
                )
                condition = f"({element.text} {sign} {best.text})"
                with self._w.block(f"if ({condition}{new})" if new else f"if {condition}"):
                    self._w.say(f"{best.text} = {element.text};", f"{result.text} = {i};")
            return result

        return [self._each(output, place, (view,))]

    _argmax = functools.partialmethod(_first, sign=">")
    _argmin = functools.partialmethod(_first, sign="<")


class LinearAlgebra(ValueStore):
    """Writes products of arrays, factorisations and solutions of linear equations."""

    def _dot_general(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (output,), (left, right) = operation.outputs, operation.inputs
        axes = primitives.dot_general(operation.equation)
        (summed_a, summed_b), batch, (free_a, free_b) = axes.summed, axes.batched, axes.free
        alone_a = math.prod(shape_of(left)[i] for i in free_a) == 1
        alone_b = math.prod(shape_of(right)[i] for i in free_b) == 1
        are_constant = not isinstance(left, Variable), not isinstance(right, Variable)
        factor = banded_factor(operation.equation, shape_of(left), shape_of(right), are_constant)
        if factor is not None:
            constants: Any
            constants, vector, summed = ((left, right, summed_a), (right, left, summed_b))[factor]
            (along,) = (summed_b, summed_a)[factor]
            rows, band = (np.moveaxis(array, summed[0], -1) for array in (constants, constant_band(constants, summed)))
            if not band.all():
                return [self._banded(output, rows, band, self._view(vector, environment), along)]
        if not batch[0] and output.kind == REAL and len(summed_a) == len(free_a) == len(free_b) == 1:
            product = self._matrices(output, left, right, environment, (summed_a[0], summed_b[0]))
            if product is not None:
                return [product]
        a = self._readable(left, environment, flat) if alone_b else self._stored(left, environment)
        b = self._readable(right, environment, flat) if alone_a else self._stored(right, environment)
        a, b = permuted(a, [*batch[0], *free_a, *summed_a]), permuted(b, [*batch[1], *free_b, *summed_b])
        n, f = len(batch[0]), len(free_a)
        inner = [shape_of(left)[i] for i in summed_a]

        def total(indices: list[str]) -> Scalar:
            result = self._w.variable(output.kind, self._w.format.constant(0, output.kind))
            with self._w.loops(inner) as of_inner:
                of_a = a.value([*indices[: n + f], *of_inner])
                of_b = b.value([*indices[:n], *indices[n + f :], *of_inner])
                self._w.say(f"{result.text} = {result.text} + ({of_a} * {of_b});")
            return result

        return [self._each(output, total, (a, b))]

    def _matrices(
        self, output: Variable, left: Operand, right: Operand, environment: Environment, summed: tuple[int, int]
    ) -> Value | None:
        """Product of two matrices by the shared function, which goes through several columns at once."""
        n, m = output.shape
        if max(n, m) < COLUMNS:
            return None
        a, b = (
            view.permuted((1 - axis, axis))
            for view, axis in zip((self._view(left, environment), self._view(right, environment)), summed, strict=True)
        )
        swapped = m < COLUMNS or (b.strides[0] != 1 and n >= COLUMNS and a.strides[0] == 1)
        rows, columns = (b, a) if swapped else (a, b)
        columns = columns.permuted((1, 0))
        if columns.strides[1] != 1:  # the columns must follow one another
            columns = self._copied(columns)

        def write(to: View) -> None:
            to = to.permuted((1, 0)) if swapped else to
            arguments = (
                f"{rows.shape[0]}, {columns.shape[1]}, {columns.shape[0]}",
                f"&{rows.element()}, {rows.strides[0]}, {rows.strides[1]}",
                f"&{columns.element()}, {columns.strides[0]}",
                f"&{to.element()}, {to.strides[0]}, {to.strides[1]}",
            )
            self._w.say(f"gl_product({', '.join(arguments)});")

        return Maker(output.shape, REAL, write, (rows, columns))

    def _banded(self, output: Variable, rows: Any, band: Any, vector: View, axis: int) -> Value:
        """Product of a matrix of constants with zeros at the ends of its rows and a vector; the zeros are not kept."""
        flat_rows, flat_band = (array.reshape(-1, array.shape[-1]) for array in (rows, band))
        line = replace(vector, shape=(rows.shape[-1],), strides=(vector.strides[axis],))
        nonzero = flat_rows[flat_band]
        counts = flat_band.sum(axis=1)
        begins = np.append(0, np.cumsum(counts)).astype(np.int32)
        shifts = (flat_band.argmax(axis=1) - begins[:-1]).astype(np.int32)
        if counts.size == 1 and counts[0] <= FEW:
            text = self._w.format.constant(0, output.kind)
            for number, place in zip(nonzero, np.flatnonzero(flat_band[0]), strict=True):
                text = f"({text} + ({self._w.format.constant(number, output.kind)} * {line.value([str(place)])}))"
            return self._w.local(Scalar(text, output.kind))
        numbers, begin, shift = (self._w.table(array) for array in (nonzero, begins, shifts))
        to = self._w.array((counts.size,), output.kind)
        i, p = self._w.fresh("i"), self._w.fresh("i")
        self._w.say(f"/*@ loop unroll {counts.size}; */")  # without it Frama-C does not see that no index is outside
        with self._w.counted(i, counts.size):
            result = self._w.variable(output.kind, self._w.format.constant(0, output.kind))
            with self._w.counted(p, f"{begin}[{i} + 1]", f"{begin}[{i}]"):
                element = line.value([f"({p} + {shift}[{i}])"])
                self._w.say(f"{result.text} = {result.text} + ({numbers}[{p}] * {element});")
            self._w.assign(to, [i], result.text)
        view = replace(to, shape=output.shape, strides=dense(output.shape))
        return self._scalar(view) if math.prod(output.shape) == 1 else view

    def _lu(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (operand,) = operation.inputs
        factors, pivots, order = operation.outputs
        if pivots in flat.uses:
            raise UnsupportedError("the pivots of a factorisation")
        to = self._w.array(factors.shape, REAL)
        self._w.write(self._readable_or_maker(operand, environment, flat), to)
        at = self._w.array(order.shape, WHOLE)
        n = factors.shape[0]
        self._w.say(f"gl_lu({n}, &{to.element()}, &{at.element()});")
        return [to, Scalar("0", WHOLE), at]

    def _triangular_solve(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (output,), (matrix, right) = operation.outputs, operation.inputs
        how = primitives.triangular(operation.equation)
        a = self._view(matrix, environment)
        lower, a = how.lower != how.transposed, a.permuted((1, 0)) if how.transposed else a
        if not lower:  # from the last row to the first
            a = a.reversed(0).reversed(1)
        if how.left and output.shape[1] >= COLUMNS:
            return [
                self._solved_at_once(output, a, self._view(right, environment), lower=lower, unit=how.unit_diagonal)
            ]
        x = self._w.array(output.shape, REAL)
        self._w.write(self._readable_or_maker(right, environment, flat), x)
        to = x
        if not how.left:
            a, to = a.reversed(0).reversed(1).permuted((1, 0)), x.permuted((1, 0))
            lower = not lower
        n, columns = to.shape
        to = to if lower else to.reversed(0)
        i, j, k = (self._w.fresh("i") for _ in range(3))
        with self._w.counted(i, n), self._w.counted(j, columns):
            total = self._w.variable(REAL, to.value([i, j]))
            with self._w.counted(k, i):
                self._w.say(f"{total.text} = {total.text} - ({a.value([i, k])} * {to.value([k, j])});")
            text = total.text if how.unit_diagonal else f"({total.text} / {a.value([i, i])})"
            self._w.assign(to, [i, j], text)
        return [x]

    def _solved_at_once(self, output: Variable, a: View, right: View, *, lower: bool, unit: bool) -> View:
        """Solution for many right sides by the shared function."""
        if right.strides != dense(right.shape):
            right = self._copied(right)
        x = self._w.array(output.shape, REAL)
        b, to = (right, x) if lower else (right.reversed(0), x.reversed(0))
        arguments = (
            f"{to.shape[0]}, {to.shape[1]}",
            f"&{a.element()}, {a.strides[0]}, {a.strides[1]}, {'true' if unit else 'false'}",
            f"&{b.element()}, &{to.element()}, {to.strides[0]}",
        )
        self._w.say(f"gl_solve({', '.join(arguments)});")
        return x
