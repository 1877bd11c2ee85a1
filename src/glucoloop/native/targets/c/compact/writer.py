"""Lines of C with loops, local variables, constant tables and arrays of the workspace, and where values are read."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.native.targets.c.compact.flat import Flat, Operand, Variable
from glucoloop.native.targets.c.compact.memory import Array
from glucoloop.native.targets.c.compact.values import (
    LARGEST_EXPRESSION,
    Maker,
    Readable,
    Scalar,
    Tree,
    Value,
    View,
    dense,
)
from glucoloop.native.targets.c.numbers import REAL, TRUTH, WHOLE, Format, kind_of, type_of

WORKSPACE: Final = {REAL: "w", WHOLE: "k", TRUTH: "b"}
"""Names of the arrays of the workspace."""
FEW: Final = 2
"""Largest number of elements that are written one by one rather than by a loop."""


class Tables:
    """Constant arrays of a file, each once."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, bytes], str] = {}
        self.arrays: dict[str, npt.NDArray[Any]] = {}

    def name(self, array: npt.NDArray[Any]) -> str:
        """Name of an array."""
        flat = np.ascontiguousarray(array).ravel()
        key = (kind_of(flat.dtype), flat.tobytes())
        if key not in self._names:
            self._names[key] = f"gl_t{len(self._names)}"
            self.arrays[self._names[key]] = flat
        return self._names[key]


class Writer:
    """Lines of one C function."""

    def __init__(self, format: Format, tables: Tables) -> None:
        self.format = format
        self.lines: list[str] = []
        self.arrays: list[Array] = []
        self._tables = tables
        self._count = 0

    def say(self, *lines: str) -> None:
        """Add lines to the function."""
        self.lines += lines

    def fresh(self, letter: str) -> str:
        """A name that is not used yet."""
        self._count += 1
        return f"{letter}{self._count}"

    def constant(self, array: npt.NDArray[Any]) -> Readable:
        """A known array."""
        kind = kind_of(array.dtype)
        flat = array.ravel()
        bits = np.ascontiguousarray(flat).view(np.uint8).reshape(flat.size, -1) if flat.size else flat
        if flat.size and (bits == bits[0]).all():
            text = self.format.constant(flat[0], kind)
            # MISRA C:2012, rule 10.6: a small literal alone has a narrower type than the variables of its kind.
            number = Scalar(f"(int32_t){text}" if kind == WHOLE else text, kind, is_name=True)
            return number if array.size == 1 else Tree(array.shape, kind, "{0}", (number,))
        return View(self._tables.name(array), kind, array.shape, dense(array.shape))

    def table(self, array: npt.NDArray[Any]) -> str:
        """Name of a table of constants."""
        return self._tables.name(array)

    def array(self, shape: Sequence[int], kind: str) -> View:
        """A new array in the workspace."""
        self.arrays.append(Array(len(self.arrays), kind, max(1, math.prod(shape))))
        return View(WORKSPACE[kind], kind, tuple(shape), dense(shape), number=len(self.arrays) - 1)

    def local(self, scalar: Scalar) -> Scalar:
        """A number that costs nothing to repeat."""
        if scalar.is_name:
            return scalar
        name = self.fresh("v")
        self.say(f"const {type_of(scalar.kind, self.format)} {name} = {_bare(scalar.text)};")
        return Scalar(name, scalar.kind, is_name=True)

    def variable(self, kind: str, start: str) -> Scalar:
        """A local variable that changes."""
        name = self.fresh("c")
        self.say(f"{type_of(kind, self.format)} {name} = {start};")
        return Scalar(name, kind, is_name=True)

    @contextlib.contextmanager
    def block(self, head: str) -> Iterator[None]:
        """A block behind a line."""
        self.say(head, "{")
        yield
        self.say("}")

    def counted(self, index: str, end: int | str, begin: int | str = 0) -> contextlib.AbstractContextManager[None]:
        """A loop over numbers from `begin` to below `end`."""
        return self.block(f"for (int32_t {index} = {begin}; {index} < {end}; {index}++)")

    @contextlib.contextmanager
    def loops(self, shape: Sequence[int]) -> Iterator[list[str]]:
        """Loops over the axes of a shape, and the indices; an axis of one element has no loop."""
        with contextlib.ExitStack() as stack:
            indices = []
            for n in shape:
                if n == 1:
                    indices.append("0")
                    continue
                i = self.fresh("i")
                stack.enter_context(self.counted(i, n))
                indices.append(i)
            yield indices

    def write(self, value: Value, to: View) -> None:
        """Write a value to its place."""
        if isinstance(value, Maker):
            value.write(to)
        elif math.prod(to.shape) == 1:
            self.assign(to, (), value.value())
        elif isinstance(value, Scalar):
            self._fill(Tree(to.shape, value.kind, "{0}", (self.local(value),)), to)
        else:
            self._fill(value, to)

    def assign(self, to: View, indices: Sequence[str], text: str) -> None:
        """Write one element."""
        text = _bare(text)
        if to.is_field and to.kind == TRUTH:
            text = f"({text}) ? 1 : 0"
        self.say(f"{to.element(indices)} = {text};")

    def _fill(self, value: Readable, to: View) -> None:
        views = [to, *value.views()]
        shape, strides = _joined(to.shape, [view.strides for view in views])

        def lean(view: View) -> View:
            return replace(view, shape=shape, strides=strides[views.index(view)])

        to = lean(to)
        thin: Any = value.mapped(lean, shape)
        if math.prod(shape) <= FEW:
            for i in range(math.prod(shape)):
                at = functools.partial(_at, indices=np.unravel_index(i, shape))
                self.assign(at(to), (), thin.mapped(at, ()).value())
            return
        with self.loops(shape) as result:
            self.assign(to, result, thin.value(result))


