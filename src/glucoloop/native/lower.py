"""Lowering of a JAX function of one person and one sample to a scalar program, from which every target starts.

Nothing here belongs to a target: no vectors, no processor, no language. `lower` traces the function, takes it apart and
simplifies it; `glucoloop.native.targets` generate code from its result.

Quotients share divisions. A division takes as long as sixteen products. Quotients that do not need one another can
share one, by Montgomery's trick: ``1 / a`` and ``1 / b`` are ``b`` and ``a`` times ``1 / (a b)``. It is done for the
operation ``ratio``, by which elementary functions say that their denominators are not large, are above
`_MIN_DENOMINATOR`, and are numbers if the numerators are; each quotient then loses a unit or two in the last place. A
denominator that is not a number is taken as `_MIN_DENOMINATOR`: its own quotient is none by the numerator, and the
others remain as they are.

References
----------
P. L. Montgomery, "Speeding the Pollard and elliptic curve methods of factorization", Math. Comp. 48, 1987.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import jax

from glucoloop.native.flatten import Drawing, Flattener
from glucoloop.native.functions import DOUBLE
from glucoloop.native.loops import Values
from glucoloop.native.program import PERSON, SAMPLE, WORD, Home, Program, Value

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


@dataclass(frozen=True)
class Layout:
    """The order in which code takes its numbers and gives them back, as values of a program.

    The numbers of a group are those of the leaves of its tree (see `Shapes`), each leaf row by row. Truths and whole
    numbers are held as numbers.
    """

    person: Sequence[Value]
    """Numbers of a person, the same at every sample."""
    carry: Sequence[Value]
    """The state before the sample."""
    own: Sequence[Value]
    """Inputs of each person at the sample, then the values that `Lowered.drawing` draws for the person."""
    shared: Sequence[Value]
    """Inputs of the sample that are the same for all people."""
    next_carry: Sequence[Value]
    """The state after the sample, in the order of `carry`."""
    outputs: Sequence[Value]
    """Outputs of the sample."""

    @property
    def results(self) -> list[Value]:
        """All results: the next state, then the outputs."""
        return [*self.next_carry, *self.outputs]

    @property
    def sizes(self) -> dict[str, int]:
        """Number of numbers in each group of arrays."""
        return {name: len(getattr(self, name)) for name in ("person", "carry", "own", "shared", "outputs")}


@dataclass(frozen=True)
class Shapes:
    """The trees that a function takes and returns, with `jax.ShapeDtypeStruct` for leaves.

    The host makes records of rows by them, and a target may name its fields after them.
    """

    person: Any
    carry: Any
    own: Any
    shared: Any
    outputs: Any


@dataclass(frozen=True, eq=False)
class Lowered:
    """``carry, outputs = step(person, carry, own, shared, rng)`` of one person and one sample, in scalars.

    The program and its layout are plain data and can be pickled. Levels of the program's values tell what can be
    computed once for each person (``PERSON``) and what changes at each sample (``SAMPLE``).
    """

    program: Program
    layout: Layout
    shapes: Shapes
    drawing: Drawing
    """Random numbers of a sample, which the host computes beforehand with JAX."""
    precision: str
    """``"float64"`` or ``"float32"``, for which elementary functions were chosen."""


def lower(
    step: Callable[..., tuple[Any, Any]],
    person: Any,
    carry: Any,
    own: Any,
    shared: Any,
    rng: Any = (),
    *,
    precision: str = DOUBLE,
    as_written: bool = False,
    flattener: type[Flattener] = Flattener,
) -> Lowered:
    """Lower ``carry, outputs = step(person, carry, own, shared, rng)`` to scalars.

    The step is a pure JAX function of one person and one sample. The other arguments are examples or shapes, without an
    axis of people: the numbers of a person, the state, and the inputs of one person and of all people at a sample; and
    random keys and the number of the sample, for what rests on `rng` alone is left to the host. A program `as_written`
    rounds every operation as the function has it (see `Program`), for results that do not depend on which numbers are
    part of the program. `flattener` takes the function apart. `UnsupportedError` names an operation that straight-line
    code cannot express.
    """
    examples = jax.eval_shape(lambda *groups: groups, person, carry, own, shared, rng)
    closed, (next_carry, outputs) = jax.make_jaxpr(step, return_shape=True)(*examples)
    before, after = ([leaf.shape for leaf in jax.tree.leaves(tree)] for tree in (examples[1], next_carry))
    if before != after:
        raise TypeError(f"the state has leaves of shapes {before} before a sample, but {after} after it")
    program = Program(as_written=as_written)
    flat = flattener(program, precision)
    levels = {"person": PERSON, "carry": SAMPLE, "own": SAMPLE, "shared": SAMPLE}
    inputs = {
        name: [flat.input((name, i), leaf, level) for i, leaf in enumerate(jax.tree.leaves(tree))]
        for (name, level), tree in zip(levels.items(), examples[:4], strict=True)
    }
    keys = [flat.random_input(leaf) for leaf in jax.tree.leaves(examples[4])]
    results = flat.run(closed, [*(leaf for group in inputs.values() for leaf in group), *keys])
    drawing, random_numbers = flat.drawing()
    program, place = share_divisions(program, _flat(results))

    def placed(values: Sequence[Values]) -> list[Value]:
        return [place[v] for v in _flat(values)]

    layout = Layout(
        person=placed(inputs["person"]),
        carry=placed(inputs["carry"]),
        own=placed([*inputs["own"], *random_numbers]),
        shared=placed(inputs["shared"]),
        next_carry=placed(results[: len(before)]),
        outputs=placed(results[len(before) :]),
    )
    shapes = Shapes(person=examples[0], carry=next_carry, own=examples[2], shared=examples[3], outputs=outputs)
    return Lowered(program=program, layout=layout, shapes=shapes, drawing=drawing, precision=precision)


def _flat(values: Sequence[Values]) -> list[Value]:
    return [int(v) for array in values for v in array.ravel()]
