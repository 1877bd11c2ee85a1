"""A scalar program as LLVM vector code: many people side by side, one in each lane.

Each lane does the same operations in the same order, none of which the compiler may reorder, so the results of a person
do not depend on who is in the other lanes. Fused products are written as such; LLVM makes no others.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Final

from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered
from glucoloop.native.program import BOOL, PERSON, SAMPLE, WORD, Program, Value
from glucoloop.native.targets import FUSED
from glucoloop.native.targets.llvm.chunks import (
    FITS_THE_CACHE,
    LONG,
    OPERATIONS_A_CHUNK,
    OPERATIONS_OF_SEVERAL,
    Chunk,
    Rounds,
    plan_chunks,
)
from glucoloop.native.targets.llvm.rows import MatrixRows, find_rows
from glucoloop.native.targets.llvm.vectors import VectorCode

_VECTORS_A_BLOCK: Final = 4
"""Number of vectors that go through a chunk of a longer program while its instructions are in the cache."""

_ARRAYS: Final = ("carry", "own", "shared", "outputs")
"""Arrays that every function that is written takes."""


class Emitter:
    """Writer of the code of one kernel, with products fused or strict, and `lanes` people side by side in one vector.

    Each operation is written for so many `vectors`, which the processor carries out one beside another.
    If it is apart, under a name, what is computed once for each person has a function of its own: for a caller that
    goes through the samples and the vectors itself. See `text`.
    """

    def __init__(self, lowered: Lowered, products: str, lanes: int, *, vectors: int = 1, apart: str = "") -> None:
        lanes *= vectors
        program, layout = self._p, self._layout = lowered.program, lowered.layout
        self._apart = apart
        self._lanes = lanes
        double = lowered.precision == DOUBLE
        # Arrays that have people side by side begin anywhere.
        alignment = lanes * (8 if double else 4) if apart else 8 if double else 4
        self._out = VectorCode(lanes, double=double, alignment=alignment)
        self._tables: list[str] = []
        self._names: dict[Value, str] = {}
        self._firsts: dict[tuple[str, str | None], str] = {}
        self._member: str | None = None
        self._lengths: dict[str, int] = {}
        self._vector = self._column = self._own = ""

        results = layout.results
        order = program.needed(results)
        self._fused_sums = _fused_products(program, order, results) if products == FUSED else {}
        self._once = [v for v in order if program.levels[v] == PERSON]
        varying = [v for v in order if program.levels[v] == SAMPLE and v not in self._fused_sums]
        needed = [a for v in order if program.levels[v] == SAMPLE for a in program.operations[v][1]]
        self._persons = {v: i for i, v in enumerate(layout.person)}
        per_person = [v for v in dict.fromkeys([*needed, *results]) if program.levels[v] == PERSON]
        in_memory = self._persons if apart else {}  # which need not be copied, since they lie before the others
        computed = [v for v in per_person if v not in in_memory]
        self._per_person = {v: i + len(in_memory) for i, v in enumerate(computed)}
        """Place of each value that is computed once and needed at every sample."""
        arriving = {name: getattr(layout, name) for name in ("carry", "own", "shared")}
        self._sources = {v: (name, i) for name, values in arriving.items() for i, v in enumerate(values)}
        values = [v for v in varying if v not in self._sources]
        # A caller's numbers are at known places only if the function is apart.
        rows = find_rows(program, values, results, self._persons | self._per_person) if apart else []
        self._rows = {min(row.sums, key=values.index): row for row in rows}
        """Rows by the first of them that is computed."""
        self._sums = {v: i for i, v in enumerate(v for row in rows for v in row.sums)}
        """Place of each row's value, which waits in memory."""
        inner = {v for row in rows for v in row.inner} | (self._sums.keys() - self._rows.keys())
        values = [v for v in values if v not in inner]
        self._group = 1 if apart or vectors > 1 or len(values) <= FITS_THE_CACHE else _VECTORS_A_BLOCK
        factors = {first: row.factors for first, row in self._rows.items()}
        size = (OPERATIONS_A_CHUNK if self._group == 1 else OPERATIONS_OF_SEVERAL)[len(values) > LONG]
        self._plan = plan_chunks(program, layout, program.bodies(values), self._fused_sums, size, vectors=factors)
        self.room = 0
        """Number of vectors in which the function works that is written, unless it is apart."""

    @property
    def per_person(self) -> int:
        """Number of values of a person that are computed once, beside the numbers of the person."""
        return len(self._per_person)

    def text(self) -> str:
        """A module with the function ``kernel``.

        Its arguments are those of `Kernel.run` with `room` more vectors in which it works, the number of columns, the
        first and the last vector, and the number of samples. If it is apart, it has two functions for one vector of
        people, whose numbers lie together: ``NAME_per_person(per_person)`` reads the numbers of the people in the first
        places of `per_person` and fills the others, and ``NAME(per_person, carry, own, shared, outputs, samples)`` goes
        on from these. `samples` has 32 bits, since JavaScript has numbers of 64 bits only as objects.
        """
        if self._apart:
            self._write(f"{self._apart}_per_person", ("per_person",), (), self._compute_per_person)
            self._write(self._apart, ("per_person", *_ARRAYS), ("samples",), self._samples)
        else:
            self._write("kernel", ("person", *_ARRAYS, "room"), ("stride", "first", "last", "samples"), self._blocks)
        return "\n".join([*self._out.lines, *self._out.declarations(), *self._tables]) + "\n"

    def _write(self, name: str, arrays: Sequence[str], numbers: Sequence[str], body: Callable[[], None]) -> None:
        kind = "i32 %short_" if self._apart else "i64 %"
        parameters = [*(f"ptr noalias %{array}" for array in arrays), *(f"{kind}{number}" for number in numbers)]
        self._out.say(f"define void @{name}({', '.join(parameters)}) #0 {{")
        self._out.say("entry:")
        if self._apart:
            for number in numbers:
                self._out.say(f"  %{number} = zext i32 %short_{number} to i64")
        body()
        self._out.say("  ret void")
        self._out.say("}")

    def _blocks(self) -> None:
        """Carry all vectors through all samples, a block at a time."""
        say = self._out.say
        self._room(per_person=self.per_person)
        say("  %nothing = icmp sge i64 %first, %last")
        say("  br i1 %nothing, label %end, label %block")
        say("block:")
        say("  %b = phi i64 [ %first, %entry ], [ %b_next, %block_end ]")
        if self._group > 1:
            say("  %rest = sub i64 %last, %b")
            say(f"  %few = icmp slt i64 %rest, {self._group}")
            say(f"  %members = select i1 %few, i64 %rest, i64 {self._group}")
        self._loop("once", self._compute_per_person)
        self._samples()
        self._out.enter("block_end")
        say(f"  %b_next = add i64 %b, {self._group}")
        say("  %again = icmp slt i64 %b_next, %last")
        say("  br i1 %again, label %block, label %end")
        say("end:")

    def _room(self, **sizes: int) -> None:
        """Room for the state before and after a sample, and for what waits between chunks.

        It may be many megabytes, more than the stack of a thread, where only a function apart has it.
        """
        states = len(self._layout.carry)
        inside = {"before": states, "after": states, "slots": self._plan.slots}
        places = dict.fromkeys(("old", "new", "final"), states)
        if self._sums:
            inside["sums"] = len(self._sums)
        for rounds in self._plan.loops:
            carry, rows = len(rounds.loop.carry), (rounds.loop.length or 0) * len(rounds.loop.rows)
            outputs, label = (rounds.loop.length or 0) * rounds.outputs, rounds.label
            inside |= {f"{label}_start": carry, f"{label}_next": carry}
            inside |= {f"{label}_rows": rows, f"{label}_outputs": outputs}
            places |= dict.fromkeys((f"{label}_old", f"{label}_new", f"{label}_end_at"), carry)
            if rounds.loop.over:
                self._out.say(f"  %{label}_going = alloca i1")
                self._out.say(f"  store i1 0, ptr %{label}_going")
        for name, size in {**sizes, **inside}.items():
            vectors = max(1, size * self._group)
            if self._apart:
                self._out.say(f"  %{name} = alloca [{vectors} x {self._out.vector}], align 64")
            else:
                self._out.say(f"  %{name} = getelementptr inbounds {self._out.vector}, ptr %room, i64 {self.room}")
                self.room += vectors
        self._lengths |= {f"%{name}": size for name, size in {**sizes, **inside, **places}.items()}

    def _samples(self) -> None:
        """Carry the people of a block through all samples."""
        say = self._out.say
        if self._apart:
            self._room()
        self._loop("begin", self._begin)
        say("  %idle = icmp sge i64 0, %samples")
        say("  br i1 %idle, label %finish, label %sample")
        say("sample:")
        say("  %k = phi i64 [ 0, %begin_end ], [ %k_next, %sample_end ]")
        say("  %old = phi ptr [ %before, %begin_end ], [ %new, %sample_end ]")
        say("  %new = phi ptr [ %after, %begin_end ], [ %old, %sample_end ]")
        for name in ("own", "shared", "outputs"):
            say(f"  %{name}_row = mul i64 %k, {len(getattr(self._layout, name))}")
            if self._apart and name != "shared":
                say(f"  %{name}_now = getelementptr inbounds {self._out.vector}, ptr %{name}, i64 %{name}_row")
        if not self._apart:
            say(f"  %own_rows = mul i64 %samples, {len(self._layout.own)}")
        for number, chunk in enumerate(self._plan.chunks):
            for rounds in reversed(self._plan.loops):
                if rounds.first == number:
                    self._begin_rounds(rounds)
            self._loop(f"chunk{number}", functools.partial(self._chunk, chunk))
            for rounds in self._plan.loops:
                if rounds.last == number:
                    self._end_rounds(rounds)
        self._out.enter("sample_end")
        say("  %k_next = add i64 %k, 1")
        say("  %more = icmp slt i64 %k_next, %samples")
        say("  br i1 %more, label %sample, label %finish")
        say("finish:")
        say("  %final = phi ptr [ %before, %begin_end ], [ %new, %sample_end ]")
        self._loop("hand_back", self._hand_back)

    # loops over the vectors of a block

    def _loop(self, name: str, body: Callable[[], None]) -> None:
        say = self._out.say
        self._names, self._firsts = {}, {}
        if self._group == 1:  # no loop: places in memory are then constants
            self._out.enter(f"{name}_end")
            if not self._apart:
                say(f"  %{name}_column = mul i64 %b, {self._lanes}")
            self._member, self._vector, self._column = None, "%b", f"%{name}_column"
            body()
            return
        with self._out.counted(name, "%members") as self._member:
            self._vector, self._column = f"%{name}_vector", f"%{name}_column"
            say(f"  {self._vector} = add i64 %b, {self._member}")
            say(f"  {self._column} = mul i64 {self._vector}, {self._lanes}")
            body()

    def _compute_per_person(self) -> None:
        """Compute the values of a person that are the same at every sample."""
        for value in self._once:
            if value in self._persons:
                self._names[value] = self._from_number(
                    self._out.load(self._place("person", self._persons[value])), value
                )
            else:
                self._names[value] = self._operation(value)
        for value, i in self._per_person.items():
            self._out.store(self._as_number(value), self._cell("%per_person", i))

    def _begin(self) -> None:
        """Load the initial state."""
        for i in range(len(self._layout.carry)):
            self._out.store(self._out.load(self._place("carry", i)), self._cell("%before", i))

    def _hand_back(self) -> None:
        for i in range(len(self._layout.carry)):
            self._out.store(self._out.load(self._cell("%final", i)), self._place("carry", i))

    def _chunk(self, chunk: Chunk) -> None:
        self._own = "%own_now" if self._apart else self._own_of_vector()
        for value in chunk.values:
            if value in self._rows:
                self._loop_over(self._rows[value])
            elif value not in self._names:
                self._names[value] = self._operation(value)
        for value, cell in chunk.stored:
            self._out.store(self._as_number(value), self._cell(*cell))
        for value, i in chunk.written:
            self._out.store(self._as_number(value), self._place("outputs", i))

    def _begin_rounds(self, rounds: Rounds) -> None:
        """Begin a loop of chunks, which reads what is carried in one place and writes it in another, in turns."""
        say, label = self._out.say, rounds.label
        if rounds.loop.over:
            self._loop(f"{label}_test", functools.partial(self._test_end, rounds, "start"))
        self._out.enter(f"{label}_enter")
        self._branch(rounds, "true")
        say(f"{label}:")
        for name, kind, first, then in (
            ("k", "i64", "0", "more"),
            ("old", "ptr", f"%{label}_start", "new"),
            ("new", "ptr", f"%{label}_next", "old"),
        ):
            say(f"  %{label}_{name} = phi {kind} [ {first}, %{label}_enter ], [ %{label}_{then}, %{label}_again ]")
        say(f"  %{label}_row = mul i64 %{label}_k, {len(rounds.loop.rows)}")
        say(f"  %{label}_at = mul i64 %{label}_k, {rounds.outputs}")

    def _test_end(self, rounds: Rounds, place: str) -> None:
        """Note whether the rounds are not over for one of the people."""
        assert rounds.loop.over
        truth, value = rounds.loop.over
        is_ = self._out.truth(self._out.load(self._cell(f"%{rounds.label}_{place}", truth)))
        self._out.note(is_, not value, f"%{rounds.label}_going")

    def _branch(self, rounds: Rounds, more: str) -> None:
        """Go through a round if there are more and they are not over for everybody; leave the loop otherwise."""
        label = rounds.label
        if rounds.loop.over:
            going = self._out(f"load i1, ptr %{label}_going")
            self._out.say(f"  store i1 0, ptr %{label}_going")
            more = self._out(f"and i1 {more}, {going}")
        self._out.say(f"  br i1 {more}, label %{label}, label %{label}_end")

    def _end_rounds(self, rounds: Rounds) -> None:
        say, label = self._out.say, rounds.label
        if rounds.loop.over:
            self._loop(f"{label}_test_again", functools.partial(self._test_end, rounds, "new"))
        self._out.enter(f"{label}_again")
        say(f"  %{label}_more = add i64 %{label}_k, 1")
        length = rounds.loop.length
        self._branch(rounds, "true" if length is None else self._out(f"icmp slt i64 %{label}_more, {length}"))
        say(f"{label}_end:")
        if rounds.loop.over:
            say(f"  %{label}_end_at = phi ptr [ %{label}_start, %{label}_enter ], [ %{label}_new, %{label}_again ]")
            self._loop(f"{label}_close", functools.partial(self._bring, rounds))

    def _bring(self, rounds: Rounds) -> None:
        """Bring what is carried at the end of a loop to the place in which it was at the beginning."""
        for i in range(len(rounds.loop.carry)):
            result = self._out.load(self._cell(f"%{rounds.label}_end_at", i))
            self._out.store(result, self._cell(f"%{rounds.label}_start", i))

    def _loop_over(self, rows: MatrixRows) -> None:
        """Sum the products of each row and keep the sums."""
        out = self._out
        factors = [self._name(factor) for factor in rows.factors]
        label, count = f"rows{self._sums[rows.sums[0]]}", len(rows.sums)

        def listed(what: str, places: Sequence[int], row: str) -> str:
            """Address of the number of this row whose place is in a list."""
            table = f"@{label}_{what}"
            bytes_of = ", ".join(f"i32 {place * out.alignment}" for place in places)
            self._tables.append(f"{table} = internal constant [{count} x i32] [{bytes_of}]")
            at = out(f"getelementptr inbounds [{count} x i32], ptr {table}, i64 0, i64 {row}")
            distance = out(f"zext i32 {out(f'load i32, ptr {at}')} to i64")
            return out(f"getelementptr inbounds i8, ptr %per_person, i64 {distance}")

        with out.counted(label, count) as row:
            total = out.load(listed("starts", rows.starts, row)) if rows.starts else None
            first = listed("places", rows.places, row)
            for column, factor in zip(rows.columns, factors, strict=True):
                number = out.load(out.vector_at(first, column))
                product = out.apply("mul", (number, factor))
                total = product if total is None else out.apply("add", (total, product))
            out.store(f"{total}", out.vector_at(self._cell("%sums", self._sums[rows.sums[0]]), row))

    # memory

    def _cell(self, array: str, i: int, more: str | None = None) -> str:
        """Address of a vector among those that belong to this function, or to its caller if it is apart.

        Those of one vector of people lie side by side; `more` is the name of a number that is added to the place. The
        address of the first is computed once, which spares the compiler most of its time for addresses.
        """
        if (array, more) not in self._firsts:
            places = [] if self._member is None else [self._out(f"mul i64 {self._member}, {self._lengths[array]}")]
            first = array
            for place in [*places, *([more] if more else [])]:
                first = self._out.vector_at(first, place)
            self._firsts[array, more] = first
        return self._out.vector_at(self._firsts[array, more], i)

    def _own_of_vector(self) -> str:
        """Address of what reaches a vector of people at a sample; that of all samples lies together."""
        row = self._out(f"mul i64 {self._vector}, %own_rows")
        return self._out.vector_at("%own", self._out(f"add i64 {row}, %own_row"))

    def _place(self, array: str, i: int) -> str:
        """Address of a vector in the caller's arrays."""
        if array == "own":
            return self._out.vector_at(self._own, i)
        if self._apart:
            bases = {"person": "%per_person", "outputs": "%outputs_now"}
            return self._out.vector_at(bases.get(array, f"%{array}"), i)
        row = self._out(f"add i64 %{array}_row, {i}") if array == "outputs" else str(i)
        offset = self._out(f"mul i64 {row}, %stride")
        offset = self._out(f"add i64 {offset}, {self._column}")
        return self._out.scalar_at(f"%{array}", offset)

    # values

    def _name(self, value: Value) -> str:
        """Name of a value in the code; it is loaded from memory if necessary."""
        if value in self._p.constants:
            return self._out.constant(self._p.constants[value])
        if value not in self._names:
            self._names[value] = self._from_number(self._stored(value), value)
        return self._names[value]

    def _stored(self, value: Value) -> str:
        if self._apart and value in self._persons:
            return self._out.load(self._place("person", self._persons[value]))
        if value in self._per_person:
            return self._out.load(self._cell("%per_person", self._per_person[value]))
        if value in self._sums:
            return self._out.load(self._cell("%sums", self._sums[value]))
        if value in self._plan.cells:
            return self._out.load(self._cell(*self._plan.cells[value]))
        source, i = self._sources[value]
        if source == "own":
            return self._out.load(self._place("own", i))
        return self._out.load_for_all(self._out.scalar_at("%shared", self._out(f"add i64 %shared_row, {i}")))

    def _from_number(self, name: str, value: Value) -> str:
        kinds = {BOOL: self._out.truth, WORD: self._out.word}
        return kinds.get(self._p.types[value], str)(name)

    def _as_number(self, value: Value) -> str:
        kinds = {BOOL: self._out.number, WORD: self._out.number_of_word}
        return kinds.get(self._p.types[value], str)(self._name(value))

    def _operation(self, value: Value) -> str:
        operation, arguments = self._p.operations[value]
        product = next((a for a in arguments if self._fused_sums.get(a) == value), None)
        if operation in ("add", "sub") and product is not None:
            return self._fused(operation, arguments, product)
        names = [self._name(a) for a in arguments]
        if operation in ("max", "min"):
            return self._out.extreme(operation, names, [a in self._p.constants for a in arguments])
        if operation == "number" and self._p.types[arguments[0]] == WORD:
            return self._out.number_of_word(names[0])
        compared = arguments[-1] if operation == "select" else arguments[0]
        return self._out.apply(operation, names, truths=self._p.types[compared] == BOOL)

    def _fused(self, operation: str, arguments: Sequence[Value], product: Value) -> str:
        a, b = (self._name(argument) for argument in self._p.operations[product][1])
        first = arguments[0] == product
        other = self._name(arguments[1] if first else arguments[0])
        negated = None if operation == "add" else "other" if first else "product"
        return self._out.fused(a, b, other, negated=negated)


def _fused_products(program: Program, order: Sequence[Value], results: Sequence[Value]) -> dict[Value, Value]:
    """Products that are rounded together with the sum which takes them, with that sum.

    These are the products that one sum alone uses, at most one for each sum; of two, the second. In `order` each value
    comes after its arguments, and `results` are needed as they are.
    """
    uses: dict[Value, int] = {}
    for value in order:
        for argument in program.operations[value][1]:
            uses[argument] = uses.get(argument, 0) + 1
    for value in results:
        uses[value] = uses.get(value, 0) + 1
    fused: dict[Value, Value] = {}
    for value in order:
        operation, arguments = program.operations[value]
        if operation not in ("add", "sub"):
            continue
        for argument in reversed(arguments):
            together = (
                program.levels[argument] == program.levels[value] and program.homes[argument] == program.homes[value]
            )
            if program.operations[argument][0] == "mul" and uses[argument] == 1 and together:
                fused[argument] = value
                break
    return fused
