"""Evaluation of a traced function in the compact form's arithmetic: the reference against which its C is checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.extend import core

from glucoloop.native import primitives
from glucoloop.native.targets.c.compact.arithmetic import Arithmetic, Array, constant


class Evaluation:
    """A traced function in the compact form's arithmetic, for repeated evaluation.

    Parameters
    ----------
    closed : ClosedJaxpr
        Traced in the precision.
    precision : {"float64", "float32"}
    """

    def __init__(self, closed: Any, precision: str) -> None:
        self._closed, self._arithmetic = closed, Arithmetic(precision)

    def __call__(self, arguments: Sequence[Any]) -> list[Array]:
        """Results of the function for arrays."""
        given = [constant(argument, self._arithmetic.precision) for argument in arguments]
        return _run(self._closed, given, self._arithmetic)


def _run(closed: Any, arguments: Sequence[Array], arithmetic: Arithmetic) -> list[Array]:
    jaxpr = closed.jaxpr
    values: dict[Any, Array] = dict(zip(jaxpr.invars, arguments, strict=True))
    for variable, array in zip(jaxpr.constvars, closed.consts, strict=True):
        values[variable] = constant(array, arithmetic.precision)

    def read(atom: Any) -> Array:
        return constant(atom.val, arithmetic.precision) if isinstance(atom, core.Literal) else values[atom]

    for equation in jaxpr.eqns:
        inputs = [read(atom) for atom in equation.invars]
        results = _equation(equation, inputs, arithmetic)
        values.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _equation(equation: Any, inputs: list[Array], arithmetic: Arithmetic) -> list[Array]:
    name, called = equation.primitive.name, primitives.called(equation)
    if called is not None:
        return _run(called, inputs, arithmetic)
    if name == "custom_linear_solve":
        solve, first, right = primitives.solver(equation)
        constants = len(solve.jaxpr.invars) - (len(inputs) - right)
        return _run(solve, [*inputs[first : first + constants], *inputs[right:]], arithmetic)
    if name == "cond":
        options = primitives.branches(equation)
        return _run(options[min(max(int(inputs[0]), 0), len(options) - 1)], inputs[1:], arithmetic)
    if name == "scan":
        return _scan(equation, inputs, arithmetic)
    return arithmetic(name, equation, inputs)


def _scan(equation: Any, inputs: list[Array], arithmetic: Arithmetic) -> list[Array]:
    loop = primitives.scan(equation)
    constants, rest = inputs[: loop.constants], inputs[loop.constants :]
    carry, each = rest[: loop.carried], rest[loop.carried :]
    rows: dict[int, list[Array]] = {}
    for k in reversed(range(loop.length)) if loop.reverse else range(loop.length):
        results = _run(loop.round, [*constants, *carry, *(a[k] for a in each)], arithmetic)
        carry, rows[k] = results[: loop.carried], results[loop.carried :]
    stacked = [np.stack(parts) for parts in zip(*(rows[k] for k in range(loop.length)), strict=True)]
    return [*carry, *stacked]
