"""Parameters of JAX's primitives that native code reads; the only module that looks into an equation's parameters.

The parameters of a primitive are no public interface of JAX: from one version to the next they change their names and
their form. Each is therefore read by one function here, which has a test of its own (``tests/native/test_primitives``):
the test traces a public function of JAX and names the primitive if a new JAX keeps its parameters in another way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import lax

CALLS: Final = {
    "jit": "jaxpr",
    "remat2": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vmap_call": "call",
}
"""The primitives that call another function, and the parameter which holds that function."""
SAME: Final = frozenset(("copy", "copy_p", "stop_gradient", "optimization_barrier"))
"""The primitives that return their operands."""


class UnsupportedError(ValueError):
    """The function has an operation that a scalar program cannot express."""

    part: str | None = None
    """Name of the outermost `jax.named_scope` of the operation."""

    def __str__(self) -> str:
        """The operation, and whose code it stands in."""
        return f"{super().__str__()} in the {self.part}" if self.part else super().__str__()


def _unknown(equation: Any) -> UnsupportedError:
    result = ", ".join(sorted(equation.params)) or "none"
    return UnsupportedError(
        f"the operation {equation.primitive.name!r} as JAX {jax.__version__} writes it, "
        f"with parameters that glucoloop cannot read (found: {result})"
    )


def _parameter(equation: Any, name: str) -> Any:
    try:
        return equation.params[name]
    except KeyError:
        raise _unknown(equation) from None


def _closed(function: Any) -> Any:
    """The function with its constants."""
    from jax.extend import core  # of some milliseconds, and where code that is kept is read nobody needs it

    return function if hasattr(function, "consts") else core.ClosedJaxpr(function, ())


def method(of: object, name: str, prefix: str = "_") -> Callable[..., Any]:
    """Method of an object that carries out a primitive, by the names of both; a primitive without one is refused."""
    result: Callable[..., Any] | None = getattr(of, f"{prefix}{name.replace('-', '_')}", None)
    if result is None:
        raise UnsupportedError(f"the operation {name!r}")
    return result


def part(equation: Any) -> str | None:
    """Name of the outermost `jax.named_scope` around an equation, within the function that it stands in."""
    stack = str(getattr(getattr(equation, "source_info", None), "name_stack", ""))
    return next((name for name in stack.split("/") if name and "(" not in name), None)


def bind(equation: Any, inputs: Sequence[Any], **changed: Any) -> list[Any]:
    """Let JAX carry out an equation on other inputs, with some of its parameters replaced."""
    for name in changed:
        _parameter(equation, name)
    results = equation.primitive.bind(*inputs, **{**equation.params, **changed})
    return list(results) if equation.primitive.multiple_results else [results]


def evaluated(
    closed: Any,
    arguments: Sequence[Any],
    constant: Callable[[Any], Any],
    results_of: Callable[[Any, list[Any]], Sequence[Any]],
) -> list[Any]:
    """Results of a function, from values of its constants and from the results of its equations, one by one."""
    jaxpr = closed.jaxpr
    values: dict[Any, Any] = dict(zip(jaxpr.invars, arguments, strict=True))
    values.update((variable, constant(array)) for variable, array in zip(jaxpr.constvars, closed.consts, strict=True))

    def read(atom: Any) -> Any:
        if hasattr(atom, "val"):
            return constant(np.asarray(atom.val, getattr(atom.aval, "dtype", None)))
        return values[atom]

    for equation in jaxpr.eqns:
        results = results_of(equation, [read(atom) for atom in equation.invars])
        values.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def of_keys(equation: Any) -> Any:
    """Function of the two words of a key that an operation on random keys is; None for another operation.

    It gives the words of the keys, or the bits, which the operation gives.
    """
    from jax.extend.random import threefry_prng_impl as prng

    name = equation.primitive.name
    if name not in ("random_bits", "random_split", "random_fold_in"):
        return None
    if equation.invars[0].aval.dtype != jax.eval_shape(jax.random.key, 0).dtype:
        raise UnsupportedError("random keys of another kind than those of jax.random.key")
    word, key = np.zeros((), np.uint32), np.zeros(prng.key_shape, np.uint32)
    if name == "random_fold_in":
        return jax.make_jaxpr(prng.fold_in)(key, word)
    shape = _parameter(equation, "shape")
    if name == "random_split":
        return jax.make_jaxpr(lambda key: prng.split(key, shape))(key)
    return jax.make_jaxpr(lambda key: prng.random_bits(key, _parameter(equation, "bit_width"), shape))(key)


def callee(equation: Any) -> Any:
    """Function that an equation calls, with its constants; None if the equation is not a call."""
    holder = CALLS.get(equation.primitive.name)
    return None if holder is None else _closed(_parameter(equation, holder))


def moved(equation: Any, arrays: Sequence[npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
    """Results of an operation that only moves numbers: the frequent ones by NumPy, the others by JAX."""
    name, (result, *_) = equation.primitive.name, equation.outvars
    match name:
        case "squeeze" | "reshape" | "expand_dims":
            return [arrays[0].reshape(result.aval.shape)]
        case "slice":
            starts, ends = _parameter(equation, "start_indices"), _parameter(equation, "limit_indices")
            strides = _parameter(equation, "strides") or [1] * len(starts)
            return [arrays[0][tuple(map(slice, starts, ends, strides))]]
        case "transpose":
            return [arrays[0].transpose(_parameter(equation, "permutation"))]
        case "broadcast_in_dim":
            lengths = dict(zip(_parameter(equation, "broadcast_dimensions"), arrays[0].shape, strict=True))
            shape = [lengths.get(axis, 1) for axis in range(len(result.aval.shape))]
            return [np.broadcast_to(arrays[0].reshape(shape), result.aval.shape)]
        case "concatenate":
            return [np.concatenate(arrays, _parameter(equation, "dimension"))]
        case "stack":
            return [np.stack(arrays, _parameter(equation, "axis"))]
        case "unstack":
            return list(np.moveaxis(arrays[0], _parameter(equation, "axis"), 0))
        case "split":
            ends = np.cumsum(_parameter(equation, "sizes"))
            return np.split(arrays[0], ends[:-1], _parameter(equation, "axis"))
        case _ if name in SAME:
            return list(arrays)
    with jax.ensure_compile_time_eval():
        return [np.asarray(results) for results in bind(equation, jax.device_put(list(arrays)))]


@dataclass(frozen=True)
class _Scan:
    """A loop of known length. Its inputs are constants, what is carried, and what is taken row by row, in this order.

    Each round takes the constants, what is carried and a row; it gives what is carried on, and a row of results.
    """

    round: Any
    length: int
    reverse: bool
    constants: int
    """Number of inputs that are constants."""
    carry: int
    """Number of inputs that are carried."""


def scan(equation: Any) -> _Scan:
    """The parts of a ``scan``."""
    params = equation.params
    if "num_consts" in params and "num_carry" in params:  # up to JAX 0.10
        constants, carry = params["num_consts"], params["num_carry"]
    else:  # from JAX 0.11: a tree of three groups
        try:
            constants, carry, rows = map(len, _parameter(equation, "ft_in").unpack())
        except (AttributeError, TypeError, ValueError):
            raise _unknown(equation) from None
        if constants + carry + rows != len(equation.invars):
            raise _unknown(equation)
    return _Scan(
        round=_closed(_parameter(equation, "jaxpr")),
        length=_parameter(equation, "length"),
        reverse=_parameter(equation, "reverse"),
        constants=constants,
        carry=carry,
    )


def rounds(
    loop: _Scan, inputs: Sequence[npt.NDArray[Any]], results_of: Callable[[list[npt.NDArray[Any]]], list[Any]]
) -> list[npt.NDArray[Any]]:
    """Results of a loop on arrays, from the results of one round after another."""
    constants, rest = inputs[: loop.constants], inputs[loop.constants :]
    carry, each = list(rest[: loop.carry]), rest[loop.carry :]
    stacked: dict[int, list[npt.NDArray[Any]]] = {}
    for k in reversed(range(loop.length)) if loop.reverse else range(loop.length):
        results = results_of([*constants, *carry, *(array[k] for array in each)])
        carry, stacked[k] = results[: loop.carry], results[loop.carry :]
    return [*carry, *(np.stack(rows) for rows in zip(*(stacked[k] for k in range(loop.length)), strict=True))]


def while_loop(equation: Any) -> tuple[tuple[Any, int], tuple[Any, int]]:
    """Condition and round of a ``while``, each with the number of its inputs that are constants, which come first."""
    condition, round_ = (_closed(_parameter(equation, f"{name}_jaxpr")) for name in ("cond", "body"))
    return (condition, _parameter(equation, "cond_nconsts")), (round_, _parameter(equation, "body_nconsts"))


def work(closed: Any) -> int:
    """Number of operations on numbers in a function, about; a loop of unknown length counts as one round."""
    total = 0
    for equation in closed.jaxpr.eqns:
        inner, times = callee(equation), 1
        match equation.primitive.name:
            case "scan":
                loop = scan(equation)
                inner, times = loop.round, loop.length
            case "while":
                inner = while_loop(equation)[1][0]
            case "dot_general":
                left = equation.invars[0].aval.shape
                times = math.prod(left[axis] for axis in dot_general(equation).summed[0])
        results = (work(inner),) if inner is not None else (variable.aval.size for variable in equation.outvars)
        total += times * sum(results)
    return total


def axes(equation: Any) -> tuple[int, ...]:
    """The axes along which a reduction, or a search for the largest, is taken."""
    return tuple(_parameter(equation, "axes"))


def exponent(equation: Any) -> int:
    """The exponent of an ``integer_pow``."""
    return int(_parameter(equation, "y"))


def written_exponent(equation: Any) -> float | None:
    """The exponent of a ``pow`` that is written as a number; None if it is an array."""
    exponent = equation.invars[1]
    return float(exponent.val) if hasattr(exponent, "val") else None


def slice_sizes(equation: Any) -> tuple[int, ...]:
    """The shape that a ``dynamic_slice`` takes out."""
    return tuple(_parameter(equation, "slice_sizes"))


def iota(equation: Any) -> npt.NDArray[np.int64]:
    """The numbers of an ``iota``: 0, 1, ... along one axis."""
    shape, along = _parameter(equation, "shape"), _parameter(equation, "dimension")
    line = np.arange(shape[along]).reshape([-1 if axis == along else 1 for axis in range(len(shape))])
    return np.broadcast_to(line, shape)


def new_dtype(equation: Any) -> Any:
    """The type that a ``convert_element_type`` converts to."""
    return _parameter(equation, "new_dtype")


@dataclass(frozen=True)
class _Product:
    """The axes of the two factors of a product of arrays."""

    summed: tuple[tuple[int, ...], tuple[int, ...]]
    """The axes of the left and of the right factor that are multiplied and summed, pair by pair."""
    batched: tuple[tuple[int, ...], tuple[int, ...]]
    """The axes of the left and of the right factor that are held in common, pair by pair."""
    free: tuple[tuple[int, ...], tuple[int, ...]]
    """The other axes of the left and of the right factor."""


def dot_general(equation: Any) -> _Product:
    """The axes of a ``dot_general``, whose result has those in common, then the free ones."""
    summed, batched = _parameter(equation, "dimension_numbers")
    axes = (range(len(factor.aval.shape)) for factor in equation.invars)
    left, right = (
        tuple(axis for axis in of_each if axis not in (*contracted, *common))
        for of_each, contracted, common in zip(axes, summed, batched, strict=True)
    )
    return _Product(summed=summed, batched=batched, free=(left, right))


def gathered(
    equation: Any, operand: npt.NDArray[np.int64], indices: npt.NDArray[np.int64], outside: int
) -> npt.NDArray[np.int64]:
    """Elements that a ``gather`` takes from an array; `outside` where an index lies outside the array."""
    (result,) = bind(equation, jax.device_put([operand, indices]), fill_value=outside)
    return np.asarray(result, np.int64)


def scatter_places(
    equation: Any, shape: tuple[int, ...], indices: npt.NDArray[Any], updates: tuple[int, ...]
) -> npt.NDArray[np.int64]:
    """Destination of each element of the updates of a scatter; the destinations are distinct."""
    size = int(np.prod(updates, dtype=np.int64))
    kind = equation.invars[0].aval.dtype  # in which a scatter that adds does so; it holds small whole numbers
    marks = np.arange(1, size + 1, dtype=kind).reshape(updates)
    with jax.ensure_compile_time_eval():
        (marked,) = bind(equation, jax.device_put([np.zeros(shape, kind), indices, marks]))
    flat = np.asarray(marked).ravel().astype(np.int64)
    places = np.full(size, -1, np.int64)
    there = np.flatnonzero(flat)
    places[flat[there] - 1] = there
    if (places < 0).any() or (flat > size).any():
        raise UnsupportedError("a scatter of several numbers to one place, or outside an array")
    return places.reshape(updates)


def gathered_axis(equation: Any) -> int | None:
    """The axis along which a ``gather`` takes whole slices of one operand; None for another kind of gather."""
    how, sizes = _parameter(equation, "dimension_numbers"), _parameter(equation, "slice_sizes")
    shape = equation.invars[0].aval.shape
    if len(how.start_index_map) != 1 or tuple(how.collapsed_slice_dims) != tuple(how.start_index_map):
        return None
    (axis,) = how.start_index_map
    rest = [i for i in range(len(shape)) if i != axis]
    if how.operand_batching_dims or any(sizes[i] != shape[i] for i in rest):
        return None
    return int(axis)


def gathered_outside(equation: Any) -> float | None:
    """The number that a ``gather`` gives for a place outside the array; None where it takes the nearest inside."""
    if "FILL" not in str(_parameter(equation, "mode")):
        return None
    fill = _parameter(equation, "fill_value")
    if fill is None and not jnp.issubdtype(equation.invars[0].aval.dtype, jnp.floating):
        raise UnsupportedError("a place outside an array of whole numbers or truths")
    return math.nan if fill is None else float(fill)


def rounding(equation: Any) -> str:
    """The way in which a ``round`` takes one of two whole numbers that are equally near."""
    away = _parameter(equation, "rounding_method") == lax.RoundingMethod.AWAY_FROM_ZERO
    return "round_away" if away else "round_even"


def gathered_offsets(equation: Any) -> tuple[int, ...]:
    """The axes of the result of a ``gather`` that are those of the slices which it takes."""
    return tuple(int(i) for i in _parameter(equation, "dimension_numbers").offset_dims)


def running(equation: Any) -> tuple[int, bool]:
    """The axis of a ``cumsum``, and whether it runs from the end."""
    return int(_parameter(equation, "axis")), bool(_parameter(equation, "reverse"))


@dataclass(frozen=True)
class _Triangular:
    """Flags of a ``triangular_solve``."""

    left: bool
    """Whether it solves ``A x = b``; otherwise ``x A = b``."""
    lower: bool
    transposed: bool
    unit_diagonal: bool


def triangular(equation: Any) -> _Triangular:
    """The flags of a ``triangular_solve``."""
    names = ("left_side", "lower", "transpose_a", "unit_diagonal")
    return _Triangular(*(bool(_parameter(equation, name)) for name in names))


def solver(equation: Any) -> tuple[Any, list[int]]:
    """The function by which a ``custom_linear_solve`` solves, and which of the equation's inputs it takes."""
    lengths, functions = _parameter(equation, "const_lengths"), _parameter(equation, "jaxprs")
    first = lengths.matvec + lengths.vecmat
    right = first + lengths.solve + lengths.transpose_solve
    return _closed(functions.solve), [*range(first, first + lengths.solve), *range(right, len(equation.invars))]


def branches(equation: Any) -> list[Any]:
    """The functions among which a ``cond`` chooses."""
    return [_closed(branch) for branch in _parameter(equation, "branches")]
