"""Lowering of a JAX function of one person and one sample to a scalar program, from which every target starts.

Nothing here belongs to a target: no vectors, no processor, no language. `lower` traces the function, takes it apart and
simplifies it; `glucoloop.native.targets` generate code from its result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

from glucoloop.native.divisions import share_divisions
from glucoloop.native.flatten import Drawing, Flattener
from glucoloop.native.functions import DOUBLE
from glucoloop.native.loops import Values
from glucoloop.native.program import PERSON, SAMPLE, Program, Value


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
