"""Evaluation of a traced function in the compact form's arithmetic: the reference against which its C is checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.extend import core

from glucoloop.native import primitives
from glucoloop.native.targets.c.compact.arithmetic import LARGEST_CONSTANT, SAME, Arithmetic, Array, constant


class Evaluation:
    """A function that was traced in a precision, in the compact form's arithmetic, for repeated evaluation."""

    def __init__(self, closed: Any, precision: str) -> None:
        self._closed, self._arithmetic = closed, Arithmetic(precision)

    def __call__(self, arguments: Sequence[Any]) -> list[Array]:
        """Results of the function for arrays."""
        given = [constant(argument, self._arithmetic.precision) for argument in arguments]
        return _run(self._closed, given, self._arithmetic, [False] * len(given))[0]


def _run(
    closed: Any, arguments: Sequence[Array], arithmetic: Arithmetic, known: Sequence[bool]
) -> tuple[list[Array], list[bool]]:
    """Results of a function, and whether each depends on constants alone."""
    jaxpr = closed.jaxpr
    values: dict[Any, Array] = dict(zip(jaxpr.invars, arguments, strict=True))
    constants = {variable for variable, is_known in zip(jaxpr.invars, known, strict=True) if is_known}
    for variable, array in zip(jaxpr.constvars, closed.consts, strict=True):
        values[variable] = constant(array, arithmetic.precision)
        constants.add(variable)

    def read(atom: Any) -> Array:
        return constant(atom.val, arithmetic.precision) if isinstance(atom, core.Literal) else values[atom]

    def is_constant(atom: Any) -> bool:
        return isinstance(atom, core.Literal) or atom in constants

    for equation in jaxpr.eqns:
        inputs = [read(atom) for atom in equation.invars]
        results, found = _equation(equation, inputs, arithmetic, [is_constant(atom) for atom in equation.invars])
        values.update(zip(equation.outvars, results, strict=True))
        constants |= {variable for variable, is_known in zip(equation.outvars, found, strict=True) if is_known}
    return [read(atom) for atom in jaxpr.outvars], [is_constant(atom) for atom in jaxpr.outvars]


def _equation(
    equation: Any, inputs: list[Array], arithmetic: Arithmetic, known: list[bool]
) -> tuple[list[Array], list[bool]]:
    name, called = equation.primitive.name, primitives.called(equation)
    if called is not None:
        return _run(called, inputs, arithmetic, known)
    if name == "custom_linear_solve":
        solve, taken = primitives.solver(equation)
        return _run(solve, [inputs[i] for i in taken], arithmetic, [known[i] for i in taken])
    if name == "cond":
        options = primitives.branches(equation)
        branch = options[min(max(int(inputs[0]), 0), len(options) - 1)]
        if known[0]:
            return _run(branch, inputs[1:], arithmetic, known[1:])
        results, _ = _run(branch, inputs[1:], arithmetic, [False] * len(inputs[1:]))
        return results, [False] * len(results)
    if name == "scan":
        results = _scan(equation, inputs, arithmetic)
        return results, [False] * len(results)
    results = arithmetic(name, equation, inputs, known)
    kept = name in SAME or all(result.size <= LARGEST_CONSTANT for result in results)
    return results, [kept and all(known)] * len(results)


def _scan(equation: Any, inputs: list[Array], arithmetic: Arithmetic) -> list[Array]:
    loop = primitives.scan(equation)
    constants, rest = inputs[: loop.constants], inputs[loop.constants :]
    carry, each = rest[: loop.carried], rest[loop.carried :]
    rows: dict[int, list[Array]] = {}
    for k in reversed(range(loop.length)) if loop.reverse else range(loop.length):
        given = [*constants, *carry, *(a[k] for a in each)]
        results, _ = _run(loop.round, given, arithmetic, [False] * len(given))
        carry, rows[k] = results[: loop.carried], results[loop.carried :]
    stacked = [np.stack(parts) for parts in zip(*(rows[k] for k in range(loop.length)), strict=True)]
    return [*carry, *stacked]
