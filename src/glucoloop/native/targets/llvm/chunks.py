"""Division of a long program into chunks that fit a processor's instruction cache.

A sample of a patient and a controller is several thousand instructions. Where the cache cannot hold them, fetching them
again for every vector of people would take most of the time. They are cut into chunks, and several vectors go through
each chunk in turn; what a later chunk needs waits in a slot of memory, which is given to another value afterwards.
A program that fits goes through its chunks one vector at a time; the cuts then spare the compiler blocks that are too
long for it. A loop has chunks of its own, and memory for what passes into its rounds, between them and out of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from glucoloop.native.lower import Layout
from glucoloop.native.program import SAMPLE, Block, LoopForm, Program, Value

FITS_THE_CACHE: Final = 1500
"""Number of operations, about, whose instructions fit the processor's first-level cache, at 20 bytes each."""
LONG: Final = 6000
"""Number of operations from which on a program has other chunks than a shorter one."""
OPERATIONS_A_CHUNK: Final = 2000, 500
"""The same of a chunk, in a short program and a long one, where what a vector needs of memory then fits the cache."""
OPERATIONS_OF_SEVERAL: Final = 75, 150
"""The same where several vectors go through each chunk in turn: of a shorter chunk, more stays in registers."""

_Cell = tuple[str, int, str | None]
"""Name of an array of a loop, a place in it, and the name of a number that is added to the place."""


@dataclass
class Chunk:
    """A part of the program."""

    values: Sequence[Value]
    stored: list[tuple[Value, _Cell]] = field(default_factory=list)
    """Values that a later chunk, rounds of a loop or the next sample need, each with its place."""
    written: Sequence[tuple[Value, int]] = ()


@dataclass(frozen=True)
class Rounds:
    """A loop of chunks."""

    label: str
    loop: LoopForm
    first: int
    """Number of its first chunk."""
    last: int
    outputs: int
    """Number of values that each round gives."""


@dataclass(frozen=True)
class _ChunkPlan:
    """Division of the whole program into chunks."""

    chunks: Sequence[Chunk]
    loops: Sequence[Rounds]
    """Loops, each after those inside it."""
    cells: dict[Value, _Cell]
    """Places where the state, inputs of rounds, parts of loops and values of earlier chunks are read."""
    slots: int


class _Cutter:
    """Cuts a body and the loops in it into chunks."""

    def __init__(self, program: Program, size: int) -> None:
        self._p, self._size = program, size
        self.chunks: list[Chunk] = []
        self.loops: list[Rounds] = []
        self.cells: dict[Value, _Cell] = {}
        self.home: dict[Value, int] = {}
        """Number of the chunk of each value."""

    def cut(self, body: Block) -> None:
        """Append the chunks of a body, and one before each of its loops."""
        waiting: list[Value] = []
        for step in [*body.steps, None]:
            if isinstance(step, Value):
                if self._p.operations[step][0] == "part":
                    self._find(step)
                elif step not in self.cells:
                    waiting.append(step)
                continue
            for i in range(0, max(len(waiting), 1), self._size):
                self.home.update(dict.fromkeys(waiting[i : i + self._size], len(self.chunks)))
                self.chunks.append(Chunk(waiting[i : i + self._size]))
            waiting = []
            if step is not None:
                self._loop(step)

    def _loop(self, body: Block) -> None:
        assert body.value is not None
        loop, first = self._p.loops[body.value], len(self.chunks)
        label = _label(loop)
        start, following, rows, outputs = loop.groups(self._p.operations[body.value][1])
        self.cells.update({v: (f"%{label}_old", i, None) for i, v in enumerate(loop.carry)})
        self.cells.update({v: (f"%{label}_rows", i, f"%{label}_row") for i, v in enumerate(loop.rows)})
        self._pass(start, (f"%{label}_start", 0, None), loop.home[:-1])
        self._pass(rows, (f"%{label}_rows", 0, None), loop.home[:-1])
        self.cut(body)
        self._pass(following, (f"%{label}_new", 0, None), loop.home)
        self._pass(outputs, (f"%{label}_outputs", 0, f"%{label}_at"), loop.home)
        self.loops.append(Rounds(label, loop, first, len(self.chunks) - 1, len(outputs)))

    def _pass(self, values: Sequence[Value], to: _Cell, home: tuple[int, ...]) -> None:
        """Pass values to places that follow one another: from the chunk of a value, or from the last one so far."""
        for i, value in enumerate(values, start=to[1]):
            number = self.home.get(value, -1) if self._p.homes[value] == home else -1
            self.chunks[number].stored.append((value, (to[0], i, to[2])))

    def _find(self, part: Value) -> None:
        value, number = self._p.operations[part][1]
        loop, place = self._p.loops[value], int(self._p.constants[number])
        carry, label = len(loop.carry), _label(loop)
        # Rounds write in one place and in the other, in turns; what ends early is brought to the first.
        last = "start" if loop.over or loop.length is None or loop.length % 2 == 0 else "next"
        self.cells[part] = (
            (f"%{label}_{last}", place, None) if place < carry else (f"%{label}_outputs", place - carry, None)
        )


