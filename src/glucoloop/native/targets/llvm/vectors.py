"""Operations on vectors of people as LLVM code, one person in each lane."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

_LIBRARY: Final = {"sqrt": "sqrt", "floor": "floor", "abs": "fabs"}
_ORDERED: Final = {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}
_BITS: Final = ("and", "or", "xor")
_OF_WORDS: Final = {
    "word_add": "add", "word_and": "and", "word_or": "or", "word_xor": "xor",
    "shift_left": "shl", "shift_right": "lshr",
}  # fmt: skip


class VectorCode:
    """Lines of code with fresh names, and the operations that they are made of, for vectors of `lanes` people.

    The address of a vector in memory is a multiple of `alignment` bytes.
    """

    def __init__(self, lanes: int, *, double: bool, alignment: int) -> None:
        self.lines: list[str] = []
        self._count = 0
        self._lanes, self._double, self.alignment = lanes, double, alignment
        self.scalar = "double" if double else "float"
        self._whole = "i64" if double else "i32"
        self.vector = f"<{lanes} x {self.scalar}>"
        self._wholes = f"<{lanes} x {self._whole}>"
        self._mask = f"<{lanes} x i1>"
        self._words = f"<{lanes} x i32>"
        self._suffix = f"v{lanes}f{64 if double else 32}"

    def __call__(self, code: str) -> str:
        """Name of what an instruction gives."""
        name = f"%v{self._count}"
        self._count += 1
        self.lines.append(f"  {name} = {code}")
        return name

    def say(self, line: str) -> None:
        """Write a line that gives nothing."""
        self.lines.append(line)

    def enter(self, label: str) -> None:
        """Go on at a label."""
        self.lines += [f"  br label %{label}", f"{label}:"]

    @contextlib.contextmanager
    def counted(self, label: str, count: int | str) -> Iterator[str]:
        """Write what is done for each number, whose name this is, from 0 to below a count above 0."""
        self.enter(f"{label}_enter")
        self.enter(label)
        self.say(f"  %{label}_i = phi i64 [ 0, %{label}_enter ], [ %{label}_next, %{label} ]")
        yield f"%{label}_i"
        self.say(f"  %{label}_next = add i64 %{label}_i, 1")
        self.say(f"  %{label}_more = icmp slt i64 %{label}_next, {count}")
        self.say(f"  br i1 %{label}_more, label %{label}, label %{label}_end")
        self.say(f"{label}_end:")

    def declarations(self) -> list[str]:
        """Lines of the module that the functions need."""
        v, s = self.vector, self._suffix
        width = self._lanes * (64 if self._double else 32)
        return [
            f'attributes #0 = {{ nounwind "min-legal-vector-width"="{width}" "prefer-vector-width"="{width}" }}',
            *(f"declare {v} @llvm.{name}.{s}({v})" for name in _LIBRARY.values()),
            f"declare {v} @llvm.fma.{s}({v}, {v}, {v})",
            f"declare {v} @llvm.copysign.{s}({v}, {v})",
        ]

    # memory

    def load(self, at: str) -> str:
        """The vector at an address."""
        return self(f"load {self.vector}, ptr {at}, align {self.alignment}")

    def store(self, name: str, at: str) -> None:
        """Write a vector to an address."""
        self.say(f"  store {self.vector} {name}, ptr {at}, align {self.alignment}")

    def note(self, truth: str, value: bool, at: str) -> None:
        """Write to an address that a truth has a value in one of the lanes, if so; what was there stays otherwise."""
        bits = self(f"bitcast {self._mask} {truth} to i{self._lanes}")
        any_ = self(f"icmp ne i{self._lanes} {bits}, {0 if value else -1}")
        before = self(f"load i1, ptr {at}")
        self.say(f"  store i1 {self(f'or i1 {before}, {any_}')}, ptr {at}")

    def vector_at(self, array: str, place: int | str) -> str:
        """Address of a vector in an array."""
        return self(f"getelementptr inbounds {self.vector}, ptr {array}, i64 {place}")

    def scalar_at(self, array: str, place: str) -> str:
        """Address of a number in an array."""
        return self(f"getelementptr inbounds {self.scalar}, ptr {array}, i64 {place}")

    def load_for_all(self, at: str) -> str:
        """The number at an address in every lane."""
        number = self(f"load {self.scalar}, ptr {at}")
        first = self(f"insertelement {self.vector} poison, {self.scalar} {number}, i32 0")
        zeros = f"<{self._lanes} x i32> zeroinitializer"
        return self(f"shufflevector {self.vector} {first}, {self.vector} poison, {zeros}")

    # values

    def constant(self, number: float | bool) -> str:
        """A constant in every lane; a whole number is a word."""
        if isinstance(number, int):
            return self._everywhere(f"i1 {int(number)}" if isinstance(number, bool) else f"i32 {number}")
        if not self._double:  # rounded, and written as the double that it then is
            with np.errstate(over="ignore"):
                number = float(np.float32(number))
        return self._everywhere(f"{self.scalar} 0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}")

    def _everywhere(self, scalar: str) -> str:
        return f"splat ({scalar})"

    def truth(self, number: str) -> str:
        """Whether a number is not zero."""
        return self(f"fcmp une {self.vector} {number}, zeroinitializer")

    def number(self, truth: str) -> str:
        """1 for what is true, and 0."""
        return self(f"uitofp {self._mask} {truth} to {self.vector}")

    def word(self, number: str) -> str:
        """A number that is a word, as such."""
        return self(f"fptoui {self.vector} {number} to {self._words}")

    def number_of_word(self, word: str) -> str:
        """A word as a number."""
        return self(f"uitofp {self._words} {word} to {self.vector}")

    def apply(self, operation: str, names: Sequence[str], *, truths: bool = False) -> str:
        """Result of an operation of a scalar program; `truths` says that it compares or chooses truth values."""
        v, s, mask = self.vector, self._suffix, self._mask
        match operation:
            case "add" | "sub" | "mul" | "div":
                return self(f"f{operation} {v} {names[0]}, {names[1]}")
            case "exact_sub":
                return self(f"fsub {v} {names[0]}, {names[1]}")
            case "neg":
                return self(f"fneg {v} {names[0]}")
            case "lt" | "le" | "eq" | "ne" if truths:
                return self(f"icmp {operation} {mask} {names[0]}, {names[1]}")
            case "lt" | "le" | "eq" | "ne":
                return self(f"fcmp {_ORDERED[operation]} {v} {names[0]}, {names[1]}")
            case _ if operation in _BITS:
                return self(f"{operation} {mask} {names[0]}, {names[1]}")
            case "not":
                return self(f"xor {mask} {names[0]}, {self.constant(True)}")
            case "select":
                kind = mask if truths else v
                return self(f"select {mask} {names[0]}, {kind} {names[1]}, {kind} {names[2]}")
            case "number":
                return self.number(names[0])
            case "is_finite":
                size = self(f"call {v} @llvm.fabs.{s}({v} {names[0]})")
                return self(f"fcmp olt {v} {size}, {self.constant(float('inf'))}")
            case "copy_sign":
                return self(f"call {v} @llvm.copysign.{s}({v} {names[0]}, {v} {names[1]})")
            case "power_of_two" | "mantissa" | "exponent":
                return self._of_bits(operation, names[0])
            case _ if operation in _OF_WORDS:
                return self(f"{_OF_WORDS[operation]} {self._words} {names[0]}, {names[1]}")
            case "word":
                whole = self(f"fptosi {v} {names[0]} to {self._wholes}")
                return self(f"trunc {self._wholes} {whole} to {self._words}")
            case "number_of_bits":
                high, low = (self(f"zext {self._words} {name} to {self._wholes}") for name in names)
                high = self(f"shl {self._wholes} {high}, {self._everywhere('i64 32')}")
                return self(f"bitcast {self._wholes} {self(f'or {self._wholes} {high}, {low}')} to {v}")
            case _:
                return self(f"call {v} @llvm.{_LIBRARY[operation]}.{s}({v} {names[0]})")

    def fused(self, a: str, b: str, other: str, *, negated: str | None = None) -> str:
        """The product of two and a third added, rounded once; the product or the third may be negated."""
        v = self.vector
        if negated == "other":
            other = self(f"fneg {v} {other}")
        elif negated == "product":
            a = self(f"fneg {v} {a}")
        return self(f"call {v} @llvm.fma.{self._suffix}({v} {a}, {v} {b}, {v} {other})")

    def extreme(self, operation: str, names: Sequence[str], are_constant: Sequence[bool]) -> str:
        """The larger or smaller of two, of which some are known constants; not a number if either is not."""
        v, order = self.vector, "ogt" if operation == "max" else "olt"
        a, b = reversed(names) if are_constant[1] else names
        # takes b where the two cannot be compared
        better = self(f"fcmp {order} {v} {a}, {b}")
        result = self(f"select {self._mask} {better}, {v} {a}, {v} {b}")
        if any(are_constant):
            return result
        strange = self(f"fcmp uno {v} {a}, {a}")
        return self(f"select {self._mask} {strange}, {v} {a}, {v} {result}")

    def _of_bits(self, operation: str, x: str) -> str:
        v, w = self.vector, self._wholes
        bias, shift = (1023, 52) if self._double else (127, 23)

        def whole(number: int) -> str:
            return self._everywhere(f"{self._whole} {number}")

        bits = self(f"bitcast {v} {x} to {w}")
        if operation == "power_of_two":  # of the whole number in the last bits
            n = self(f"add {w} {self(f'shl {w} {bits}, {whole(shift)}')}, {whole(bias << shift)}")
            return self(f"bitcast {w} {n} to {v}")
        if operation == "exponent":
            e = self(f"lshr {w} {bits}, {whole(shift)}")
            e = self(f"sub {w} {self(f'and {w} {e}, {whole(2 * bias + 1)}')}, {whole(bias)}")
            return self(f"sitofp {w} {e} to {v}")
        mantissa = self(f"and {w} {bits}, {whole((1 << shift) - 1)}")
        return self(f"bitcast {w} {self(f'or {w} {mantissa}, {whole(bias << shift)}')} to {v}")
