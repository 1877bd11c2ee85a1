"""Loops and choices in C."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace

from glucoloop.native import primitives
from glucoloop.native.targets.c.compact.flat import Flat, Operation, Variable
from glucoloop.native.targets.c.compact.values import Scalar, Tree, Value, View
from glucoloop.native.targets.c.compact.writer import Environment, ValueStore, Writer
from glucoloop.native.targets.c.numbers import REAL


class Loops(ValueStore):
    """Writes loops whose number of rounds is known, and choices between functions."""

    def __init__(self, writer: Writer) -> None:
        super().__init__(writer)
        self._changing: set[Variable] = set()
        """Variables of loops whose arrays are their own, and written in every round."""

    @abstractmethod
    def _body(self, flat: Flat, environment: Environment) -> list[Value]:
        """Write a function inside, and return its results."""

    def _scan(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        loop, (inner,) = primitives.scan(operation.equation), operation.inner
        constants = operation.inputs[: loop.constants]
        carry = operation.inputs[loop.constants : loop.constants + loop.carry]
        rows = operation.inputs[loop.constants + loop.carry :]
        values: list[Value] = [self._stored(operand, environment) for operand in constants]
        each = [self._stored(operand, environment) for operand in rows]
        state: list[Value] = []  # with 0 for what no round needs
        of_loop = inner.inputs[loop.constants : loop.constants + loop.carry]
        for operand, output, inside in zip(carry, operation.outputs, of_loop, strict=False):
            if output in flat.uses or inside in inner.uses:
                state.append(self._loop_variable(self._readable_or_maker(operand, environment, flat), output))
                self._changing.add(inside)
            else:
                state.append(Scalar("0", output.kind))
        gives = operation.outputs[loop.carry :]
        stacked = [self._w.array(output.shape, output.kind) if output in flat.uses else None for output in gives]
        i = self._w.fresh("i")
        with self._w.counted(i, loop.length):
            of_round = [self._row(value, i, reverse=loop.reverse) for value in each]
            results = self._body(inner, dict(zip(inner.inputs, [*values, *state, *of_round], strict=True)))
            for value, place in zip(results[loop.carry :], stacked, strict=True):
                if place is not None:
                    row = place.reversed(0).row(0, i) if loop.reverse else place.row(0, i)
                    self._w.write(value, row)
            pairs = zip(results[: loop.carry], state, strict=True)
            self._assign_all([(value, to) for value, to in pairs if to != Scalar("0", to.kind)])
        return [*state, *(Scalar("0", REAL) if place is None else place for place in stacked)]

    def _loop_variable(self, value: Value, output: Variable) -> Value:
        """A value that changes from round to round."""
        if math.prod(output.shape) == 1:
            return self._w.variable(output.kind, self._scalar(value).text)
        to = self._w.array(output.shape, output.kind)
        self._w.write(value, to)
        return to

    def _row(self, value: Value, index: str, *, reverse: bool) -> Value:
        if isinstance(value, View):
            view = value.reversed(0).row(0, index) if reverse else value.row(0, index)
            return self._scalar(view) if math.prod(view.shape) == 1 else view
        if isinstance(value, Tree) and isinstance(value.parts[0], Scalar):
            shape = value.shape[1:]
            return value.parts[0] if math.prod(shape) == 1 else replace(value, shape=shape)
        return value  # a loop of one round

    def _assign_all(self, pairs: Sequence[tuple[Value, Value]]) -> None:
        """Store values in their places, when nothing reads any more what is there."""
        changing = {to.number for _, to in pairs if isinstance(to, View)}
        waiting: list[tuple[Value, Value]] = []
        for value, to in pairs:
            if value == to:
                continue
            if isinstance(to, Scalar):
                waiting.append((self._w.local(replace(self._scalar(value), is_name=False)), to))
            else:
                reads = any(view.number in changing for view in value.views())
                waiting.append((self._copied(value) if reads else value, to))
        for value, to in waiting:  # arrays first: they may be computed from the old numbers
            if isinstance(to, View):
                self._w.write(value, to)
        for value, to in waiting:
            if isinstance(to, Scalar):
                self._w.say(f"{to.text} = {self._scalar(value).text};")

    def _cond(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        index, *operands = operation.inputs
        which = self._scalar(self._stored(index, environment)).text
        values = [self._stored(operand, environment) for operand in operands]
        results = [self._place_of_choice(i, operation, values, flat) for i in range(len(operation.outputs))]
        last = len(operation.inner) - 1
        for n, branch in enumerate(operation.inner):
            head = "else" if n == last else f"{'else ' if n else ''}if ({which} {'<=' if n == 0 else '=='} {n})"
            with self._w.block(head):
                result = self._body(branch, dict(zip(branch.inputs, values, strict=True)))
                needed = zip(result, results, operation.outputs, strict=True)
                pairs = [(value, to) for value, to, output in needed if output in flat.uses]
                for value, to in pairs:
                    if isinstance(to, Scalar):  # a variable of its own, which nothing reads
                        self._w.say(f"{to.text} = {self._scalar(value).text};")
                self._assign_all([(value, to) for value, to in pairs if isinstance(to, View)])
        return results

    def _place_of_choice(self, i: int, operation: Operation, values: Sequence[Value], flat: Flat) -> Value:
        """Place for a result of a choice; that of the argument if a branch returns it and nothing else needs it."""
        output = operation.outputs[i]
        if output not in flat.uses:
            return Scalar("0", output.kind)
        if math.prod(output.shape) == 1:
            return self._w.variable(output.kind, self._w.format.constant(0, output.kind))
        for branch in operation.inner:
            for variable, operand, value in zip(branch.inputs, operation.inputs[1:], values, strict=True):
                alone = isinstance(operand, Variable) and operand in self._changing and flat.uses[operand] == 1
                if alone and branch.outputs[i] is variable and isinstance(value, View):
                    return value
        return self._w.array(output.shape, output.kind)
