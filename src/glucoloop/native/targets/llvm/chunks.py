"""Division of a long program into chunks that fit a processor's instruction cache.

A sample of a patient and a controller is several thousand instructions. Where the cache cannot hold them, fetching them
anew for every vector of people would take most of the time. So they are cut into chunks, and several vectors go through
each chunk in turn; what a later chunk needs waits in a slot of memory, which is given to another value afterwards.
A program that fits goes through its chunks one vector at a time; the cuts then spare the compiler blocks that are too
long for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from glucoloop.native.lower import Layout
from glucoloop.native.program import SAMPLE, Program, Value

OPERATIONS_A_CHUNK: Final = 2000


@dataclass(frozen=True)
class Chunk:
    """A part of the program."""

    values: Sequence[Value]
    stored: Sequence[tuple[Value, int]]
    """Values that a later chunk needs, each with its slot of memory."""
    carried: Sequence[tuple[Value, int]]
    """Values of the next state, each with its place there."""
    written: Sequence[tuple[Value, int]]


@dataclass(frozen=True)
class ChunkPlan:
    """Division of the whole program into chunks."""

    chunks: Sequence[Chunk]
    slot_of: dict[Value, int]
    slots: int


def plan_chunks(
    program: Program,
    layout: Layout,
    values: Sequence[Value],
    fused: Mapping[Value, Value],
    size: int = OPERATIONS_A_CHUNK,
    vectors: Mapping[Value, Sequence[Value]] | None = None,
) -> ChunkPlan:
    """Divide values that are computed at every sample, each after its arguments, into chunks.

    `fused` are the products that are computed together with a sum; `vectors` the values that are needed where a loop
    over rows begins, by the first of its sums.
    """
    parts = [values[i : i + size] for i in range(0, len(values), size)] or [[]]
    home = {value: number for number, part in enumerate(parts) for value in part}
    last_use: dict[Value, int] = {}
    for value, number in home.items():
        for argument in (vectors or {}).get(value) or _arguments(program, value, fused):
            if argument in home:
                last_use[argument] = max(number, last_use.get(argument, 0))
    leaving: dict[int, list[Value]] = {}
    for value, last in last_use.items():
        if last > home[value]:
            leaving.setdefault(last, []).append(value)

    slot_of: dict[Value, int] = {}
    free: list[int] = []
    slots = 0
    chunks = []
    for number, part in enumerate(parts):
        stored = []
        for value in part:
            if last_use.get(value, number) > number:
                if not free:
                    free.append(slots)
                    slots += 1
                slot_of[value] = free.pop()
                stored.append((value, slot_of[value]))
        # only now: a slot that this chunk reads must not be overwritten by it
        free += [slot_of[value] for value in leaving.get(number, ())]
        chunks.append((part, stored))

    def at(results: Sequence[Value], number: int) -> list[tuple[Value, int]]:
        # what is not computed at a sample (a constant, an input) goes with the last chunk
        return [(v, i) for i, v in enumerate(results) if home.get(v, len(parts) - 1) == number]

    return ChunkPlan(
        chunks=[
            Chunk(values=part, stored=stored, carried=at(layout.next_carry, n), written=at(layout.outputs, n))
            for n, (part, stored) in enumerate(chunks)
        ],
        slot_of=slot_of,
        slots=slots,
    )


def _arguments(program: Program, value: Value, fused: Mapping[Value, Value]) -> list[Value]:
    """Values from which a value is computed, including those of a product that is fused with it."""
    found: list[Value] = []
    for argument in program.operations[value][1]:
        if fused.get(argument) == value:
            found += program.operations[argument][1]
        else:
            found.append(argument)
    return [argument for argument in found if program.levels[argument] == SAMPLE]
