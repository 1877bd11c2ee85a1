"""Sharing of one division by several quotients.

A division takes as long as sixteen products. Quotients that do not need one another can share one, by Montgomery's
trick: ``1 / a`` and ``1 / b`` are ``b`` and ``a`` times ``1 / (a b)``. It is done for the operation ``ratio``, by which
elementary functions say that their denominators are not large, are above `_MIN_DENOMINATOR`, and are numbers if the
numerators are; each quotient then loses a unit or two in the last place. A denominator that is not a number is taken as
`_MIN_DENOMINATOR`: its own quotient is none by the numerator, and the others remain as they are.

References
----------
P. L. Montgomery, "Speeding the Pollard and elliptic curve methods of factorization", Math. Comp. 48, 1987.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from glucoloop.native.program import WORD, Home, Program, Value

_MIN_DENOMINATOR: Final = 0.5
"""Bound below the denominators that share a division."""
_QUOTIENTS_A_DIVISION: Final = 4
"""Quotients that share a division: more would leave the range of numbers in single precision."""


def share_divisions(program: Program, results: Sequence[Value]) -> tuple[Program, dict[Value, Value]]:
    """The same program with fewer divisions, and the place in it of each value on which the needed `results` depend."""
    order = program.needed(results)
    group_of = _groups(program, order)
    new = Program(as_written=program.as_written)
    place = {
        v: new.input(name, program.levels[v], program.types[v], program.homes[v]) for v, name in program.names.items()
    }
    for root in order:
        stack = [root]
        while stack:
            value = stack[-1]
            if value in place:
                stack.pop()
                continue
            group = group_of.get(value, (value,))
            missing = [a for member in group for a in program.operations[member][1] if a not in place]
            if missing:
                stack += missing
                continue
            stack.pop()
            if value in group_of:
                place.update(zip(group, _shared(program, new, place, group), strict=True))
            elif value in program.constants:
                constant = program.constants[value]
                place[value] = new.word(int(constant)) if program.types[value] == WORD else new.constant(constant)
            else:
                operation, arguments = program.operations[value]
                operands = [place[a] for a in arguments]
                if operation == "loop":
                    old = program.loops[value]
                    carry, rows = (tuple(place[a] for a in group) for group in (old.carry, old.rows))
                    place[value] = new.loop(replace(old, carry=carry, rows=rows), operands)
                elif operation == "part":
                    place[value] = new.part(operands[0], int(program.constants[arguments[1]]))
                else:
                    place[value] = new.apply(operation, *operands)
    return new, place


def _groups(program: Program, order: Sequence[Value]) -> dict[Value, tuple[Value, ...]]:
    """Quotients that share a division, by each quotient of the group.

    Quotients that have the same number of quotients one after the other before them do not depend on one another.
    """
    depth: dict[Value, int] = {}
    waiting: dict[tuple[int, Home, int], list[Value]] = {}
    for value in order:
        operation, arguments = program.operations[value]
        depth[value] = max((depth[a] for a in arguments), default=0)
        if operation == "ratio":
            waiting.setdefault((program.levels[value], program.homes[value], depth[value]), []).append(value)
            depth[value] += 1
    groups: dict[Value, tuple[Value, ...]] = {}
    for alike in waiting.values():
        together = 1 if program.as_written else _QUOTIENTS_A_DIVISION
        for start in range(0, len(alike), together):
            group = tuple(alike[start : start + together])
            groups.update(dict.fromkeys(group, group))
    return groups


def _shared(program: Program, new: Program, place: dict[Value, Value], group: Sequence[Value]) -> list[Value]:
    """The quotients of a group."""
    above, below = ([place[program.operations[v][1][i]] for v in group] for i in (0, 1))
    if len(group) == 1:
        return [new.apply("div", above[0], below[0])]
    minimum = new.constant(_MIN_DENOMINATOR)
    below = [new.apply("select", new.apply("lt", minimum, b), b, minimum) for b in below]
    products = list(itertools.accumulate(below, functools.partial(new.apply, "mul")))
    inverse = new.apply("div", new.constant(1.0), products[-1])
    quotients: list[Value] = []
    for i in range(len(group) - 1, 0, -1):
        quotients.append(new.apply("mul", above[i], new.apply("mul", inverse, products[i - 1])))
        inverse = new.apply("mul", inverse, below[i])
    quotients.append(new.apply("mul", above[0], inverse))
    return quotients[::-1]
