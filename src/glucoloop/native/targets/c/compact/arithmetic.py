"""Meaning of each operation of a traced function to the bit, in NumPy: the definition of the compact form.

Sums are taken one number after the other, from zero on; each operation is rounded by itself; elementary functions are
the project's own.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import lax

from glucoloop.native import flatten, primitives
from glucoloop.native.functions import FURTHEST_WHOLE, SMALL_POWERS
from glucoloop.native.interpreter import interpret, larger, smaller
from glucoloop.native.lower import Lowered, lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.program import DOES
from glucoloop.native.targets.c.numbers import REAL, TRUTH, WHOLE, kind_of

Array = npt.NDArray[Any]

FUNCTIONS: Final[dict[str, Callable[..., Any]]] = {
    **{name: getattr(lax, name) for name in flatten.FUNCTIONS if name not in ("pow", "sign")},
    "round_even": jnp.round,
    "round_away": lax.round,
}
"""The elementary functions, `lax.rem` and `lax.atan2` of two numbers."""
ELEMENTWISE: Final = frozenset({
    *flatten.ELEMENTWISE, *flatten.FUNCTIONS, "round", "integer_pow", "square", "sign", "gt", "ge", "lt_to", "le_to",
    "select_n", "clamp", "convert_element_type",
})  # fmt: skip
LARGEST_CONSTANT: Final = 1024
"""Largest number of elements of an array that is computed beforehand rather than in C."""


def function_of(name: str, equation: Any) -> str | None:
    """Name of the elementary function that an operation is; None for any other operation."""
    if name == "round":
        return primitives.rounding(equation)
    whole = name == "rem" and kind_of(equation.invars[0].aval.dtype) == WHOLE
    return name if name in FUNCTIONS and not whole else None


@functools.cache
def function(name: str, precision: str) -> Lowered:
    """An elementary function of one number, or of two, as a scalar program."""

    def step(person: Any, carry: Any, own: Any, shared: Any, chance: Any) -> Any:
        del person, shared, chance
        return carry, FUNCTIONS[name](*own)

    numbers = (np.zeros((), precision),) * (2 if name in ("rem", "atan2") else 1)
    with jax.enable_x64(precision == "float64"):
        return lower(step, (), (), numbers, (), precision=precision)


def constant(value: Any, precision: str) -> Array:
    """An array as this arithmetic holds it."""
    array = np.asarray(value)
    kinds = {REAL: np.dtype(precision), WHOLE: np.dtype(np.int32), TRUTH: np.dtype(np.bool_)}
    return array.astype(kinds[kind_of(array.dtype)])


class Arithmetic:
    """Computes operations in one precision."""

    def __init__(self, precision: str) -> None:
        self.precision = precision
        self._real = np.dtype(precision).type
        self._places: dict[int, tuple[Any, list[npt.NDArray[np.int64]]]] = {}
        """Places of moves that were computed before, by the identity of the operation."""

    def __call__(
        self, name: str, equation: Any, operands: Sequence[Array], are_constant: Sequence[bool] = (False, False)
    ) -> list[Array]:
        """Results of an operation without an inner function; `are_constant` flags the factors of a product."""
        with np.errstate(all="ignore"):
            if name in primitives.SAME:
                return list(operands)
            if name in flatten.MOVES:
                return self._moved(equation, operands)
            if name in ELEMENTWISE:
                return [self._elementwise(name, equation, np.broadcast_arrays(*operands))]
            if name in flatten.REDUCTIONS:
                return [self._reduced(name, equation, operands[0])]
            if name == "dot_general":
                return [self._product(equation, operands[0], operands[1], (are_constant[0], are_constant[1]))]
            results = primitives.method(self, name)(equation, *operands)
        return results if isinstance(results, list) else [results]

    def _apply(self, name: str, *operands: Array) -> Array:
        _, result = interpret(function(name, self.precision), own=np.stack([x.ravel() for x in operands]))
        return result.reshape(operands[0].shape)

    def _elementwise(self, name: str, equation: Any, operands: Sequence[Array]) -> Array:
        a, b, c = (*operands, operands[0], operands[0])[:3]
        kind = kind_of(equation.invars[0].aval.dtype)
        simple, function_name = _SIMPLE.get(name), function_of(name, equation)
        result: Array
        if function_name is not None:
            result = self._apply(function_name, *operands)
        elif name == "rem":
            result = np.where(b == 0, a, np.fmod(a, b))
        elif simple is not None:
            result = simple(*operands)
        elif name == "div":
            whole = np.where(b == 0, -1, np.trunc(np.true_divide(a, b))) if kind != REAL else None
            result = np.divide(a, b) if whole is None else whole.astype(np.int32)
        elif name in ("max", "min"):
            result = (larger if name == "max" else smaller)(a, b)
        elif name == "clamp":
            result = smaller(larger(a, b), c)
        elif name == "pow":
            result = self._power(a, b, primitives.written_exponent(equation))
        elif name == "integer_pow":
            result = self._integer_power(a, primitives.exponent(equation))
        elif name == "select_n":
            result = a.astype(np.int32).choose(operands[1:])
        elif name == "sign":
            one = a.dtype.type(1)
            result = np.where(a > 0, one, np.where(a < 0, -one, a))
        elif name in ("lt_to", "le_to"):
            result = (a < b) | ((a == a) & (b != b)) if name == "lt_to" else (a <= b) | (b != b)
        else:
            result = self._converted(a, kind, kind_of(primitives.new_dtype(equation)))
        return result

    def _power(self, x: Array, y: Array, written: float | None) -> Array:
        if written in SMALL_POWERS:
            return self._integer_power(x, int(written))
        return self._apply("exp", y * self._apply("log", x))

    def _integer_power(self, x: Array, n: int) -> Array:
        if n == 0:
            return np.ones_like(x)
        product: Array = functools.reduce(lambda total, _: total * x, range(abs(n) - 1), x)
        return product if n > 0 else self._real(1.0) / product

    def _converted(self, a: Array, source: str, target: str) -> Array:
        if source == REAL and target == WHOLE:
            bounded = smaller(larger(self._real(-FURTHEST_WHOLE), a), self._real(FURTHEST_WHOLE))
            return np.where(a != a, self._real(0.0), bounded).astype(np.int32)
        return constant(a.astype({REAL: self._real, WHOLE: np.int32, TRUTH: np.bool_}[target]), self.precision)

    def _moved(self, equation: Any, operands: Sequence[Array]) -> list[Array]:
        whole = np.concatenate([array.ravel() for array in operands])
        result = self._cached_places(equation, lambda: places_of(equation, [array.shape for array in operands]))
        return [whole[places] for places in result]

    def _cached_places(self, equation: Any, find: Callable[[], list[npt.NDArray[np.int64]]]) -> Any:
        if id(equation) not in self._places:
            self._places[id(equation)] = equation, find()
        return self._places[id(equation)][1]

    def _reduced(self, name: str, equation: Any, a: Array) -> Array:
        (operation, start), axes = flatten.REDUCTIONS[name], primitives.axes(equation)
        reduce = larger if operation == "max" else smaller if operation == "min" else DOES[operation]
        remaining = [axis for axis in range(a.ndim) if axis not in axes]
        rows = a.transpose(*axes, *remaining).reshape(-1, *(a.shape[axis] for axis in remaining))
        total = np.full(rows.shape[1:], start, a.dtype)
        for row in rows:
            total = np.asarray(reduce(total, row))
        return total

    def _cumsum(self, equation: Any, a: Array) -> Array:
        axis, reverse = primitives.running(equation)
        rows = np.moveaxis(a, axis, 0)
        total, sums = np.zeros(rows.shape[1:], a.dtype), np.empty_like(rows)
        for i in range(rows.shape[0])[:: -1 if reverse else 1]:
            total = total + rows[i]
            sums[i] = total
        return np.moveaxis(sums, 0, axis)

    def _first(self, equation: Any, a: Array, *, better: Callable[[Array, Array], Array]) -> Array:
        (axis,) = primitives.axes(equation)
        rows = np.moveaxis(a.astype(np.int32) if a.dtype == bool else a, axis, 0)
        best, place = rows[0], np.zeros(rows.shape[1:], np.int32)
        for i, row in enumerate(rows[1:], start=1):
            takes = better(row, best) | ((row != row) & (best == best))
            best, place = np.where(takes, row, best), np.where(takes, np.int32(i), place)
        return place

    _argmax = functools.partialmethod(_first, better=np.greater)
    _argmin = functools.partialmethod(_first, better=np.less)

    def _iota(self, equation: Any) -> Array:
        return constant(np.asarray(primitives.iota(equation)).astype(equation.outvars[0].aval.dtype), self.precision)

    def _product(self, equation: Any, a: Array, b: Array, are_constant: tuple[bool, bool]) -> Array:
        axes = primitives.dot_general(equation)
        (left, right), batch, (free_a, free_b) = axes.summed, axes.batched, axes.free
        factor = banded_factor(equation, a.shape, b.shape, are_constant)
        inside_a = constant_band(a, left) if factor == 0 else np.ones(a.shape, np.bool_)
        inside_b = constant_band(b, right) if factor == 1 else np.ones(b.shape, np.bool_)

        def rows_of_a(array: Array) -> Array:
            array = array.transpose(*left, *batch[0], *free_a)
            return array.reshape(-1, *array.shape[len(left) :], *[1] * len(free_b))

        def rows_of_b(array: Array) -> Array:
            array = array.transpose(*right, *batch[1], *free_b)
            n, m = len(right), len(batch[1])
            return array.reshape(-1, *array.shape[n : n + m], *[1] * len(free_a), *array.shape[n + m :])

        a, b, inside = rows_of_a(a), rows_of_b(b), rows_of_a(inside_a) & rows_of_b(inside_b)
        total = np.zeros(np.broadcast_shapes(a.shape[1:], b.shape[1:]), a.dtype)
        for row_a, row_b, takes in zip(a, b, inside, strict=True):
            more = total + row_a * row_b
            total = more if takes.all() else np.where(takes, more, total)
        return np.asarray(total)

    def _dynamic_slice(self, equation: Any, a: Array, *starts: Array) -> Array:
        sizes = primitives.slice_sizes(equation)
        at = [min(max(int(s), 0), n - size) for s, n, size in zip(starts, a.shape, sizes, strict=True)]
        return a[tuple(slice(i, i + size) for i, size in zip(at, sizes, strict=True))]

    def _gather(self, equation: Any, a: Array, indices: Array) -> Array:
        axis = primitives.gathered_axis(equation)
        if axis is None:  # by places that are constant, or else the translation refuses it
            (places,) = self._cached_places(equation, lambda: [gather_places(equation, a.shape, indices)])
            return np.asarray(a.ravel()[places])
        slices = np.moveaxis(a, axis, 0)[np.clip(indices[..., 0], 0, a.shape[axis] - 1)]
        return np.moveaxis(slices, range(indices.ndim - 1, slices.ndim), primitives.gathered_offsets(equation))

    def _scattered(self, equation: Any, a: Array, indices: Array, updates: Array, *, adds: bool) -> Array:
        (places,) = self._cached_places(
            equation, lambda: [primitives.scatter_places(equation, a.shape, indices, updates.shape)]
        )
        result = a.copy()
        result.ravel()[places] = result.ravel()[places] + updates if adds else updates
        return result

    _scatter = functools.partialmethod(_scattered, adds=False)
    _scatter_add = functools.partialmethod(_scattered, adds=True)

    def _lu(self, equation: Any, a: Array) -> list[Array]:
        del equation
        a, n = a.copy(), a.shape[-1]
        pivots, order = np.zeros(n, np.int32), np.arange(n, dtype=np.int32)
        for k in range(n):
            best = k
            for i in range(k + 1, n):
                if abs(a[i, k]) > abs(a[best, k]):
                    best = i
            pivots[k] = best
            if best != k:
                a[[k, best]], order[[k, best]] = a[[best, k]], order[[best, k]]
            a[k + 1 :, k] = a[k + 1 :, k] / a[k, k]
            a[k + 1 :, k + 1 :] = a[k + 1 :, k + 1 :] - a[k + 1 :, k, None] * a[k, None, k + 1 :]
        return [a, pivots, order]

    def _triangular_solve(self, equation: Any, a: Array, b: Array) -> Array:
        how = primitives.triangular(equation)
        lower, a = how.lower != how.transposed, a.T if how.transposed else a
        if not how.left:
            lower, a, b = not lower, a.T, b.T
        x, n = b.copy(), a.shape[0]
        for i in range(n) if lower else reversed(range(n)):
            total = b[i]
            for k in range(i) if lower else reversed(range(i + 1, n)):  # as they were found
                total = total - a[i, k] * x[k]
            x[i] = total if how.unit_diagonal else total / a[i, i]
        return x if how.left else x.T


class Evaluation:
    """A function that was traced in a precision, in the compact form's arithmetic, for repeated evaluation.

    It is the reference against which the C of that form is checked. Each value has a flag, whether it depends on
    constants alone.
    """

    def __init__(self, closed: Any, precision: str) -> None:
        self._closed, self._arithmetic = closed, Arithmetic(precision)

    def __call__(self, arguments: Sequence[Any]) -> list[Array]:
        """Results of the function for arrays."""
        return [array for array, _ in self._run(self._closed, [self._value(argument)[0] for argument in arguments])]

    def _value(self, array: Any) -> tuple[Array, bool]:
        return constant(array, self._arithmetic.precision), True

    def _run(self, closed: Any, arrays: Sequence[Array]) -> list[tuple[Array, bool]]:
        """Results of a function of arrays that are not constants."""
        return primitives.evaluated(closed, [(array, False) for array in arrays], self._value, self._equation)

    def _equation(self, equation: Any, inputs: list[tuple[Array, bool]]) -> list[tuple[Array, bool]]:
        name, callee = equation.primitive.name, primitives.callee(equation)
        arrays, are_constant = [array for array, _ in inputs], [is_constant for _, is_constant in inputs]
        if name == "custom_linear_solve":
            callee, indices = primitives.solver(equation)
            inputs = [inputs[i] for i in indices]
        if name == "cond":
            options = primitives.branches(equation)
            callee, inputs = options[min(max(int(arrays[0]), 0), len(options) - 1)], inputs[1:]
            if not are_constant[0]:
                return [(array, False) for array, _ in self._run(callee, arrays[1:])]
        if callee is not None:
            return primitives.evaluated(callee, inputs, self._value, self._equation)
        if name == "scan":
            loop = primitives.scan(equation)
            rows = primitives.rounds(
                loop, arrays, lambda operands: [array for array, _ in self._run(loop.round, operands)]
            )
            return [(array, False) for array in rows]
        results = self._arithmetic(name, equation, arrays, are_constant)
        small = name in primitives.SAME or all(result.size <= LARGEST_CONSTANT for result in results)
        return [(result, small and all(are_constant)) for result in results]


_SIMPLE: Final[dict[str, Callable[..., Any]]] = {
    **{name: DOES[operation] for name, operation in flatten.ELEMENTWISE.items() if operation in DOES and name != "div"},
    "square": lambda x: x * x,
    "gt": np.greater,
    "ge": np.greater_equal,
}


def banded_factor(
    equation: Any, left: tuple[int, ...], right: tuple[int, ...], are_constant: tuple[bool, bool]
) -> int | None:
    """Factor of a product whose zeros are left out: a matrix or vector of constants times a vector that is not known.

    Of each row of that factor the numbers from the first to the last that is not zero enter the sum.
    """
    axes = primitives.dot_general(equation)
    if are_constant[0] == are_constant[1] or len(axes.summed[0]) != 1 or axes.batched[0]:
        return None
    of_other = [right[i] for i in axes.free[1]] if are_constant[0] else [left[i] for i in axes.free[0]]
    return None if np.prod(of_other, dtype=int) != 1 else 0 if are_constant[0] else 1


def constant_band(array: Array, summed: Sequence[int]) -> Array:
    """Numbers of each row from the first to the last that is not zero; rows lie along the summed axis."""
    some, (axis,) = array != 0, summed
    before = np.maximum.accumulate(some, axis=axis)
    after = np.flip(np.maximum.accumulate(np.flip(some, axis), axis=axis), axis)
    return np.asarray(before & after)


def places_of(equation: Any, shapes: Sequence[tuple[int, ...]]) -> list[npt.NDArray[np.int64]]:
    """Source of each element of the results of a move: a place in its operands, laid one after the other."""
    arrays, begin = [], 0
    for shape in shapes:
        size = int(np.prod(shape, dtype=np.int64))
        arrays.append(np.arange(begin, begin + size, dtype=np.int32).reshape(shape))
        begin += size
    return [result.astype(np.int64) for result in primitives.moved(equation, arrays)]


def gather_places(equation: Any, shape: tuple[int, ...], indices: Array) -> npt.NDArray[np.int64]:
    """Source of each element of a gather with known indices."""
    places = np.arange(int(np.prod(shape, dtype=np.int64))).reshape(shape)
    with jax.ensure_compile_time_eval():
        result = primitives.gathered(equation, places, indices, -1)
    if (result < 0).any():
        raise UnsupportedError("a place outside an array")
    return result
