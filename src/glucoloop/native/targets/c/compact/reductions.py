"""Sums, extremes and running sums along axes of arrays."""

from __future__ import annotations

import functools

from glucoloop.native import primitives
from glucoloop.native.flatten import REDUCTIONS
from glucoloop.native.targets.c.compact.flat import Flat, Operation
from glucoloop.native.targets.c.compact.stored import Environment, ValueStore, permuted
from glucoloop.native.targets.c.compact.values import Maker, Scalar, Value, View
from glucoloop.native.targets.c.numbers import INFIX, REAL, TRUTH, WHOLE


class Reductions(ValueStore):
    """Writes what leaves one number of many."""

    def _reduced(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,), (given,) = operation.outputs, operation.inputs
        axes = primitives.axes(operation.equation)
        value = self._readable(given, environment, flat)
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
        (output,), (given,) = operation.outputs, operation.inputs
        axis, reverse = primitives.running(operation.equation)
        value = self._readable(given, environment, flat)
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
        (output,), (given,) = operation.outputs, operation.inputs
        (axis,) = primitives.axes(operation.equation)
        view = self._view(given, environment)
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
