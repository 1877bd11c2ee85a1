"""The unrolled form: one C statement for each operation of a lowered program, without a branch.

A loop that the program has remains one.

The elementary functions are C functions of this form, from the same programs that the other targets compile.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from glucoloop.native.functions import Functions
from glucoloop.native.lower import Lowered
from glucoloop.native.program import BOOL, Block, Value
from glucoloop.native.targets.c.compact.arithmetic import FUNCTIONS, function
from glucoloop.native.targets.c.numbers import CALLS, FORMATS, INFIX, REAL, TRUTH, Format, type_of

_Element = tuple[str, str]
"""An element of a structure: C text and kind."""


def unrolled(lowered: Lowered, arguments: Sequence[_Element], results: Sequence[_Element]) -> list[str]:
    """Statements of a lowered function without a person and without random draws.

    `arguments` are the places of the numbers of carry, own and shared; `results` those of next state and outputs.
    """
    layout = lowered.layout
    inputs = [*layout.carry, *layout.own, *layout.shared]
    sources = dict(zip(inputs, arguments, strict=True))
    return _Writer(lowered, sources).lines(results)


def elementary(text: Iterable[str], format: Format) -> list[str]:
    """Definitions of the elementary functions that lines of C call."""
    joined = "\n".join(text)
    lines: list[str] = []
    for name in FUNCTIONS:
        if re.search(rf"\bgl_{name}\(", joined):
            program = function(name, format.precision)
            layout = program.layout
            arguments = ("x", "y")[: len(layout.own)]
            parameters = ", ".join(f"{format.type} {argument}" for argument in arguments)
            writer = _Writer(program, {v: (text, REAL) for v, text in zip(layout.own, arguments, strict=True)})
            lines += [
                f"/* {getattr(Functions, name).__doc__} */",
                f"static {format.type} gl_{name}({parameters})",
                "{",
                *writer.computed(),
            ]
            lines += [f"return {writer.name(layout.outputs[0])};", "}", ""]
    return lines


class _Writer:
    def __init__(self, lowered: Lowered, sources: dict[Value, _Element]) -> None:
        self._p, self._results = lowered.program, lowered.layout.results
        self._format: Format = FORMATS[lowered.precision]
        self._sources = sources
        self._names: dict[Value, str] = {}
        self._order = self._p.needed(self._results)
        self._uses: dict[Value, int] = {}
        for value in self._order:
            operation, arguments = self._p.operations[value]
            # The condition between two truths is written twice, see `_operation`.
            twice = arguments[:1] if operation == "select" and self._is_truth(value) else ()
            for argument in (*arguments, *twice):
                self._uses[argument] = self._uses.get(argument, 0) + 1
        for value in self._results:
            self._uses[value] = self._uses.get(value, 0) + 2

    def lines(self, results: Sequence[_Element]) -> list[str]:
        lines = self.computed()
        for value, (place, kind) in zip(self._results, results, strict=True):
            text, truth = self.name(value), self._is_truth(value)
            zero, one = (self._format.literal(n) if kind == REAL else f"{n:.0f}" for n in (0.0, 1.0))
            if truth or kind == TRUTH:
                text = f"{text if truth else f'({text} != {self._format.literal(0.0)})'} ? {one} : {zero}"
            elif kind != REAL:
                text = f"(int32_t)({text})"
            lines.append(f"{place} = {text};")
        return lines

    def computed(self) -> list[str]:
        """A local variable for each operation; a truth that is used once stands where it is used."""
        return self._statements(self._p.bodies(self._order))

    def _statements(self, body: Block) -> list[str]:
        lines: list[str] = []
        for value in body.steps:
            if isinstance(value, Block):
                lines += self._loop(value)
            elif value not in self._p.constants and value not in self._names:
                text = self._input(value) if value in self._sources else self._operation(value)
                if self._is_truth(value) and self._uses[value] == 1 and value not in self._sources:
                    self._names[value] = f"({text})"
                else:
                    lines.append(self._local("const ", value, f"v{value}", text))
                    self._names[value] = f"v{value}"
        return lines

    def _local(self, constant: str, value: Value, name: str, text: str) -> str:
        kind = TRUTH if self._is_truth(value) else REAL
        return f"{constant}{type_of(kind, self._format)} {name} = {text};"

    def _loop(self, body: Block) -> list[str]:
        """A loop, with variables for what it carries on, and arrays for its rows and what its rounds give."""
        assert body.value is not None
        loop, real = self._p.loops[body.value], self._format.type
        label, length = f"l{body.value}", loop.length or 0
        start, following, rows, outputs = loop.groups(self._p.operations[body.value][1])
        lines = [self._local("", v, f"c{v}", self.name(of)) for v, of in zip(loop.carry, start, strict=True)]
        if rows:
            numbers = ", ".join(map(self._as_number, rows))
            lines.append(f"const {real} {label}_rows[{len(rows)}] = {{ {numbers} }};")
        if outputs:
            lines.append(f"{real} {label}_outputs[{length * len(outputs)}];")
        conditions = [f"{label} < {length}"] if length else []
        if loop.over:
            conditions.append(f"{'!' if loop.over[1] else ''}c{loop.carry[loop.over[0]]}")
        lasts = " && ".join(f"({condition})" for condition in conditions) if len(conditions) > 1 else conditions[0]
        lines += [f"for (int32_t {label} = 0; {lasts}; {label}++)" if length else f"while ({lasts})", "{"]
        self._names.update({v: f"c{v}" for v in loop.carry})
        for i, row in enumerate(loop.rows):
            text = self._of_number(row, f"{label}_rows[({len(loop.rows)} * {label}) + {i}]")
            lines.append(self._local("const ", row, f"v{row}", text))
            self._names[row] = f"v{row}"
        lines += self._statements(body)
        lines += [
            f"{label}_outputs[({len(outputs)} * {label}) + {i}] = {self._as_number(v)};" for i, v in enumerate(outputs)
        ]
        pairs = [(v, to) for v, to in zip(following, loop.carry, strict=True) if v != to]
        lines += [self._local("const ", v, f"n{to}", self.name(v)) for v, to in pairs]
        lines += [f"c{to} = n{to};" for _, to in pairs]
        return [*lines, "}"]

    def _part(self, value: Value, of: Value, number: Value) -> str:
        loop, place = self._p.loops[of], int(self._p.constants[number])
        carry = len(loop.carry)
        return f"c{loop.carry[place]}" if place < carry else self._of_number(value, f"l{of}_outputs[{place - carry}]")

    def _as_number(self, value: Value) -> str:
        one, zero = map(self._format.literal, (1.0, 0.0))
        return f"{self.name(value)} ? {one} : {zero}" if self._is_truth(value) else self.name(value)

    def _of_number(self, value: Value, text: str) -> str:
        return f"{text} != {self._format.literal(0.0)}" if self._is_truth(value) else text

    def name(self, value: Value) -> str:
        """A value as C text."""
        if value in self._p.constants:
            return self._format.constant(self._p.constants[value], TRUTH if self._is_truth(value) else REAL)
        return self._names[value]

    def _is_truth(self, value: Value) -> bool:
        return self._p.types[value] == BOOL

    def _input(self, value: Value) -> str:
        place, kind = self._sources[value]
        if kind == TRUTH:
            return f"{place} != 0"
        return place if kind == REAL else f"({self._format.type}){place}"

    def _operation(self, value: Value) -> str:
        operation, arguments = self._p.operations[value]
        if operation == "part":
            return self._part(value, *arguments)
        names = [self.name(a) for a in arguments]
        if operation in INFIX:
            return f"{names[0]} {INFIX[operation]} {names[1]}"
        match operation:
            case "neg":
                return f"-{names[0]}"
            case "not":
                return f"!{names[0]}"
            case "select" if self._is_truth(value):
                # MISRA C:2012, rule 10.4: cppcheck takes truths on the two sides of a colon for different types.
                return f"({names[0]} && {names[1]}) || ((!{names[0]}) && {names[2]})"
            case "select":
                return f"{names[0]} ? {names[1]} : {names[2]}"
            case "number":
                return f"{names[0]} ? {self._format.literal(1.0)} : {self._format.literal(0.0)}"
            case "max" | "min":
                return self._extreme(operation, arguments, names)
            case _ if operation in CALLS:
                return f"{CALLS[operation]}({', '.join(names)})"
            case _:
                raise ValueError(f"the operation {operation!r} has no text in C")

    def _extreme(self, operation: str, arguments: Sequence[Value], names: Sequence[str]) -> str:
        """The larger or smaller of two; which of two equal ones is taken is as in the other targets."""
        a, b = names
        if arguments[1] in self._p.constants:
            a, b = b, a
        if any(argument in self._p.constants for argument in arguments):
            return f"({a} {'>' if operation == 'max' else '<'} {b}) ? {a} : {b}"
        return f"gl_{operation}({a}, {b})"
