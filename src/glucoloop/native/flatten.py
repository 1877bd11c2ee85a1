"""Conversion of a traced JAX function to a scalar program.

Arrays become arrays of values. Operations that only move numbers (slices, reshapes, gathers, scatters) are carried out
by JAX itself on the numbers of the elements; computing operations are taken element by element; short loops of known
length are unrolled. Operations that depend only on random keys are postponed, to be drawn before the loop.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import NoNameError
from glucoloop.native import primitives
from glucoloop.native.functions import Functions
from glucoloop.native.loops import LoopMaker, Values
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.program import BOOL, FLOAT, SAMPLE, Program, Value


class _RandomArray:
    """An array that depends only on random keys, so that it can be computed before the loop: its shape and type."""

    def __init__(self, aval: Any) -> None:
        self.aval = aval


@dataclass(frozen=True, eq=False)
class Drawing:
    """Computations from random keys before the loop, equation by equation."""

    keys: Sequence[_RandomArray]
    equations: Sequence[tuple[Any, Sequence[Any], Sequence[_RandomArray]]]
    """Equation, its inputs (`_RandomArray` or numbers), and its outputs."""
    results: Sequence[_RandomArray]
    """Arrays that the loop needs."""

    def __reduce__(self) -> NoReturn:
        raise NoNameError  # equations are objects of this process

    def __call__(self, *keys: Any) -> list[jax.Array]:
        """The wanted arrays, of one person at one sample; JAX can trace it."""
        output: dict[int, Any] = {id(variable): key for variable, key in zip(self.keys, keys, strict=True)}

        def read(operand: Any) -> Any:
            return output[id(operand)] if isinstance(operand, _RandomArray) else operand

        for equation, inputs, outputs in self.equations:
            results = primitives.bind(equation, [read(operand) for operand in inputs])
            output.update((id(variable), result) for variable, result in zip(outputs, results, strict=True))
        return [output[id(variable)] for variable in self.results]


_LONGEST_LOOP: Final = 64
"""Largest number of rounds that are written out one by one."""
_LARGEST_LOOP: Final = 30_000
"""Largest number of operations, about, of all rounds of a loop that is written out so."""
_FEW_ROUNDS: Final = 3
"""Number of rounds that are written out however long they are: more is then known of each."""
_LONGEST_TABLE: Final = 256
"""Largest number of places in an array among which a computed one is chosen."""

ELEMENTWISE: Final = {
    "add_any": "add",
    **{name: name for name in ("add", "sub", "mul", "div", "neg", "abs", "max", "min", "sqrt", "floor")},
    **{name: name for name in ("lt", "le", "eq", "ne", "and", "or", "xor", "not", "is_finite")},
}
FUNCTIONS: Final = {
    "pow": "power",
    **{name: name for name in ("exp", "expm1", "tanh", "log", "sin", "cos", "tan", "sinh", "cosh", "atan2", "cbrt")},
    **{name: name for name in ("logistic", "ceil", "rem", "sign")},
}
REDUCTIONS: Final[dict[str, tuple[str, float | bool]]] = {
    "reduce_sum": ("add", 0.0), "reduce_max": ("max", -math.inf), "reduce_min": ("min", math.inf),
    "reduce_and": ("and", True), "reduce_or": ("or", False),
}  # fmt: skip
"""Operation of each reduction, and its result where there is nothing."""
MOVES: Final = frozenset({
    "slice", "squeeze", "reshape", "broadcast_in_dim", "transpose", "concatenate", "rev", "expand_dims", "split",
    "stack", "unstack", "tile", "pad", *primitives.SAME,
})  # fmt: skip
_UNUSED: Final = -1


class Flattener:
    """Evaluates a jaxpr on arrays of values."""

    def __init__(self, program: Program, precision: str) -> None:
        self.program = program
        self._functions = Functions(program, precision)
        self._equations: list[tuple[Any, Sequence[Any], Sequence[_RandomArray]]] = []
        self._keys: list[_RandomArray] = []
        self._random_arrays: dict[int, tuple[_RandomArray, Values]] = {}
        self._rounds = LoopMaker(program)

    def input(self, name: tuple[str, int], aval: Any, level: int) -> Values:
        """An input of the program for each element of an array, named after the array and the element's place."""
        kind = BOOL if aval.dtype == bool else FLOAT
        flat = [self.program.input((*name, i), level, kind) for i in range(math.prod(aval.shape))]
        return np.array(flat, np.int64).reshape(aval.shape)

    def random_input(self, aval: Any) -> _RandomArray:
        """A random input, such as a random key or the number of the sample, to draw values from before the loop.

        It stays outside the program. Values that the program needs from it become inputs; `drawing` computes them.
        """
        key = _RandomArray(aval)
        self._keys.append(key)
        return key

    def drawing(self) -> tuple[Drawing, list[Values]]:
        """The computations before the loop, and the inputs of the program that hold their results."""
        arrays = list(self._random_arrays.values())
        drawing = Drawing(keys=self._keys, equations=self._equations, results=[variable for variable, _ in arrays])
        return drawing, [values for _, values in arrays]

    def _values(self, operand: Any) -> Values:
        """Values of an array; an array that depends on random keys becomes an input."""
        if not isinstance(operand, _RandomArray):
            values: Values = operand
            return values
        if id(operand) not in self._random_arrays:
            aval, position = operand.aval, len(self._random_arrays)
            if not (jnp.issubdtype(aval.dtype, jnp.floating) or aval.dtype == bool):
                raise UnsupportedError(f"random numbers of type {aval.dtype}")
            self._random_arrays[id(operand)] = (operand, self.input(("drawn", position), aval, SAMPLE))
        return self._random_arrays[id(operand)][1]

    def constants(self, array: Any) -> Values:
        """Numbers as values."""
        numbers = np.asarray(array)
        flat = numbers.ravel().tolist()
        places = [self.program.constant(bool(n) if numbers.dtype == bool else float(n)) for n in flat]
        return np.array(places, np.int64).reshape(numbers.shape)

    def run(self, closed: Any, arguments: Sequence[Values | _RandomArray]) -> list[Values]:
        """Results of a function."""
        return [self._values(result) for result in self._run(closed, arguments)]

    def _run(self, closed: Any, arguments: Sequence[Any]) -> list[Any]:
        def results_of(equation: Any, inputs: list[Any]) -> list[Any]:
            try:
                return self._postponed(equation, inputs) or self._equation(equation, inputs)
            except UnsupportedError as error:
                error.part = primitives.part(equation) or error.part
                raise

        return primitives.evaluated(closed, arguments, self.constants, results_of)

    def _postponed(self, equation: Any, inputs: list[Any]) -> list[_RandomArray] | None:
        """Postpone an equation that depends only on random keys."""
        if not any(isinstance(operand, _RandomArray) for operand in inputs) or equation.primitive.name.startswith(
            "custom_"
        ):
            return None  # a function with derivatives of its own is looked into
        numbers: list[Any] = []
        for operand, atom in zip(inputs, equation.invars, strict=True):
            if isinstance(operand, _RandomArray):
                numbers.append(operand)
            elif self._is_constant(operand):
                flat = [self.program.constants[int(v)] for v in operand.ravel()]
                numbers.append(jnp.asarray(np.array(flat).reshape(operand.shape), atom.aval.dtype))
            else:
                return None
        results = [_RandomArray(variable.aval) for variable in equation.outvars]
        self._equations.append((equation, numbers, results))
        return results

    def _equation(self, equation: Any, inputs: list[Any]) -> list[Any]:
        name = equation.primitive.name
        callee = primitives.callee(equation)
        if callee is not None:
            return self._run(callee, inputs)
        inputs = [self._values(operand) for operand in inputs]
        if name in ("div", "rem") and jnp.issubdtype(equation.invars[0].aval.dtype, jnp.integer):
            return [self._elementwise(functools.partial(self._functions, f"whole_{name}"), *inputs)]
        if name in ("gt", "ge"):
            name, inputs = "l" + name[1], inputs[::-1]
        if name in ELEMENTWISE:
            _refuse_other_than_floats(name, equation.invars[0].aval.dtype)
            return [self._elementwise(functools.partial(self.program.apply, ELEMENTWISE[name]), *inputs)]
        if name in FUNCTIONS:
            return [self._elementwise(functools.partial(self._functions, FUNCTIONS[name]), *inputs)]
        if name in REDUCTIONS:
            operation, start = REDUCTIONS[name]
            _refuse_other_than_floats(operation, equation.invars[0].aval.dtype)
            return [self._reduce(operation, inputs[0], primitives.axes(equation), start)]
        if name in MOVES:
            return self._move(equation, inputs)
        result = primitives.method(self, name, "_do_")(equation, *inputs)
        return result if isinstance(result, list) else [result]

    def _elementwise(self, operation: Callable[..., Value], *inputs: Values) -> Values:
        broadcast = np.broadcast_arrays(*inputs)
        elements = zip(*(a.ravel().tolist() for a in broadcast), strict=True)
        flat = [operation(*of_each) for of_each in elements]
        return np.array(flat, np.int64).reshape(broadcast[0].shape)

    def _reduce(self, operation: str, array: Values, axes: Sequence[int], start: float | bool = 0.0) -> Values:
        remaining = [axis for axis in range(array.ndim) if axis not in axes]
        shape, terms_a_row = [array.shape[axis] for axis in remaining], math.prod(array.shape[axis] for axis in axes)
        rows = array.transpose(*remaining, *axes).reshape(math.prod(shape), terms_a_row)
        do = functools.partial(self.program.apply, operation)

        def total(row: Values) -> Value:
            terms: list[Value] = row.tolist() or [self.program.constant(start)]
            while operation in ("and", "or") and len(terms) > 1:  # in pairs, which do not wait for one another
                terms = [functools.reduce(do, terms[i : i + 2]) for i in range(0, len(terms), 2)]
            return functools.reduce(do, terms)

        return np.array([total(row) for row in rows], np.int64).reshape(shape)

    def _do_cumsum(self, equation: Any, a: Values) -> Values:
        axis, reverse = primitives.running(equation)
        rows = np.moveaxis(a, axis, 0)[:: -1 if reverse else 1]
        sums = [rows[0]]
        for row in rows[1:]:
            sums.append(self._elementwise(functools.partial(self.program.apply, "add"), sums[-1], row))
        return np.moveaxis(np.stack(sums[:: -1 if reverse else 1]), 0, axis)

    def _move(self, equation: Any, inputs: list[Values]) -> list[Values]:
        """Let the operation move the numbers of the values."""
        return [np.asarray(result, np.int64) for result in primitives.moved(equation, inputs)]

    def _constant_numbers(self, values: Values) -> npt.NDArray[np.int64]:
        if not self._is_constant(values):
            raise UnsupportedError("a place in an array that depends on what happens")
        constants = self.program.constants
        return np.array([int(constants[int(v)]) for v in values.ravel()], np.int64).reshape(values.shape)

    def _is_constant(self, values: Values) -> bool:
        return all(int(v) in self.program.constants for v in values.ravel())

    def _chosen(self, at: Value, rows: Sequence[Values]) -> Values:
        """The array whose number, from 0 on, is computed; the first or last one beyond the ends."""
        if len(rows) > _LONGEST_TABLE:
            raise UnsupportedError(f"a choice among {len(rows)} places in an array (at most {_LONGEST_TABLE})")
        p, result = self.program, rows[-1]
        for i in reversed(range(len(rows) - 1)):
            takes = p.apply("le", at, p.constant(float(i)))
            result = self._elementwise(functools.partial(p.apply, "select", takes), rows[i], result)
        return result

    def _do_gather(self, equation: Any, operand: Values, indices: Values) -> Values:
        axis, p = primitives.gathered_axis(equation), self.program
        if axis is None or self._is_constant(indices):
            where = self._constant_numbers(indices)
            with jax.ensure_compile_time_eval():
                moved = primitives.gathered(equation, operand, where, _UNUSED)
            if (moved == _UNUSED).any():
                raise UnsupportedError("a place outside an array")
            return moved
        rows, fill = list(np.moveaxis(operand, axis, 0)), primitives.gathered_outside(equation)
        slices = []
        for at in indices.ravel().tolist():
            row = self._chosen(at, rows)
            if fill is not None:
                outside = p.apply(
                    "or", p.apply("lt", at, p.constant(0.0)), p.apply("lt", p.constant(len(rows) - 1.0), at)
                )
                row = self._elementwise(lambda x, o=outside: p.apply("select", o, p.constant(fill), x), row)
            slices.append(row)
        batch, of_row = indices.ndim - 1, operand.ndim - 1
        result = np.array(slices, np.int64).reshape((*indices.shape[:-1], *rows[0].shape))
        return np.moveaxis(result, range(batch, batch + of_row), primitives.gathered_offsets(equation))

    def _do_scatter(self, equation: Any, operand: Values, indices: Values, updates: Values) -> Values:
        (moved,) = self._move(equation, [operand, self._constant_numbers(indices), updates])
        return moved

    def _do_scatter_add(self, equation: Any, operand: Values, indices: Values, updates: Values) -> Values:
        places = primitives.scatter_places(equation, operand.shape, self._constant_numbers(indices), updates.shape)
        result = operand.copy()
        add = functools.partial(self.program.apply, "add")
        result.ravel()[places] = self._elementwise(add, operand.ravel()[places], updates)
        return result

    def _do_dynamic_slice(self, equation: Any, operand: Values, *starts: Values) -> Values:
        for axis, (start, size) in enumerate(zip(starts, primitives.slice_sizes(equation), strict=True)):
            last = operand.shape[axis] - size
            if self._is_constant(start):
                at = min(max(int(self._constant_numbers(start)), 0), last)
                operand = operand.take(range(at, at + size), axis)
            else:
                windows = [operand.take(range(at, at + size), axis) for at in range(last + 1)]
                operand = self._chosen(int(start), windows)
        return operand

    def _do_iota(self, equation: Any) -> Values:
        return self.constants(primitives.iota(equation))

    def _do_lt_to(self, equation: Any, a: Values, b: Values) -> Values:
        """Whether a stands before b where what is not a number stands last."""
        del equation
        do = self.program.apply
        return self._elementwise(lambda x, y: do("or", do("lt", x, y), do("and", do("eq", x, x), do("ne", y, y))), a, b)

    def _do_le_to(self, equation: Any, a: Values, b: Values) -> Values:
        return self._elementwise(functools.partial(self.program.apply, "not"), self._do_lt_to(equation, b, a))

    def _do_round(self, equation: Any, a: Values) -> Values:
        return self._elementwise(functools.partial(self._functions, primitives.rounding(equation)), a)

    def _do_square(self, equation: Any, a: Values) -> Values:
        del equation
        return self._elementwise(lambda x: self.program.apply("mul", x, x), a)

    def _do_integer_pow(self, equation: Any, a: Values) -> Values:
        power = primitives.exponent(equation)

        def elementwise(x: Value) -> Value:
            product = functools.reduce(lambda total, _: self.program.apply("mul", total, x), range(abs(power) - 1), x)
            if power == 0:
                return self.program.constant(1.0)
            return product if power > 0 else self.program.apply("div", self.program.constant(1.0), product)

        return self._elementwise(elementwise, a)

    def _do_clamp(self, equation: Any, low: Values, x: Values, high: Values) -> Values:
        del equation
        p = self.program
        return self._elementwise(lambda a, b, c: p.apply("min", p.apply("max", a, b), c), low, x, high)

    def _do_select_n(self, equation: Any, which: Values, *cases: Values) -> Values:
        p, which = self.program, np.broadcast_to(which, cases[0].shape)
        if equation.invars[0].aval.dtype == bool:  # False takes the first case
            return self._elementwise(lambda c, no, yes: p.apply("select", c, yes, no), which, *cases)

        flat = zip(*(array.ravel() for array in (which, *cases)), strict=True)
        result = [self._chosen(int(w), options) for w, *options in flat]
        return np.array(result, np.int64).reshape(cases[0].shape)

    def _do_cond(self, equation: Any, which: Values, *arguments: Values) -> list[Values]:
        """The results of one of several functions, all of which are computed."""
        result = [self.run(branch, arguments) for branch in primitives.branches(equation)]
        return [self._chosen(int(which), results) for results in zip(*result, strict=True)]

    def _do_argmax(self, equation: Any, a: Values, *, smallest: bool = False) -> Values:
        (axis,), p = primitives.axes(equation), self.program
        rows = np.moveaxis(a, axis, -1)

        def first_best(row: Values) -> Value:
            best, place = p.apply("number", int(row[0])), p.constant(0.0)
            for i, element in enumerate(row[1:], start=1):
                value = p.apply("number", int(element))
                better = p.apply("lt", *((value, best) if smallest else (best, value)))
                if self.program.types[int(element)] == FLOAT:  # what is no number counts as the best
                    new = p.apply("and", p.apply("ne", value, value), p.apply("eq", best, best))
                    better = p.apply("or", better, new)
                best, place = p.apply("select", better, value, best), p.apply("select", better, p.constant(i), place)
            return place

        flat = [first_best(row) for row in rows.reshape(-1, rows.shape[-1])]
        return np.array(flat, np.int64).reshape(rows.shape[:-1])

    _do_argmin = functools.partialmethod(_do_argmax, smallest=True)

    def _do_convert_element_type(self, equation: Any, a: Values) -> Values:
        source, target = equation.invars[0].aval.dtype, primitives.new_dtype(equation)
        p = self.program
        if source == target:
            return a
        if target == np.bool_:
            return self._elementwise(lambda x: p.apply("ne", x, p.constant(0.0)), a)
        if source == np.bool_:
            return self._elementwise(lambda x: p.apply("number", x), a)
        if jnp.issubdtype(source, jnp.floating) and jnp.issubdtype(target, jnp.integer):
            return self._elementwise(self._functions.whole, a)
        return a  # whole numbers are held as numbers

    def _do_dot_general(self, equation: Any, a: Values, b: Values) -> Values:
        axes = primitives.dot_general(equation)
        common, (left, right) = len(axes.batched[0]), map(len, axes.free)
        a = a.transpose(*axes.batched[0], *axes.free[0], *axes.summed[0])
        b = b.transpose(*axes.batched[1], *axes.free[1], *axes.summed[1])
        a = np.expand_dims(a, tuple(range(common + left, common + left + right)))
        b = np.expand_dims(b, tuple(range(common, common + left)))
        products = self._elementwise(functools.partial(self.program.apply, "mul"), a, b)
        return self._reduce("add", products, range(common + left + right, products.ndim))

    def _do_scan(self, equation: Any, *inputs: Values) -> list[Values]:
        loop = primitives.scan(equation)
        if loop.length == 0:
            raise UnsupportedError("a loop of 0 rounds")
        small = loop.length <= _FEW_ROUNDS or loop.length * primitives.work(loop.round) <= _LARGEST_LOOP
        if loop.length <= _LONGEST_LOOP and small:
            return primitives.rounds(loop, inputs, lambda operands: self.run(loop.round, operands))
        constants, rest = inputs[: loop.constants], inputs[loop.constants :]
        rows = [array[::-1] if loop.reverse else array for array in rest[loop.carry :]]

        def round_(carry: list[Values], row: list[Values]) -> tuple[list[Values], list[Values]]:
            results = self.run(loop.round, [*constants, *carry, *row])
            return results[: loop.carry], results[loop.carry :]

        last, stacked = self._rounds(round_, rest[: loop.carry], rows, loop.length)
        return [*last, *(array[::-1] if loop.reverse else array for array in stacked)]

    def _do_while(self, equation: Any, *inputs: Values) -> list[Values]:
        (condition, of_condition), (closed, of_round) = primitives.while_loop(equation)
        condition_constants, constants = inputs[:of_condition], inputs[of_condition : of_condition + of_round]
        start = list(inputs[of_condition + of_round :])
        do = self.program.apply

        def round_(carry: list[Values], row: list[Values]) -> tuple[list[Values], list[Values]]:
            *state, going = carry
            new = self.run(closed, [*constants, *state])
            frozen = functools.partial(do, "select", int(going))
            next_state = [self._elementwise(frozen, after, before) for after, before in zip(new, state, strict=True)]
            (holds,) = self.run(condition, [*condition_constants, *next_state])
            return [*next_state, self._elementwise(functools.partial(do, "and"), going, holds)], row

        *last, _ = self._rounds(round_, [*start, *self.run(condition, [*condition_constants, *start])], [], None)[0]
        return last


def _refuse_other_than_floats(operation: str, dtype: Any) -> None:
    """Refuse an operation that has another meaning for integers or truth values than for floats."""
    truths = jnp.issubdtype(dtype, jnp.bool_)
    if operation in ("and", "or", "xor", "not") and not truths:
        raise UnsupportedError("bits of whole numbers")
    if operation in ("lt", "le", "max", "min") and truths:
        raise UnsupportedError("an order of truths")
