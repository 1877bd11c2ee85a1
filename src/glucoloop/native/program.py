"""Straight-line programs on scalars, the result of taking the small arrays of a traced function apart.

Every value is a number, by its place in the program. Equal operations are one value, operations on constants are
carried out, and what is the same at every sample is computed once. Two liberties are taken with arithmetic: a product
with zero and a quotient of zero are zero, whatever the other number, so that the zeros of a matrix cost nothing; and
constant factors are gathered, which may change the last digit (but not through `exact_sub`). A program *as written*
takes only the first, so that its bits depend neither on which of its inputs are constants nor on what else is computed
beside.

A target carries these operations out, each rounded to nearest in the program's precision:

====================================== ==========================================================================
operation                              value
====================================== ==========================================================================
``input``, ``constant``                a number or a truth from outside, or known
``add sub mul div neg abs sqrt floor`` as IEEE 754 has them; ``exact_sub`` is ``sub``
``max min``                            the larger or smaller; not a number if either is not
``copy_sign``                          the first with the sign of the second
``lt le eq ne``                        truths; ``eq`` and ``ne`` take two truths as well; only ``ne`` holds of NaN
``and or xor not is_finite``           truths
``select``                             the second if the first holds, otherwise the third
``number``                             one for true, zero for false
``mantissa exponent``                  ``x = mantissa 2^exponent`` with a mantissa in [1, 2), for normal x above 0
``power_of_two``                       two to the whole number which stands in the last bits of a number
``ratio``                              a quotient; `lower` replaces all of them before a target sees them
``loop``                               rounds of what is at home in it, see `LoopForm`; ``part`` is one of its results
====================================== ==========================================================================

Programs of `words` have words of 32 bits too, which of the targets LLVM carries out:

====================================== ==========================================================================
``word``                               a whole number as a word; ``number`` is its inverse
``word_add word_and word_or word_xor`` words, modulo 2^32
``shift_left shift_right``             a word shifted by a known number of bits, below 32
``number_of_bits``                     the number in double precision that has the bits of two words
``pair``                               two words as one value, which nothing carries out
====================================== ==========================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

FLOAT: Final = "float"
BOOL: Final = "bool"
WORD: Final = "word"
PAIR: Final = "pair"

CONSTANT: Final = 0
PERSON: Final = 1
SAMPLE: Final = 2
"""Level of a value that changes at every sample; the lower levels are constants and values of a person."""

Value = int
"""Place of a value in the program."""
Home = tuple[int, ...]
"""Number of the innermost loop in which a value changes, after those of the loops around it."""

_SYMMETRIC: Final = frozenset(("add", "mul", "and", "or", "eq", "ne", "word_add", "word_xor"))
"""Operations of which the order of the arguments does not matter."""
DOES: Final[dict[str, Callable[..., Any]]] = {
    "add": np.add, "sub": np.subtract, "exact_sub": np.subtract, "mul": np.multiply, "div": np.divide,
    "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt, "floor": np.floor, "copy_sign": np.copysign, "lt": np.less,
    "le": np.less_equal, "eq": np.equal, "ne": np.not_equal, "is_finite": np.isfinite, "and": np.logical_and,
    "or": np.logical_or, "xor": np.logical_xor, "not": np.logical_not, "select": np.where,
}  # fmt: skip
"""The operations of a program that NumPy has as they are."""
OF_WORDS: Final[dict[str, Callable[..., Any]]] = {
    "word_add": np.add, "word_and": np.bitwise_and, "word_or": np.bitwise_or, "word_xor": np.bitwise_xor,
    "shift_left": np.left_shift, "shift_right": np.right_shift,
}  # fmt: skip
"""The same of words."""
_KINDS: Final = {
    **dict.fromkeys(("lt", "le", "eq", "ne", "and", "or", "xor", "not", "is_finite"), BOOL),
    **dict.fromkeys((*OF_WORDS, "word"), WORD),
    "pair": PAIR,
}
"""Types of what operations give, unless it is a number."""
_OF_CONSTANTS: Final[dict[str, Callable[..., Any]]] = {
    **DOES,
    **OF_WORDS,
    "ratio": np.divide,
    "max": np.maximum,
    "min": np.minimum,
    "number": np.float64,
}


@dataclass(frozen=True)
class LoopForm:
    """Rounds of the same operations, which are those that depend on its inputs.

    The arguments of its operation are what is carried into the first round and what each round carries on, one for
    each of `carry`; what is in the place of `rows` in the first round, in the second, and so on; and what each round
    gives. Its parts are what the last round carries on, then what the first round gave, the second, and so on.
    """

    home: Home
    length: int | None
    """Largest number of rounds; None if only `over` ends them."""
    over: tuple[int, bool] | None
    """Place of a truth among what is carried, and its value for whom the operations leave all that is carried as it is.

    Before the first round and after each the rounds end if it has that value for everybody. None: all are carried out.
    """
    carry: tuple[Value, ...]
    rows: tuple[Value, ...]
    """Inputs of a round."""

    def groups(self, arguments: Sequence[Value]) -> tuple[Sequence[Value], ...]:
        """Arguments for the first round, those carried on, those of the rows of all rounds, and what rounds give."""
        n, rows = len(self.carry), (self.length or 0) * len(self.rows)
        return arguments[:n], arguments[n : 2 * n], arguments[2 * n : 2 * n + rows], arguments[2 * n + rows :]


@dataclass(frozen=True)
class Block:
    """Operations in order, of which loops are bodies of their own."""

    value: Value | None
    """Operation of the loop, None for the whole program."""
    steps: list[Value | Block]


class Program:
    """Operations in the order in which they were requested.

    Of a program `as_written` every operation is rounded as it is requested: no factors are gathered, no divisions
    shared.
    """

    def __init__(self, *, as_written: bool = False) -> None:
        self.as_written = as_written
        self.operations: list[tuple[str, tuple[Value, ...]]] = []
        self.constants: dict[Value, float | bool] = {}
        self.names: dict[Value, object] = {}
        """Names of the inputs."""
        self.types: list[str] = []
        self.levels: list[int] = []
        self.homes: list[Home] = []
        self.loops: dict[Value, LoopForm] = {}
        """Loops by their operations."""
        self._by_key: dict[object, Value] = {}

    def input(self, name: object, level: int, kind: str = FLOAT, home: Home = ()) -> Value:
        """An input value, of the program or of a round of a loop."""
        place = self._new(("input", name), "input", (), kind, level)
        self.homes[place] = home
        self.names[place] = name
        return place

    def constant(self, value: float | bool) -> Value:
        """A constant value."""
        kind = BOOL if isinstance(value, bool | np.bool_) else FLOAT
        plain: float | bool = bool(value) if kind == BOOL else float(value)
        # by its bits: -0.0 is not 0.0, and NaN is itself
        key = ("constant", kind, np.float64(plain).tobytes())
        place = self._new(key, "constant", (), kind, CONSTANT)
        self.constants[place] = plain
        return place

    def word(self, value: int) -> Value:
        """A constant word; of a larger number or one below zero it has the last 32 bits."""
        plain = value & 0xFFFFFFFF
        place = self._new(("constant", WORD, plain), "constant", (), WORD, CONSTANT)
        self.constants[place] = plain
        return place

    def apply(self, operation: str, *arguments: Value) -> Value:
        """The value of an operation."""
        if operation in _OF_CONSTANTS and all(a in self.constants for a in arguments):
            numbers = [np.uint32(self.constants[a]) if self.types[a] == WORD else self.constants[a] for a in arguments]
            with np.errstate(all="ignore"):
                result: float | bool = _OF_CONSTANTS[operation](*numbers).item()
            return self.word(int(result)) if operation in OF_WORDS else self.constant(result)
        simpler = self._simplified(operation, arguments)
        if simpler is not None:
            return simpler
        if operation in _SYMMETRIC:
            arguments = tuple(sorted(arguments))
        kind = self.types[arguments[1]] if operation == "select" else _KINDS.get(operation, FLOAT)
        level = max([self.levels[argument] for argument in arguments])
        return self._new((operation, arguments), operation, arguments, kind, level)

    def loop(self, loop: LoopForm, arguments: Sequence[Value]) -> Value:
        """The operation of a loop."""
        place = self._new(("loop", loop.home), "loop", tuple(arguments), FLOAT, SAMPLE)
        self.homes[place] = loop.home[:-1]
        self.loops[place] = loop
        return place

    def part(self, value: Value, number: int) -> Value:
        """A result of a loop."""
        loop, arguments = self.loops[value], self.operations[value][1]
        _, following, _, outputs = loop.groups(arguments)
        of = following[number] if number < len(following) else outputs[(number - len(following)) % len(outputs)]
        arguments = value, self.constant(float(number))
        return self._new(("part", arguments), "part", arguments, self.types[of], SAMPLE)

    def _new(self, key: object, operation: str, arguments: tuple[Value, ...], kind: str, level: int) -> Value:
        place = self._by_key.setdefault(key, len(self.operations))
        if place == len(self.operations):
            self.operations.append((operation, arguments))
            self.types.append(kind)
            self.levels.append(level)
            self.homes.append(max([self.homes[a] for a in arguments], key=len, default=()))
        return place

    def _simplified(self, operation: str, arguments: tuple[Value, ...]) -> Value | None:
        a, b = (*arguments, -1, -1)[:2]
        of_a, of_b = self.constants.get(a), self.constants.get(b)
        match operation:
            case "add" if of_a == 0.0:
                return b
            case "add" | "sub" if of_b == 0.0:
                return a
            case "sub" if of_a == 0.0:
                return self.apply("neg", b)
            case "max" | "min" if of_a != of_a or of_b != of_b:  # not a number
                return self.constant(math.nan)
            case "mul" | "div" if of_a == 0.0 or (of_b == 0.0 and operation == "mul"):
                return self.constant(0.0)
            case "mul" if of_a == 1.0:
                return b
            case "mul" | "div" if of_b == 1.0:
                return a
            case "mul" if of_a == -1.0:
                return self.apply("neg", b)
            case "mul" if of_b == -1.0:
                return self.apply("neg", a)
            case "div" if of_b is not None and of_b != 0.0 and not (self.as_written and self.levels[a] != SAMPLE):
                return self.apply("mul", a, self.constant(1.0 / of_b))
            case "mul" if self.levels[a] != self.levels[b] and not self.as_written:
                return self._scaled(*((a, b) if self.levels[a] > self.levels[b] else (b, a)))
            case "div" if self.levels[a] == SAMPLE and self.levels[b] == PERSON:
                # divided once, not at every sample
                return self.apply("mul", a, self.apply("div", self.constant(1.0), b))
            case "and" | "or" if of_a is not None or of_b is not None:
                constant, other = (of_a, b) if of_a is not None else (of_b, a)
                return other if constant == (operation == "and") else self.constant(operation == "or")
            case "select" if of_a is not None:
                return arguments[1] if of_a else arguments[2]
            case "select" if arguments[1] == arguments[2]:
                return arguments[1]
            case "number" if self.types[a] == FLOAT:
                return a
        return None

    def _scaled(self, value: Value, factor: Value) -> Value | None:
        """Product of a value and a factor of a lower level: such factors are gathered, and moved into a sum."""
        operation, arguments = self.operations[value]
        if operation not in ("mul", "add", "sub"):
            return None
        a, b = arguments
        if operation == "mul":
            fixed, other = (a, b) if self.levels[a] < self.levels[b] else (b, a)
            if self.levels[fixed] < self.levels[value]:
                return self.apply("mul", other, self.apply("mul", fixed, factor))
            return None
        if self.levels[a] < self.levels[value] or self.levels[b] < self.levels[value]:
            return self.apply(operation, self.apply("mul", a, factor), self.apply("mul", b, factor))
        return None

    def needed(self, results: Iterable[Value]) -> list[Value]:
        """Values on which the results depend, each after its arguments."""
        done: set[Value] = set()
        order: list[Value] = []
        for result in results:
            stack = [(result, False)]
            while stack:
                value, ready = stack.pop()
                if ready:
                    order.append(value)
                elif value not in done:
                    done.add(value)
                    stack.append((value, True))
                    stack.extend((argument, False) for argument in reversed(self.operations[value][1]))
        return order

    def bodies(self, order: Iterable[Value]) -> Block:
        """Values, each after its arguments, with those that change in a loop in its body, where its operation is."""
        whole = Block(None, [])
        inside: dict[Home, Block] = {(): whole}
        for value in order:
            home = inside.setdefault(self.homes[value], Block(None, []))
            if value in self.loops:
                result = inside.get(self.loops[value].home, Block(None, []))
                home.steps.append(Block(value, result.steps))
            else:
                home.steps.append(value)
        return whole
