"""Arrays during the writing of C: numbers, views of memory, expressions of elements, and values yet to be written."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.native.targets.c.compact.memory import mark
from glucoloop.native.targets.c.numbers import TRUTH

Places = npt.NDArray[np.int64]
LARGEST_EXPRESSION: Final = 24
"""Largest number of operations in one expression of an array's elements."""


@dataclass(frozen=True)
class Scalar:
    """One number as C text."""

    text: str
    kind: str
    is_name: bool = False
    """Whether it is a constant or a local variable, which costs nothing to repeat."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one number."""
        return ()

    def value(self, indices: Sequence[str] = ()) -> str:
        """The text of the number, whatever the indices."""
        del indices
        return self.text

    def mapped(self, change: Callable[[View], View | None], shape: tuple[int, ...]) -> Scalar:
        """The number itself, which is that of each element."""
        del change, shape
        return self

    def views(self) -> list[View]:
        """Arrays that the number is read from, of which there are none."""
        return []


@dataclass(frozen=True)
class View:
    """Elements of an array in memory, at regular distances."""

    array: str
    """C text of the array."""
    kind: str
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    base: int = 0
    terms: tuple[str, ...] = ()
    """Further parts of the index: numbers of rounds of loops around it."""
    number: int | None = None
    """Number of the array in the workspace, or None for a table or a structure of the caller."""
    is_plain: bool = False
    """Whether it is one variable rather than an array."""
    is_field: bool = False
    """Whether it belongs to a structure of the caller."""

    def element(self, indices: Sequence[str] = ()) -> str:
        """The lvalue of an element, without indices of the first one."""
        if self.is_plain:
            return self.array
        parts = [*self.terms]
        for index, stride in zip(indices, self.strides, strict=bool(indices)):
            if stride and index != "0":
                parts.append(index if stride == 1 else f"{stride} * {index}")
        if self.number is not None:
            parts.append(mark(self.number, self.base))
        elif self.base or not parts:
            parts.append(str(self.base))
        # MISRA C:2012, rule 2.2: a factor of 1 does nothing.
        index = " + ".join(parts).replace("+ -1 * ", "- ").replace("+ -", "- ")
        return f"{self.array}[{index}]"

    def value(self, indices: Sequence[str] = ()) -> str:
        """The text by which an element is read."""
        text = self.element(indices)
        return f"({text} != 0)" if self.kind == TRUTH and self.is_field else text

    def views(self) -> list[View]:
        """The array itself."""
        return [self]

    def mapped(self, change: Callable[[View], View | None], shape: tuple[int, ...]) -> View | None:
        """The changed view, which has the shape."""
        del shape
        return change(self)

    def moved(self, places: Places) -> View | None:
        """The elements at places, counted row by row; None unless they are at regular distances."""
        regular = regular_places(places_at(0, self.strides, self.shape).ravel()[places])
        if regular is None:
            return None
        return replace(self, shape=places.shape, strides=regular[1], base=self.base + regular[0])

    def row(self, axis: int, index: str) -> View:
        """View without an axis, at an index of it."""
        stride = self.strides[axis]
        term = () if stride == 0 else (index if stride == 1 else f"{stride} * {index}",)
        return replace(
            self,
            shape=(*self.shape[:axis], *self.shape[axis + 1 :]),
            strides=(*self.strides[:axis], *self.strides[axis + 1 :]),
            terms=(*self.terms, *term),
        )

    def permuted(self, axes: Sequence[int]) -> View:
        """View with its axes in another order."""
        return replace(self, shape=tuple(self.shape[i] for i in axes), strides=tuple(self.strides[i] for i in axes))

    def reversed(self, axis: int) -> View:
        """View from the last to the first element along an axis."""
        strides = list(self.strides)
        base = self.base + (self.shape[axis] - 1) * strides[axis]
        strides[axis] = -strides[axis]
        return replace(self, strides=tuple(strides), base=base)


@dataclass(frozen=True)
class Tree:
    """An expression for each element of an array."""

    shape: tuple[int, ...]
    kind: str
    template: str
    parts: tuple[Readable, ...]

    @property
    def is_uniform(self) -> bool:
        """Whether all elements are one number."""
        return self.template == "{0}" and isinstance(self.parts[0], Scalar)

    @property
    def size(self) -> int:
        """Number of operations of an element."""
        return 1 + sum(part.size for part in self.parts if isinstance(part, Tree))

    def views(self) -> list[View]:
        """Arrays that the expression reads."""
        return [view for part in self.parts for view in part.views()]

    def mapped(self, change: Callable[[View], View | None], shape: tuple[int, ...]) -> Tree | None:
        """The same expression of changed views; None if one cannot be changed."""
        parts: list[Readable] = []
        for part in self.parts:
            changed = part.mapped(change, shape)
            if changed is None:
                return None
            parts.append(changed)
        return replace(self, shape=shape, parts=tuple(parts))

    def value(self, indices: Sequence[str] = ()) -> str:
        """The text of an element, without indices of the first one."""
        return self.template.format(*(part.value(indices) for part in self.parts))


@dataclass(frozen=True)
class Maker:
    """An array that can be written to any place."""

    shape: tuple[int, ...]
    kind: str
    write: Callable[[View], None]
    reads: tuple[Any, ...]
    """Values that are read during the writing."""

    def views(self) -> list[View]:
        """Arrays that the writing reads."""
        return [view for part in self.reads for view in part.views()]


Readable = Scalar | View | Tree
Value = Readable | Maker


def dense(shape: Sequence[int]) -> tuple[int, ...]:
    """The strides of an array whose rows follow one another."""
    return tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))


def places_at(first: int, strides: Sequence[int], shape: Sequence[int]) -> Places:
    """Places at regular distances, an array of a shape."""
    places: Any = first
    for axis, (n, stride) in enumerate(zip(shape, strides, strict=True)):
        places = places + stride * np.arange(n).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return np.broadcast_to(np.asarray(places, np.int64), shape)


def regular_places(places: Places) -> tuple[int, tuple[int, ...]] | None:
    """First place and strides of places at regular distances; None of others."""
    first = int(places.ravel()[0]) if places.size else 0
    strides = []
    for axis in range(places.ndim):
        index = [0] * places.ndim
        index[axis] = 1
        strides.append(int(places[tuple(index)]) - first if places.shape[axis] > 1 else 0)
    return (first, tuple(strides)) if np.array_equal(places_at(first, strides, places.shape), places) else None
