"""Translation of a traced function to C with loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from glucoloop.native import primitives
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.c.compact.arithmetic import (
    ELEMENTWISE,
    FUNCTIONS,
    MOVES,
    REDUCTIONS,
    SMALL_POWERS,
    gather_places,
    places_of,
    scatter_places,
)
from glucoloop.native.targets.c.compact.flat import CLIP, INSIDE, Flat, Operand, Operation, Variable
from glucoloop.native.targets.c.compact.linear import LinearAlgebra
from glucoloop.native.targets.c.compact.settle import Environment, permuted, shape_of
from glucoloop.native.targets.c.compact.values import (
    Maker,
    Places,
    Scalar,
    Tree,
    Value,
    View,
    regular_places,
    views_of,
)
from glucoloop.native.targets.c.compact.writer import Writer
from glucoloop.native.targets.c.numbers import REAL, TRUTH, WHOLE

_LONGEST: Final = 160
"""Largest number of letters in an expression of one number."""
_INFIX: Final = {
    "add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/", "rem": "%", "lt": "<", "le": "<=", "gt": ">",
    "ge": ">=", "eq": "==", "ne": "!=", "and": "&&", "or": "||", "xor": "!=",
}  # fmt: skip
_CALLS: Final = {
    "abs": "gl_abs", "sqrt": "gl_sqrt", "floor": "gl_floor", "square": "gl_square", "sign": "gl_sign",
    "is_finite": "gl_finite", "max": "gl_max", "min": "gl_min", "lt_to": "gl_below",
    **{name: f"gl_{name}" for name in FUNCTIONS},
}  # fmt: skip
_OF_WHOLE: Final = {"max": "gl_whole_max", "min": "gl_whole_min", "abs": "gl_whole_abs"}
_STARTS: Final = {"reduce_sum": 0, "reduce_max": -math.inf, "reduce_min": math.inf, "reduce_and": 1, "reduce_or": 0}
_STEPS: Final = {
    "reduce_sum": "{0} + {1}",
    "reduce_max": "gl_max({0}, {1})",
    "reduce_min": "gl_min({0}, {1})",
    "reduce_and": "{0} && {1}",
    "reduce_or": "{0} || {1}",
}


@dataclass(frozen=True)
class Place:
    """Place of a leaf of a structure."""

    text: str
    kind: str
    shape: tuple[int, ...]

    @property
    def view(self) -> View:
        """View of the leaf as an array."""
        strides = tuple(math.prod(self.shape[i + 1 :]) for i in range(len(self.shape)))
        return View(self.text, self.kind, self.shape, strides, is_plain=self.shape == (), is_field=True)


class Translator(LinearAlgebra):
    """Writes the C of a flat function."""

    def __init__(self, writer: Writer) -> None:
        super().__init__(writer)
        self._changing: set[Variable] = set()
        """Variables of loops whose arrays are their own, and written in every round."""

    def translate(self, flat: Flat, given: Sequence[Place], returned: Sequence[Place]) -> None:
        """Write the whole function; its results are stored after everything was read."""
        environment: Environment = {v: place.view for v, place in zip(flat.inputs, given, strict=True)}
        values = self._body(flat, environment)
        waiting = []
        for output, value, place in zip(flat.outputs, values, returned, strict=True):
            to = place.view
            if math.prod(to.shape) == 0 or value == to:
                continue
            if isinstance(value, Scalar) or math.prod(to.shape) == 1:
                value = self._w.local(self._scalar(value))
            elif any(view.is_field for view in views_of(value)):
                value = self._materialised(value)
            del output
            waiting.append((value, to))
        for value, to in waiting:
            self._w.write(value, to)

    def _body(self, flat: Flat, environment: Environment) -> list[Value]:
        for operation in flat.operations:
            self._operation(operation, environment, flat)
        return [self._read(output, environment) for output in flat.outputs]

    # operations

    def _operation(self, operation: Operation, environment: Environment, flat: Flat) -> None:
        name = operation.name
        if name in ELEMENTWISE or name in (INSIDE, CLIP):
            results: Sequence[Value] = [self._elementwise(operation, environment, flat)]
        elif name in MOVES:
            results = self._moved(operation, environment, flat)
        elif name in REDUCTIONS:
            results = [self._reduced(operation, environment, flat)]
        else:
            handler: Callable[..., Sequence[Value]] | None = getattr(self, f"_{name.replace('-', '_')}", None)
            if handler is None:
                raise UnsupportedError(f"the operation {name!r}")
            results = handler(operation, environment, flat)
        environment.update(zip(operation.outputs, results, strict=True))

    def _elementwise(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,) = operation.outputs
        template = _template(operation, self._w)
        parts = [self._readable(given, environment, flat) for given in operation.inputs]
        if math.prod(output.shape) == 1:
            return self._number(template, [self._scalar(part).text for part in parts], output, flat)
        whole = tuple(
            self._w.local(part) if isinstance(part, Scalar) else self._widened(part, output.shape) for part in parts
        )
        return Tree(output.shape, output.kind, template, whole)

    def _widened(self, part: View | Tree, shape: tuple[int, ...]) -> View | Tree:
        """An array repeated along axes of which it has one element."""
        if part.shape == shape:
            return part
        if isinstance(part, Tree) and part.is_uniform:
            return replace(part, shape=shape)
        view = self._materialised(part)
        strides = tuple(0 if n == 1 else stride for n, stride in zip(view.shape, view.strides, strict=True))
        return replace(view, shape=shape, strides=strides)

    def _number(self, template: str, texts: Sequence[str], output: Variable, flat: Flat) -> Scalar:
        scalar = Scalar(template.format(*texts), output.kind)
        if flat.uses.get(output, 0) > 1 or len(scalar.text) > _LONGEST:
            return self._w.local(scalar)
        return scalar

    def _moved(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        shapes = [shape_of(given) for given in operation.inputs]
        if len(operation.inputs) > 1:
            return [self._joined(operation, environment, flat)]
        (given,) = operation.inputs
        (_, used) = (given, [v for v in operation.outputs if v in flat.uses])
        if all(math.prod(v.shape) == 1 for v in (*operation.outputs,)) and math.prod(shapes[0]) == 1:
            value = self._scalar(self._read(given, environment))
            return [value]
        maps = places_of(operation.equation, shapes)
        results: list[Value] = []
        for output, places in zip(operation.outputs, maps, strict=True):
            if output not in flat.uses:
                results.append(Scalar("0", output.kind))
                continue
            grows = places.size > math.prod(shapes[0])
            results.append(self._taken(given, places, environment, flat, whole=len(used) == 1 and not grows))
        return results

    def _taken(self, given: Operand, places: Places, environment: Environment, flat: Flat, *, whole: bool) -> Value:
        """Elements of an array, by their places."""
        if math.prod(shape_of(given)) == 1:
            number = self._w.local(self._scalar(self._settled(given, environment)))
            return number if places.size == 1 else Tree(places.shape, number.kind, "{0}", (number,))
        value = self._readable(given, environment, flat) if whole else self._settled(given, environment)
        if isinstance(value, Tree) and value.is_uniform:
            (only,) = value.parts
            if isinstance(only, Scalar):
                return only if places.size == 1 else replace(value, shape=places.shape)
        moved: Any
        if isinstance(value, Tree):
            moved = value.mapped(lambda view: view.moved(places), places.shape)
            if moved is None:
                value = self._settled(given, environment)
        if isinstance(value, View):
            moved = value.moved(places)
            if moved is None:
                return self._looked_up(value, places)
        return (
            Scalar(moved.value(["0"] * places.ndim), moved.kind)
            if places.size == 1 and isinstance(moved, View)
            else (self._scalar(moved) if places.size == 1 else moved)
        )

    def _looked_up(self, source: View, places: Places) -> Value:
        """Elements at irregular places, by a table of these."""
        index = self._w.constant(places.astype(np.int32))
        strides = tuple(math.prod(source.shape[i + 1 :]) for i in range(len(source.shape)))
        if source.strides != strides:
            source = self._materialised(Tree(source.shape, source.kind, "{0}", (source,)))
        line = replace(source, shape=(math.prod(source.shape),), strides=(1,))

        def write(to: View) -> None:
            with self._w.loops(places.shape) as found:
                at = self._w.element(index, found) if not isinstance(index, Maker) else "0"
                self._w.assign(to, found, line.value([at]))

        return Maker(places.shape, source.kind, write, (source,))

    def _joined(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,) = operation.outputs
        shapes = [shape_of(given) for given in operation.inputs]
        (places,) = places_of(operation.equation, shapes)
        pieces: list[tuple[Value, tuple[int, tuple[int, ...]], tuple[int, ...]]] = []
        begin = 0
        for given, shape in zip(operation.inputs, shapes, strict=True):
            size = math.prod(shape)
            there = np.flatnonzero((begin <= places.ravel()) & (places.ravel() < begin + size))
            begin += size
            if there.size == 0:
                continue
            if there.size > size == 1:  # a number that is repeated; the others are written over it
                whole = (0, tuple(math.prod(output.shape[i + 1 :]) for i in range(len(output.shape))))
                pieces.insert(0, (self._w.local(self._scalar(self._read(given, environment))), whole, output.shape))
                continue
            goes = np.empty(size, np.int64)
            goes[places.ravel()[there] - begin + size] = there
            regular = regular_places(goes.reshape(shape))
            if regular is None:
                raise UnsupportedError(f"the operation {operation.name!r} of such shapes")
            value = self._readable_or_maker(given, environment, flat)
            pieces.append((value, regular, shape))

        def write(to: View) -> None:
            for value, (first, strides), shape in pieces:
                self._w.write(value, _part(to, output.shape, first, strides, shape))

        return Maker(output.shape, output.kind, write, tuple(value for value, _, _ in pieces))

    def _reduced(self, operation: Operation, environment: Environment, flat: Flat) -> Value:
        (output,), (given,) = operation.outputs, operation.inputs
        axes = primitives.axes(operation.equation)
        value = self._readable(given, environment, flat)
        if isinstance(value, Scalar):
            return value
        if not axes:
            return value
        kept = [axis for axis in range(len(value.shape)) if axis not in axes]
        turned = permuted(value, [*kept, *axes])
        inner = [value.shape[axis] for axis in axes]
        start, step = self._w.literal(_STARTS[operation.name], output.kind), _STEPS[operation.name]

        def total(indices: list[str]) -> Scalar:
            found = self._w.variable(output.kind, start)
            with self._w.loops(inner) as of_inner:
                text = self._w.element(turned, [*indices, *of_inner])
                self._w.say(f"{found.text} = {step.format(found.text, text)};")
            return found

        return self._each(output, total, (value,))

    def _cumsum(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (output,), (given,) = operation.outputs, operation.inputs
        axis, reverse = primitives.running(operation.equation)
        value = self._readable(given, environment, flat)
        if isinstance(value, Scalar):
            return [value]
        order = [*(i for i in range(len(value.shape)) if i != axis), axis]
        turned = permuted(value, order)
        if reverse:
            turned = _reversed(turned, len(order) - 1)

        def write(to: View) -> None:
            to = to.permuted(order)
            to = to.reversed(len(order) - 1) if reverse else to
            with self._w.loops(turned.shape[:-1]) as outer:
                found = self._w.variable(output.kind, self._w.literal(0, output.kind))
                with self._w.loops(turned.shape[-1:]) as along:
                    text = self._w.element(turned, [*outer, *along])
                    self._w.say(f"{found.text} = {found.text} + {text};")
                    self._w.assign(to, [*outer, *along], found.text)

        return [Maker(output.shape, output.kind, write, (value,))]

    def _first(self, operation: Operation, environment: Environment, sign: str) -> list[Value]:
        (output,), (given,) = operation.outputs, operation.inputs
        (axis,) = primitives.axes(operation.equation)
        view = self._view(given, environment)
        turned = view.permuted([*(i for i in range(len(view.shape)) if i != axis), axis])

        def number(text: str) -> str:
            return f"({text} ? 1 : 0)" if view.kind == TRUTH else text

        kind = WHOLE if view.kind == TRUTH else view.kind

        def place(indices: list[str]) -> Scalar:
            best = self._w.variable(kind, number(turned.value([*indices, "0"])))
            found = self._w.variable(WHOLE, "0")
            i = self._w.fresh("i")
            with self._w.block(f"for (int32_t {i} = 1; {i} < {turned.shape[-1]}; {i}++)"):
                of = self._w.local(Scalar(number(turned.value([*indices, i])), kind))
                new = f" || (({of.text} != {of.text}) && ({best.text} == {best.text}))" if kind == REAL else ""
                condition = f"({of.text} {sign} {best.text})"
                with self._w.block(f"if ({condition}{new})" if new else f"if {condition}"):
                    self._w.say(f"{best.text} = {of.text};", f"{found.text} = {i};")
            return found

        return [self._each(output, place, (view,))]

    def _argmax(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        del flat
        return self._first(operation, environment, ">")

    def _argmin(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        del flat
        return self._first(operation, environment, "<")

    def _dynamic_slice(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        del flat
        given, *starts = operation.inputs
        view = self._view(given, environment)
        sizes = primitives.slice_sizes(operation.equation)
        for start, stride, n, size in zip(starts, view.strides, view.shape, sizes, strict=True):
            text = self._scalar(self._settled(start, environment)).text
            at = self._w.local(Scalar(f"gl_within({text}, {n - size})", WHOLE))
            view = replace(view, terms=(*view.terms, f"{stride} * {at.text}" if stride != 1 else at.text))
        view = replace(view, shape=tuple(sizes))
        return [self._scalar(view) if math.prod(sizes) == 1 else view]

    def _gather(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        (output,), (given, indices) = operation.outputs, operation.inputs
        if not isinstance(indices, Variable):
            places = gather_places(operation.equation, shape_of(given), indices)
            return [self._taken(given, places, environment, flat, whole=False)]
        axis = primitives.gathered_axis(operation.equation)
        if axis is None:
            raise UnsupportedError("a gather along several axes")
        view, index = self._view(given, environment), self._view(indices, environment)
        out = primitives.gathered_offsets(operation.equation)
        size = view.shape[axis]
        rest = view.row(axis, "0")

        def element(found: list[str]) -> Scalar:
            batch = [i for n, i in enumerate(found) if n not in out]
            at = self._w.local(Scalar(f"gl_within({index.value([*batch, '0'])}, {size - 1})", WHOLE))
            of = view.row(axis, at.text)
            return Scalar(of.value([i for n, i in enumerate(found) if n in out]), view.kind)

        del rest
        return [self._each(output, element, (view, index))]

    def _scattered(self, operation: Operation, environment: Environment, flat: Flat, *, adds: bool) -> list[Value]:
        (output,), (given, indices, updates) = operation.outputs, operation.inputs
        if isinstance(indices, Variable):
            raise UnsupportedError("a scatter to places that are not known")
        places = scatter_places(operation.equation, output.shape, indices, shape_of(updates))
        regular = regular_places(places)
        if regular is None:
            raise UnsupportedError("a scatter to irregular places")
        operand = self._readable_or_maker(given, environment, flat)
        update = self._readable_or_maker(updates, environment, flat)
        if adds and isinstance(update, Maker):
            update = self._materialised(update)

        def write(to: View) -> None:
            self._w.write(operand, to)
            part = _part(to, output.shape, *regular, shape_of(updates))
            value: Value = update
            if adds and not isinstance(update, Maker):
                if math.prod(part.shape) == 1:
                    text = self._scalar(update).text
                    value = Scalar(f"({part.element(['0'] * len(part.shape))} + {text})", output.kind)
                else:
                    number = self._w.local(update) if isinstance(update, Scalar) else update
                    value = Tree(part.shape, output.kind, "({0} + {1})", (part, number))
            self._w.write(value, part)

        return [Maker(output.shape, output.kind, write, (operand, update))]

    def _scatter(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        return self._scattered(operation, environment, flat, adds=False)

    def _scatter_add(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        return self._scattered(operation, environment, flat, adds=True)

    # loops and choices

    def _scan(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        loop, (inner,) = primitives.scan(operation.equation), operation.inner
        constants = operation.inputs[: loop.constants]
        carried = operation.inputs[loop.constants : loop.constants + loop.carried]
        rows = operation.inputs[loop.constants + loop.carried :]
        values: list[Value] = [self._settled(given, environment) for given in constants]
        each = [self._settled(given, environment) for given in rows]
        held: list[Value] = []
        of_loop = inner.inputs[loop.constants : loop.constants + loop.carried]
        for given, output, inside in zip(carried, operation.outputs, of_loop, strict=False):
            if output in flat.uses or inside in inner.uses:
                held.append(self._held(self._readable_or_maker(given, environment, flat), output))
                self._changing.add(inside)
            else:
                held.append(Scalar("0", output.kind))
        stacked: list[View | None] = []
        for output in operation.outputs[loop.carried :]:
            stacked.append(self._w.array(output.shape, output.kind) if output in flat.uses else None)
        i = self._w.fresh("i")
        with self._w.block(f"for (int32_t {i} = 0; {i} < {loop.length}; {i}++)"):
            of_round: list[Value] = []
            for value in each:
                of_round.append(self._row(value, i, loop.length, reverse=loop.reverse))
            results = self._body(inner, dict(zip(inner.inputs, [*values, *held, *of_round], strict=True)))
            for value, place in zip(results[loop.carried :], stacked, strict=True):
                if place is not None:
                    row = place.reversed(0).row(0, i) if loop.reverse else place.row(0, i)
                    self._w.write(value, row)
            self._carry_on(results[: loop.carried], held)
        return [*held, *(Scalar("0", REAL) if place is None else place for place in stacked)]

    def _held(self, value: Value, output: Variable) -> Value:
        """A value that changes from round to round."""
        if math.prod(output.shape) == 1:
            return self._w.variable(output.kind, self._scalar(value).text)
        to = self._w.array(output.shape, output.kind)
        self._w.write(value, to)
        return to

    def _row(self, value: Value, index: str, length: int, *, reverse: bool) -> Value:
        if isinstance(value, View):
            view = value.reversed(0).row(0, index) if reverse else value.row(0, index)
            return self._scalar(view) if math.prod(view.shape) == 1 else view
        if isinstance(value, Tree) and isinstance(value.parts[0], Scalar):
            shape = value.shape[1:]
            return value.parts[0] if math.prod(shape) == 1 else replace(value, shape=shape)
        del length
        return value  # a loop of one round

    def _carry_on(self, results: Sequence[Value], held: Sequence[Value]) -> None:
        """Pass on the carried values, when nothing reads their old values any more."""
        changing = {of.number for of in held if isinstance(of, View)}
        waiting: list[tuple[Value, Value]] = []
        for value, of in zip(results, held, strict=True):
            if value == of or of == Scalar("0", of.kind):
                continue
            if isinstance(of, Scalar):
                waiting.append((self._w.local(replace(self._scalar(value), is_name=False)), of))
            elif any(view.number in changing for view in views_of(value)):
                fresh = self._w.array(of.shape, of.kind)
                self._w.write(value, fresh)
                waiting.append((fresh, of))
            else:
                waiting.append((value, of))
        for value, of in waiting:  # arrays first: they may be computed from the old numbers
            if isinstance(of, View):
                self._w.write(value, of)
        for value, of in waiting:
            if isinstance(of, Scalar) and isinstance(value, Scalar):
                self._w.say(f"{of.text} = {value.text};")

    def _cond(self, operation: Operation, environment: Environment, flat: Flat) -> list[Value]:
        index, *given = operation.inputs
        which = self._scalar(self._settled(index, environment)).text
        values = [self._settled(operand, environment) for operand in given]
        results = [self._place_of_choice(i, operation, values, flat) for i in range(len(operation.outputs))]
        last = len(operation.inner) - 1
        for n, branch in enumerate(operation.inner):
            head = "else" if n == last else f"{'else ' if n else ''}if ({which} {'<=' if n == 0 else '=='} {n})"
            with self._w.block(head):
                found = self._body(branch, dict(zip(branch.inputs, values, strict=True)))
                self._chosen(
                    [(v, to) for v, to, o in zip(found, results, operation.outputs, strict=True) if o in flat.uses]
                )
        return results

    def _chosen(self, pairs: Sequence[tuple[Value, Value]]) -> None:
        """Store the results of a branch; a place may be that of an argument, which other results read."""
        for value, to in pairs:
            if isinstance(to, Scalar):
                self._w.say(f"{to.text} = {self._scalar(value).text};")
        changing = {to.number for _, to in pairs if isinstance(to, View)}
        arrays = [(value, to) for value, to in pairs if isinstance(to, View) and value != to]
        reading = [any(view.number in changing for view in views_of(value)) for value, _ in arrays]
        ready = [self._copied(value) if reads else value for (value, _), reads in zip(arrays, reading, strict=True)]
        for value, (_, to) in zip(ready, arrays, strict=True):
            if isinstance(to, View):
                self._w.write(value, to)

    def _place_of_choice(self, i: int, operation: Operation, values: Sequence[Value], flat: Flat) -> Value:
        """Place for a result of a choice; that of the argument if a branch returns it and nothing else needs it."""
        output = operation.outputs[i]
        if output not in flat.uses:
            return Scalar("0", output.kind)
        if math.prod(output.shape) == 1:
            return self._w.variable(output.kind, self._w.literal(0, output.kind))
        for branch in operation.inner:
            for variable, given, value in zip(branch.inputs, operation.inputs[1:], values, strict=True):
                alone = isinstance(given, Variable) and given in self._changing and flat.uses[given] == 1
                if alone and branch.outputs[i] is variable and isinstance(value, View):
                    return value
        return self._w.array(output.shape, output.kind)


def _part(to: View, whole: tuple[int, ...], first: int, strides: tuple[int, ...], shape: tuple[int, ...]) -> View:
    """A part of an array, given by places in the whole as if it stood row by row."""
    places: Any = first
    for axis, stride in enumerate(strides):
        places = places + stride * np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    del whole
    part = to.moved(np.broadcast_to(np.asarray(places, np.int64), shape))
    if part is None:
        raise UnsupportedError("a part of an array at irregular places")
    return part


def _reversed(value: Any, axis: int) -> Any:
    return (
        value.reversed(axis) if isinstance(value, View) else value.mapped(lambda view: view.reversed(axis), value.shape)
    )


def _template(operation: Operation, writer: Writer) -> str:
    """The text of an operation on numbers, with places for its arguments."""
    name, equation = operation.name, operation.equation
    if name in (INSIDE, CLIP):
        return f"gl_{name}({_arguments(operation)})"
    first = equation.invars[0].aval.dtype
    real = np.issubdtype(first, np.floating)
    if name in _OF_WHOLE and not real:
        return f"{_OF_WHOLE[name]}({_arguments(operation)})"
    if name in _INFIX:
        if first == np.bool_ and name in ("lt", "le", "gt", "ge", "add", "mul"):
            raise UnsupportedError(f"the operation {name!r} of truths")
        if name in ("and", "or", "xor") and first != np.bool_:
            raise UnsupportedError("bits of whole numbers")
        return f"({{0}} {_INFIX[name]} {{1}})"
    if name in _CALLS:
        return f"{_CALLS[name]}({_arguments(operation)})"
    match name:
        case "neg":
            return "(-{0})"
        case "not":
            return "(!{0})"
        case "clamp":
            return "gl_min(gl_max({0}, {1}), {2})" if real else "gl_whole_min(gl_whole_max({0}, {1}), {2})"
        case "integer_pow":
            return _power(primitives.exponent(equation), writer)
        case "pow":
            written = primitives.written_exponent(equation)
            if written in SMALL_POWERS:
                return _power(int(written), writer)
            return "gl_exp({1} * gl_log({0}))"
        case "select_n":
            return _choice(operation)
        case _:
            return _conversion(equation, writer)


def _arguments(operation: Operation) -> str:
    return ", ".join(f"{{{i}}}" for i in range(len(operation.inputs)))


def _power(n: int, writer: Writer) -> str:
    one = writer.literal(1, REAL)
    if n == 0:
        return one
    text = "{0}" if abs(n) == 1 else "gl_square({0})" if abs(n) == 2 else f"gl_power({{0}}, {abs(n)})"
    return text if n > 0 else f"({one} / {text})"


def _choice(operation: Operation) -> str:
    if operation.equation.invars[0].aval.dtype == np.bool_:
        return "({0} ? {2} : {1})"
    last = len(operation.inputs) - 1
    text = f"{{{last}}}"
    for i in range(last - 1, 0, -1):
        text = f"(({{0}} == {i - 1}) ? {{{i}}} : {text})"
    return text


def _conversion(equation: Any, writer: Writer) -> str:
    source, target = equation.invars[0].aval.dtype, primitives.new_dtype(equation)
    real_source, real_target = np.issubdtype(source, np.floating), np.issubdtype(target, np.floating)
    if target == np.bool_:
        return f"({{0}} != {writer.literal(0, REAL if real_source else WHOLE)})"
    if source == np.bool_:
        kind = REAL if real_target else WHOLE
        if kind == WHOLE:  # MISRA C:2012, rule 10.6: a small literal has a narrower type
            return "({0} ? (int32_t)1 : (int32_t)0)"
        return f"({{0}} ? {writer.literal(1, kind)} : {writer.literal(0, kind)})"
    if real_source and not real_target:
        return "gl_whole({0})"
    return f"(({writer.format.type}){{0}})" if real_target else "{0}"