def _at(view: View, indices: Sequence[Any]) -> View:
    base = view.base + sum(int(i) * stride for i, stride in zip(indices, view.strides, strict=True))
    return replace(view, shape=(), strides=(), base=base)


def _joined(shape: Sequence[int], strides: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], list[tuple[int, ...]]]:
    """A shape with as few axes as possible, and the strides of several views along them."""
    axes = [i for i, n in enumerate(shape) if n != 1]
    joined: list[tuple[int, list[int]]] = []
    for axis in axes:
        along_axis = [one_view[axis] for one_view in strides]
        if joined and all(above == n * shape[axis] for above, n in zip(joined[-1][1], along_axis, strict=True)):
            joined[-1] = (joined[-1][0] * shape[axis], along_axis)
        else:
            joined.append((shape[axis], along_axis))
    return tuple(n for n, _ in joined), [tuple(along_axis[v] for _, along_axis in joined) for v in range(len(strides))]


def _bare(text: str) -> str:
    """A text without the parentheses around all of it."""
    if not text.startswith("("):
        return text
    depth = 0
    for i, letter in enumerate(text):
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if depth == 0:
            return text[1:-1] if i == len(text) - 1 and not text.startswith("(-") else text
    return text


Environment = dict[Variable, Value]


class ValueStore:
    """Reads values, and writes those to memory that are not there yet."""

    def __init__(self, writer: Writer) -> None:
        self._w = writer

    def _read(self, operand: Operand, environment: Environment) -> Value:
        return environment[operand] if isinstance(operand, Variable) else self._w.constant(operand)

    def _materialised(self, value: Value) -> View:
        return value if isinstance(value, View) else self._copied(value)

    def _copied(self, value: Value) -> View:
        to = self._w.array(value.shape, value.kind)
        self._w.write(value, to)
        return to

    def _scalar(self, value: Value) -> Scalar:
        """A value of one element as a number."""
        if isinstance(value, Maker):
            value = self._copied(value)
        if isinstance(value, Tree) and value.is_uniform:
            (value,) = value.parts
        return value if isinstance(value, Scalar) else Scalar(value.value(), value.kind)

    def _stored(self, operand: Operand, environment: Environment) -> Readable:
        """A value that may be read anywhere below, any number of times."""
        value = self._read(operand, environment)
        if math.prod(shape_of(operand)) == 1:
            value = self._w.local(self._scalar(value))
        elif not isinstance(value, View) and not (isinstance(value, Tree) and value.is_uniform):
            value = self._materialised(value)
        if isinstance(operand, Variable):
            environment[operand] = value
        return value

    def _view(self, operand: Operand, environment: Environment) -> View:
        value = self._stored(operand, environment)
        if isinstance(value, View):
            return value
        if isinstance(value, Scalar):
            return self._copied(Tree(shape_of(operand), value.kind, "{0}", (value,)))
        view = self._copied(value)
        if isinstance(operand, Variable):
            environment[operand] = view
        return view

    def _readable(self, operand: Operand, environment: Environment, flat: Flat) -> Readable:
        """A value whose elements are each read once."""
        value = self._read(operand, environment)
        if math.prod(shape_of(operand)) == 1:
            return self._scalar(value)
        once = isinstance(operand, Variable) and flat.uses[operand] == 1
        if isinstance(value, Tree) and (value.is_uniform or (once and value.size < LARGEST_EXPRESSION)):
            return value
        return self._stored(operand, environment)

    def _readable_or_maker(self, operand: Operand, environment: Environment, flat: Flat) -> Value:
        """Value as of `_readable`, or a maker for a value that may be written once its place is known."""
        value = self._read(operand, environment)
        once = isinstance(operand, Variable) and flat.uses[operand] == 1
        if once and math.prod(shape_of(operand)) != 1 and isinstance(value, Maker):
            return value
        return self._readable(operand, environment, flat)

    def _each(self, output: Variable, element: Callable[[list[str]], Scalar], reads: tuple[Any, ...]) -> Value:
        """An array each of whose elements is computed by lines of its own."""
        if math.prod(output.shape) == 1:
            return element(["0"] * len(output.shape))

        def write(to: View) -> None:
            with self._w.loops(output.shape) as indices:
                self._w.assign(to, indices, element(indices).text)

        return Maker(output.shape, output.kind, write, reads)


def shape_of(operand: Operand) -> tuple[int, ...]:
    """Shape of an array that is computed or known."""
    return tuple(operand.shape)


def permuted(value: Any, axes: Sequence[int]) -> Any:
    """Value with its axes in another order."""
    if isinstance(value, Scalar):
        return value
    return value.mapped(lambda view: view.permuted(axes), tuple(value.shape[i] for i in axes))
