"""Interpreter of a lowered function in NumPy, operation by operation: the reference for the checks of targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered
from glucoloop.native.program import BOOL, Program, Value

Array = npt.NDArray[Any]

_DOES: Final[dict[str, Callable[..., Any]]] = {
    "add": np.add,
    "sub": np.subtract,
    "exact_sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "copy_sign": np.copysign,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "is_finite": np.isfinite,
    "and": np.logical_and,
    "or": np.logical_or,
    "xor": np.logical_xor,
    "not": np.logical_not,
    "select": np.where,
}


def larger(a: Array, b: Array) -> Array:
    """The larger of two numbers, the second of two equal ones; NaN if either is NaN."""
    found: Array = np.where(a != a, a, np.where(a > b, a, b))
    return found


def smaller(a: Array, b: Array) -> Array:
    """The smaller of two numbers, the second of two equal ones; NaN if either is NaN."""
    found: Array = np.where(a != a, a, np.where(a < b, a, b))
    return found


def interpret(lowered: Lowered, **groups: Array) -> tuple[Array, Array]:
    """Compute a lowered function for many people at one sample.

    Parameters
    ----------
    lowered : Lowered
    **groups : (numbers, people) array
        ``person``, ``carry``, ``own`` and ``shared``; a group without numbers may be left out.

    Returns
    -------
    next_carry, outputs : (numbers, people) array
    """
    program, layout = lowered.program, lowered.layout
    number = np.dtype(lowered.precision).type
    people = next((np.shape(rows)[-1] for rows in groups.values()), 1)
    values: dict[Value, Array] = {
        value: row if program.types[value] != BOOL else row != 0.0
        for name, rows in groups.items()
        for value, row in zip(getattr(layout, name), np.asarray(rows, number), strict=True)
    }
    with np.errstate(all="ignore"):
        for value in program.needed(layout.results):
            if value in program.constants:
                known = program.constants[value]
                values[value] = np.full(people, known, bool if isinstance(known, bool) else number)
            elif program.operations[value][0] != "input":
                values[value] = _operation(program, value, values, lowered.precision)

    def rows(of: Sequence[Value]) -> Array:
        return np.array([values[v].astype(number) for v in of]).reshape(len(of), people)

    return rows(layout.next_carry), rows(layout.outputs)


def _operation(program: Program, value: Value, values: Mapping[Value, Array], precision: str) -> Array:
    operation, arguments = program.operations[value]
    given = [values[a] for a in arguments]
    if operation in ("max", "min"):
        # as every target does it: a constant comes first
        a, b = reversed(given) if arguments[1] in program.constants else given
        return (larger if operation == "max" else smaller)(a, b)
    if operation == "number":
        return given[0].astype(precision)
    if operation in ("mantissa", "exponent", "power_of_two"):
        return _bits(operation, given[0], precision)
    found: Array = _DOES[operation](*given)
    return found


def _bits(operation: str, x: Array, precision: str) -> Array:
    whole, shift, bias = (np.uint64, 52, 1023) if precision == DOUBLE else (np.uint32, 23, 127)
    number, bits = np.dtype(precision), x.view(whole)
    if operation == "mantissa":
        kept = np.bitwise_or(np.bitwise_and(bits, whole(2**shift - 1)), whole(bias << shift))
        return np.asarray(kept).view(number)
    if operation == "exponent":
        exponents = np.bitwise_and(np.right_shift(bits, whole(shift)), whole(2 * bias + 1))
        return np.asarray(np.asarray(exponents).astype(number) - number.type(bias))
    powers = np.left_shift(bits, whole(shift)) + whole(bias << shift)
    return np.asarray(powers).view(number)
