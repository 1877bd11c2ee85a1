"""Interpreter of a lowered function in NumPy, operation by operation: the reference for the checks of targets."""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered
from glucoloop.native.program import BOOL, DOES, OF_WORDS, WORD, Block, LoopForm, Program, Value

Array = npt.NDArray[Any]
_Step = tuple[int, Callable[..., Any], Sequence[int]]
"""Place of a result, what finds it, and places of the arguments."""

_KINDS: Final[dict[str, type[np.generic]]] = {BOOL: np.bool_, WORD: np.uint32}
"""Types of values that are no numbers."""


def _extreme(better: Callable[..., Any], a: Array, b: Array) -> Array:
    result: Array = np.where(a != a, a, np.where(better(a, b), a, b))
    return result


larger, smaller = (functools.partial(_extreme, better) for better in (np.greater, np.less))
"""The larger or smaller of two numbers, the second of two equal ones; NaN if either is NaN."""


def interpret(lowered: Lowered, **groups: Array) -> tuple[Array, Array]:
    """Compute a lowered function for many people at one sample; `Interpreter` is quicker for many samples."""
    return Interpreter(lowered)(**groups)


class Interpreter:
    """A lowered function, computed for many people at one sample after another; operations are put in order once."""

    def __init__(self, lowered: Lowered) -> None:
        program, layout = lowered.program, lowered.layout
        number = np.dtype(lowered.precision).type
        needed = program.needed(layout.results)
        place = {value: i for i, value in enumerate(needed)}
        self._number, self._size = number, len(needed)
        self._rows = {name: len(getattr(layout, name)) for name in ("person", "carry", "own", "shared")}
        self._inputs = {
            name: [
                (row, place[value], program.types[value])
                for row, value in enumerate(getattr(layout, name))
                if value in place
            ]
            for name in self._rows
        }
        self._constants = [
            (place[value], _KINDS.get(program.types[value], number)(program.constants[value]))
            for value in needed
            if value in program.constants
        ]
        self._steps = _steps(program, program.bodies(needed), place, lowered.precision)
        self._results = [[place[value] for value in group] for group in (layout.next_carry, layout.outputs)]

    def __call__(self, **groups: Array) -> tuple[Array, Array]:
        """The next state and the outputs, ``(numbers, people)``, of the groups `person`, `carry`, `own` and `shared`.

        A group without numbers may be left out; one with another number of rows than the function takes is refused.
        """
        people = next((np.shape(rows)[-1] for rows in groups.values()), 1)
        values: list[Any] = [None] * (self._size + 2)  # the last two: what nothing needs, and the list itself
        values[-1] = values
        for name, array in groups.items():
            rows = np.asarray(array, self._number)
            if len(rows) != self._rows[name]:
                raise ValueError(f"{name} has {len(rows)} rows, and the function takes {self._rows[name]}")
            for row, at, kind in self._inputs[name]:
                values[at] = rows[row].astype(_KINDS.get(kind, self._number))
        for at, constant in self._constants:
            values[at] = constant
        with np.errstate(all="ignore"):
            _carry_out(self._steps, values)

        def rows_of(places: Sequence[int]) -> Array:
            result = np.empty((len(places), people), self._number)
            for row, at in zip(result, places, strict=True):
                row[:] = values[at]
            return result

        next_carry, outputs = map(rows_of, self._results)
        return next_carry, outputs


def _carry_out(steps: Sequence[_Step], values: list[Any]) -> None:
    for at, does, arguments in steps:
        values[at] = does(*[values[a] for a in arguments])


def _go_round(
    loop: LoopForm,
    steps: Sequence[_Step],
    inputs: Sequence[Sequence[int]],
    groups: Sequence[Sequence[int]],
    values: list[Any],
) -> list[Any]:
    """All parts of a loop, by the places of its inputs and of the groups of its arguments."""
    (carry, row), (start, following, rows, outputs) = inputs, groups
    last, stacked = [values[at] for at in start], list[Any]()
    for k in itertools.count():
        if k == loop.length or (loop.over and np.all(last[loop.over[0]] == loop.over[1])):
            break
        for at, value in zip(carry, last, strict=True):
            values[at] = value
        for at, source in zip(row, rows[k * len(row) :], strict=False):
            values[at] = values[source]
        _carry_out(steps, values)
        last = [values[at] for at in following]
        stacked += [values[at] for at in outputs]
    return [*last, *stacked]


def _steps(program: Program, body: Block, place: Mapping[Value, int], precision: str) -> list[_Step]:
    """Operations of a body, each with the place of its result and those of its arguments."""
    steps: list[_Step] = []
    for step in body.steps:
        if isinstance(step, Block):
            assert step.value is not None
            loop = program.loops[step.value]
            inputs, groups = (
                [[place.get(v, -2) for v in group] for group in groups]
                for groups in ((loop.carry, loop.rows), loop.groups(program.operations[step.value][1]))
            )
            inside = _steps(program, step, place, precision)
            steps.append((place[step.value], functools.partial(_go_round, loop, inside, inputs, groups), [-1]))
        elif program.operations[step][0] == "part":
            value, number = program.operations[step][1]
            at = operator.itemgetter(int(program.constants[number]))
            steps.append((place[step], at, [place[value]]))
        elif step not in program.constants and program.operations[step][0] != "input":
            steps.append((place[step], *_operation(program, step, place, precision)))
    return steps


def _operation(
    program: Program, value: Value, place: Mapping[Value, int], precision: str
) -> tuple[Callable[..., Any], list[int]]:
    """Function of an operation, and the places of its arguments."""
    operation, arguments = program.operations[value]
    operands = [place[a] for a in arguments]
    if operation in ("max", "min"):
        # as every target does it: a constant comes first
        order = operands[::-1] if arguments[1] in program.constants else operands
        return (larger if operation == "max" else smaller), order
    if operation == "number":
        return functools.partial(np.asarray, dtype=precision), operands
    if operation in ("mantissa", "exponent", "power_of_two"):
        return functools.partial(_bits, operation, precision), operands
    if operation == "word":
        return lambda x: np.asarray(x, np.int64).astype(np.uint32), operands
    if operation == "number_of_bits":
        return _number_of_bits, operands
    return {**DOES, **OF_WORDS}[operation], operands


def _number_of_bits(high: Array, low: Array) -> Array:
    return np.asarray(np.left_shift(np.asarray(high, np.uint64), np.uint64(32)) | low).view(np.float64)


def _bits(operation: str, precision: str, x: Array) -> Array:
    whole, shift, bias = (np.uint64, 52, 1023) if precision == DOUBLE else (np.uint32, 23, 127)
    number, bits = np.dtype(precision), x.view(whole)
    if operation == "mantissa":
        mantissa = np.bitwise_or(np.bitwise_and(bits, whole(2**shift - 1)), whole(bias << shift))
        return np.asarray(mantissa).view(number)
    if operation == "exponent":
        exponents = np.bitwise_and(np.right_shift(bits, whole(shift)), whole(2 * bias + 1))
        return np.asarray(np.asarray(exponents).astype(number) - number.type(bias))
    powers = np.left_shift(bits, whole(shift)) + whole(bias << shift)
    return np.asarray(powers).view(number)