def _label(loop: LoopForm) -> str:
    """Beginning of the names of a loop's code and memory."""
    return "loop" + "_".join(map(str, loop.home))


def plan_chunks(
    program: Program,
    layout: Layout,
    body: Block,
    fused: Mapping[Value, Value],
    size: int,
    vectors: Mapping[Value, Sequence[Value]] | None = None,
) -> _ChunkPlan:
    """Divide values that are computed at every sample into chunks of a size.

    `fused` are the products that are computed together with a sum; `vectors` the values that are needed where a loop
    over rows begins, by the first of its sums.
    """
    cutter = _Cutter(program, size)
    cutter.cut(body)
    chunks, home = cutter.chunks, cutter.home
    last_use: dict[Value, int] = {}
    for number, chunk in enumerate(chunks):
        used = [a for value in chunk.values for a in (vectors or {}).get(value) or _arguments(program, value, fused)]
        last_use.update({v: number for v in (*used, *(v for v, _ in chunk.stored)) if v in home})
    for rounds in cutter.loops:  # what a round reads from before the loop, the next one reads too
        for value, last in last_use.items():
            if home[value] < rounds.first <= last <= rounds.last:
                last_use[value] = rounds.last
    leaving: dict[int, list[Value]] = {}
    for value, last in last_use.items():
        if last > home[value]:
            leaving.setdefault(last, []).append(value)

    free: list[int] = []
    slots = 0
    # what is not computed at a sample (a constant, an input) goes with the last chunk
    following, outputs = (
        [(v, i, home.get(v, len(chunks) - 1)) for i, v in enumerate(results)]
        for results in (layout.next_carry, layout.outputs)
    )
    for number, chunk in enumerate(chunks):
        live = [value for value in chunk.values if last_use.get(value, number) > number]
        for value in live:
            if not free:
                free.append(slots)
                slots += 1
            cutter.cells[value] = "%slots", free.pop(), None
        # only now: a slot that this chunk reads must not be overwritten by it
        free += [cutter.cells[value][1] for value in leaving.get(number, ())]
        chunk.stored[:0] = [(value, cutter.cells[value]) for value in live]
        chunk.stored += [(value, ("%new", i, None)) for value, i, there in following if there == number]
        chunk.written = [(value, i) for value, i, there in outputs if there == number]
    cutter.cells.update({value: ("%old", i, None) for i, value in enumerate(layout.carry)})
    return _ChunkPlan(chunks, cutter.loops, cutter.cells, slots)


def _arguments(program: Program, value: Value, fused: Mapping[Value, Value]) -> list[Value]:
    """Values from which a value is computed, including those of a product that is fused with it."""
    result: list[Value] = []
    for argument in program.operations[value][1]:
        if fused.get(argument) == value:
            result += program.operations[argument][1]
        else:
            result.append(argument)
    return [argument for argument in result if program.levels[argument] == SAMPLE]
