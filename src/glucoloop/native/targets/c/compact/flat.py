"""Flattening of a traced function: calls are inlined, constants computed, and repeated computations shared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from glucoloop.native import primitives
from glucoloop.native.targets.c.compact.arithmetic import LARGEST_CONSTANT, Arithmetic, Array, constant
from glucoloop.native.targets.c.numbers import REAL, kind_of


@dataclass(frozen=True, eq=False)
class Variable:
    """An array that is computed or given."""

    shape: tuple[int, ...]
    kind: str


Operand = Variable | Array
_NOTHING: Final = np.zeros((), np.int32)
INSIDE: Final = "inside"
"""Whether a number is at least one and at most another."""
CLIP: Final = "clip"
"""The smaller of a number and the larger of two others."""


@dataclass(frozen=True, eq=False)
class Operation:
    """One operation of a flat function."""

    name: str
    equation: Any
    """Equation as JAX traced it, for its parameters."""
    inputs: Sequence[Operand]
    outputs: Sequence[Variable]
    inner: Sequence[Flat] = ()
    """Body of a loop, or branches of a choice."""


@dataclass(frozen=True, eq=False)
class Flat:
    """A function without calls."""

    inputs: Sequence[Variable]
    operations: Sequence[Operation]
    outputs: Sequence[Operand]
    uses: Mapping[Variable, int] = field(default_factory=dict)
    """Number of uses of each variable."""


def flatten(closed: Any, precision: str) -> Flat:
    """Flatten a traced function."""
    return _Flattener(precision).function(closed)


class _Flattener:
    def __init__(self, precision: str) -> None:
        self._precision = precision
        self._arithmetic = Arithmetic(precision)
        self._operations: list[Operation] = []
        self._by_key: dict[Any, Sequence[Variable]] = {}
        self._producers: dict[Variable, Operation] = {}

    def function(self, closed: Any) -> Flat:
        inner = _Flattener(self._precision)
        inputs = [_variable(v) for v in closed.jaxpr.invars]
        outputs = inner._run(closed, inputs)
        return _pruned(inputs, inner._operations, outputs)

    def _run(self, closed: Any, arguments: Sequence[Operand]) -> list[Operand]:
        return primitives.evaluated(closed, arguments, lambda array: constant(array, self._precision), self._equation)

    def _equation(self, equation: Any, inputs: list[Operand]) -> Sequence[Operand]:
        name, callee = equation.primitive.name, primitives.callee(equation)
        if callee is not None:
            return self._run(callee, inputs)
        if name in primitives.SAME:
            return inputs
        if name == "custom_linear_solve":
            solve, indices = primitives.solver(equation)
            return self._run(solve, [inputs[i] for i in indices])
        if name == "convert_element_type" and isinstance(inputs[0], Variable) and _same_kind(equation):
            return inputs
        if name == "cond":
            return self._choice(equation, inputs)
        if name == "scan":
            inner = (self.function(primitives.scan(equation).round),)
            return self._add(name, equation, inputs, inner)
        small = all(v.aval.size <= LARGEST_CONSTANT for v in equation.outvars)
        if small and not any(isinstance(operand, Variable) for operand in inputs):
            return self._arithmetic(name, equation, [g for g in inputs if not isinstance(g, Variable)])
        return self._add(name, equation, inputs)

    def _choice(self, equation: Any, inputs: list[Operand]) -> Sequence[Operand]:
        options = primitives.branches(equation)
        if not isinstance(inputs[0], Variable):
            return self._run(options[min(max(int(inputs[0]), 0), len(options) - 1)], inputs[1:])
        return self._add("cond", equation, inputs, tuple(self.function(option) for option in options))

    def _add(
        self, name: str, equation: Any, inputs: Sequence[Operand], inner: Sequence[Flat] = ()
    ) -> Sequence[Variable]:
        name, inputs = self._joined(name, equation, inputs)
        if not inner:
            key = (name, str(equation.params), tuple(str(v.aval) for v in equation.outvars), *map(_key, inputs))
            if key in self._by_key:
                return self._by_key[key]
        outputs = [_variable(v) for v in equation.outvars]
        operation = Operation(name, equation, inputs, outputs, inner)
        self._operations.append(operation)
        self._producers.update(dict.fromkeys(outputs, operation))
        if not inner:
            self._by_key[key] = outputs
        return outputs

    def _joined(self, name: str, equation: Any, inputs: Sequence[Operand]) -> tuple[str, Sequence[Operand]]:
        """Two operations that make one of C: whether a number lies within bounds, and the nearest one within them."""
        producers = [self._producers.get(operand) if isinstance(operand, Variable) else None for operand in inputs]
        if name == "and" and producers[0] is not None and producers[1] is not None:
            low, high = producers[0], producers[1]
            of_low, of_high = low.inputs[0], high.inputs[0]
            if (low.name, high.name) == ("ge", "le") and of_low is of_high and _is_real(low.equation):
                return INSIDE, [of_low, low.inputs[1], high.inputs[1]]
        if name == "min" and producers[1] is not None and producers[1].name == "max" and _is_real(equation):
            return CLIP, [producers[1].inputs[1], producers[1].inputs[0], inputs[0]]
        return name, inputs


def _is_real(equation: Any) -> bool:
    return kind_of(equation.invars[0].aval.dtype) == REAL


def _variable(atom: Any) -> Variable:
    return Variable(tuple(atom.aval.shape), kind_of(atom.aval.dtype))


def _same_kind(equation: Any) -> bool:
    return kind_of(equation.invars[0].aval.dtype) == kind_of(equation.outvars[0].aval.dtype)


def _key(operand: Operand) -> Any:
    if isinstance(operand, Variable):
        return id(operand)
    return operand.shape, operand.dtype.str, operand.tobytes()


def _pruned(inputs: Sequence[Variable], operations: Sequence[Operation], outputs: Sequence[Operand]) -> Flat:
    """The function without unused operations, and with the number of uses of each variable."""
    uses: dict[Variable, int] = {}
    needed: list[Operation] = []

    def use(operand: Operand) -> None:
        if isinstance(operand, Variable):
            uses[operand] = uses.get(operand, 0) + 1

    for output in outputs:
        use(output)
    for operation in reversed(operations):
        if any(output in uses for output in operation.outputs):
            lean = _lean(operation, [output in uses for output in operation.outputs])
            needed.append(lean)
            for operand in lean.inputs:
                use(operand)
    return Flat(inputs=inputs, operations=needed[::-1], outputs=outputs, uses=uses)


def _lean(operation: Operation, used: Sequence[bool]) -> Operation:
    """A loop or a choice without what only its unused results need; these become 0."""
    if not operation.inner:
        return operation
    if operation.name == "cond":
        inner = tuple(_with_outputs(branch, used) for branch in operation.inner)
        return replace(operation, inner=inner)
    loop, (body,) = primitives.scan(operation.equation), operation.inner
    live = list(used)
    while True:  # a number that is carried on is needed if a round needs it for another one
        inner_body = _with_outputs(body, live)
        carry = inner_body.inputs[loop.constants : loop.constants + loop.carry]
        needed = [is_live or variable in inner_body.uses for variable, is_live in zip(carry, live, strict=False)]
        if needed == live[: loop.carry]:
            break
        live[: loop.carry] = needed
    inputs = [
        _NOTHING if loop.constants <= i < loop.constants + loop.carry and not live[i - loop.constants] else operand
        for i, operand in enumerate(operation.inputs)
    ]
    return replace(operation, inputs=inputs, inner=(inner_body,))


def _with_outputs(flat: Flat, used: Sequence[bool]) -> Flat:
    outputs = [output if is_used else _NOTHING for output, is_used in zip(flat.outputs, used, strict=True)]
    return _pruned(flat.inputs, flat.operations, outputs)
