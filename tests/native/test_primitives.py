"""What JAX keeps in the parameters of its primitives, as native code reads it.

Each test traces a public function. If one fails with a new JAX, the primitive in its name keeps its parameters in
another way there, and `glucoloop.native.primitives` is where to read the new one as well.
"""

import ast
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend import core

from glucoloop.native import primitives
from glucoloop.native.primitives import UnsupportedError

X = jnp.arange(12.0).reshape(3, 4)


def equations(function, *arguments):
    """All equations of a traced function, by the names of their primitives."""
    found = {}

    def walk(closed):
        for equation in closed.jaxpr.eqns:
            found.setdefault(equation.primitive.name, equation)
            inner = primitives.callee(equation)
            if inner is not None:
                walk(inner)

    walk(jax.make_jaxpr(function)(*arguments))
    return found


def evaluated(function, *arguments):
    return jax.tree.leaves(core.jaxpr_as_fun(function)(*arguments))


@jax.custom_jvp
def with_a_derivative(x):
    return x * 3.0


with_a_derivative.defjvp(lambda x, t: (with_a_derivative(*x), t[0]))


@jax.custom_vjp
def with_a_pullback(x):
    return x * 3.0


with_a_pullback.defvjp(lambda x: (x * 3.0, None), lambda _, g: (g,))


@jax.custom_batching.custom_vmap
def with_a_map(x):
    return x * 3.0


with_a_map.def_vmap(lambda size, mapped, x: (with_a_map(x), True))

CALLS = {
    "jit": jax.jit(lambda x: x * 3.0),
    "remat2": jax.checkpoint(lambda x: x * 3.0),
    "custom_jvp_call": with_a_derivative,
    "custom_vjp_call": with_a_pullback,
    "custom_vmap_call": with_a_map,
}


def test_each_call_is_tried():
    assert set(CALLS) == set(primitives.CALLS)


@pytest.mark.parametrize("name", CALLS)
def test_the_function_that_a_call_calls(name):
    inner = primitives.callee(equations(CALLS[name], X)[name])
    np.testing.assert_array_equal(evaluated(inner, X)[0], 3.0 * X)


def test_a_call_of_a_function_with_constants():
    table = np.asarray([1.0, 2.0, 4.0, 8.0])
    inner = primitives.callee(equations(jax.checkpoint(lambda x: x * table), X)["remat2"])
    extra = len(inner.jaxpr.invars) - 1
    np.testing.assert_array_equal(evaluated(inner, *[table] * extra, X)[0], X * table)


def test_what_is_no_call():
    assert primitives.callee(equations(jnp.sin, X)["sin"]) is None


@pytest.mark.parametrize("reverse", [False, True], ids=["forwards", "backwards"])
def test_scan(reverse):
    def function(gain, offset, start, rows):
        def one(carry, row):
            total, count = carry
            return (gain * total + offset * row.sum(), count + 1.0), (total, -row)

        return jax.lax.scan(one, start, rows, reverse=reverse)

    gain, offset, start = jnp.asarray(0.5), jnp.asarray(2.0), (jnp.asarray(1.0), jnp.asarray(0.0))
    equation = equations(function, gain, offset, start, X)["scan"]
    loop = primitives.scan(equation)
    assert (loop.length, loop.reverse, loop.constants, loop.carry) == (3, reverse, 2, 2)
    total, count, before, row = evaluated(loop.round, gain, offset, *start, X[1])
    assert (float(total), float(count), float(before)) == (0.5 + 2.0 * float(X[1].sum()), 1.0, 1.0)
    np.testing.assert_array_equal(row, -X[1])


def test_scan_without_rows_constants_or_results():
    equation = equations(lambda x: jax.lax.scan(lambda c, _: (c + 1.0, None), x, None, length=7)[0], X)["scan"]
    loop = primitives.scan(equation)
    assert (loop.length, loop.reverse, loop.constants, loop.carry) == (7, False, 0, 1)


def test_scan_of_a_loop_that_counts():
    equation = equations(lambda x: jax.lax.fori_loop(0, 5, lambda i, c: c + i, x), X)["scan"]
    loop = primitives.scan(equation)
    assert (loop.length, loop.constants, loop.carry) == (5, 0, 2)


REDUCTIONS = {
    "reduce_sum": lambda x: jnp.sum(x, axis=(0, 2)),
    "reduce_max": lambda x: jnp.max(x, axis=(0, 2)),
    "reduce_min": lambda x: jnp.min(x, axis=(0, 2)),
    "reduce_and": lambda x: jnp.all(x > 0.0, axis=(0, 2)),
    "reduce_or": lambda x: jnp.any(x > 0.0, axis=(0, 2)),
}


@pytest.mark.parametrize("name", REDUCTIONS)
def test_axes_of_a_reduction(name):
    assert primitives.axes(equations(REDUCTIONS[name], X.reshape(3, 2, 2))[name]) == (0, 2)


def test_axis_of_argmax():
    assert primitives.axes(equations(lambda x: jnp.argmax(x, axis=1), X)["argmax"]) == (1,)


@pytest.mark.parametrize("power", [-2, 3])
def test_exponent_of_integer_pow(power):
    assert primitives.exponent(equations(lambda x: x**power, X)["integer_pow"]) == power


def test_sizes_of_dynamic_slice():
    function = lambda x, i: jax.lax.dynamic_slice(x, (i, 0), (2, 3))  # noqa: E731
    assert primitives.slice_sizes(equations(function, X, 1)["dynamic_slice"]) == (2, 3)


def test_numbers_of_iota():
    equation = equations(lambda: jax.lax.broadcasted_iota(float, (2, 3, 2), 1))["iota"]
    np.testing.assert_array_equal(primitives.iota(equation), np.indices((2, 3, 2))[1])


@pytest.mark.parametrize("dtype", ["float32", "int32", "bool"])
def test_type_of_convert_element_type(dtype):
    equation = equations(lambda x: jax.lax.convert_element_type(x, dtype), X)["convert_element_type"]
    assert primitives.new_dtype(equation) == np.dtype(dtype)


def test_axes_of_dot_general():
    equation = equations(lambda a, b: jnp.einsum("bij,jbk->bik", a, b), X.reshape(3, 2, 2), X.reshape(2, 3, 2))
    product = primitives.dot_general(equation["dot_general"])
    assert sorted(zip(*product.summed, strict=True)) in ([(2, 0)], [(0, 2)])
    assert sorted(zip(*product.batched, strict=True)) in ([(0, 1)], [(1, 0)])


@pytest.mark.parametrize("places", [(2, 0, 0), (1, 5)], ids=["inside", "outside"])
def test_gather(places):
    equation = equations(lambda x: x.at[jnp.asarray(places)].get(mode="fill"), X)["gather"]
    numbers = np.arange(12).reshape(3, 4)
    found = primitives.gathered(equation, numbers, np.asarray(places)[:, None], -1)
    expected = [numbers[place] if place < 3 else np.full(4, -1) for place in places]
    np.testing.assert_array_equal(found, expected)


def test_scatter_is_carried_out_on_other_numbers():
    equation = equations(lambda x: x.at[1, 2].set(9.0), X)["scatter"]
    numbers = np.arange(12).reshape(3, 4)
    (found,) = primitives.bind(equation, [jnp.asarray(numbers), jnp.asarray([1, 2]), jnp.asarray(-5)])
    expected = numbers.copy()
    expected[1, 2] = -5
    np.testing.assert_array_equal(found, expected)


class Changed:
    """An equation of a JAX that is not known here."""

    def __init__(self, equation, **params):
        self.primitive, self.invars, self.params = equation.primitive, equation.invars, params


READERS = {
    "jit": primitives.callee,
    "scan": primitives.scan,
    "reduce_sum": primitives.axes,
    "integer_pow": primitives.exponent,
    "dynamic_slice": primitives.slice_sizes,
    "iota": primitives.iota,
    "convert_element_type": primitives.new_dtype,
    "dot_general": primitives.dot_general,
    "gather": lambda equation: primitives.gathered(equation, X, X, -1),
}


@pytest.fixture(scope="module")
def of_each_kind():
    def function(x):
        y = jax.lax.dynamic_slice(x**3, (x[0, 0].astype(int), 0), (2, 2)) + x[jnp.asarray([2, 0]), :2]
        z = jax.lax.scan(lambda c, row: (c + row @ jnp.arange(2.0), None), 0.0, y)[0]
        return z + jnp.sum(jnp.clip(x, 0.0, 1.0)) + x @ jnp.arange(4.0)

    return equations(function, X)


@pytest.mark.parametrize("name", READERS)
def test_parameters_in_another_form_are_told_by_name(of_each_kind, name):
    equation = Changed(of_each_kind[name], shape_of_things=1)
    with pytest.raises(UnsupportedError, match=f"'{name}' as JAX {jax.__version__} .*found: shape_of_things"):
        READERS[name](equation)


@pytest.mark.parametrize("groups", [None, (1, 2), ((), (), ())], ids=["none", "two", "too few"])
def test_a_scan_whose_groups_do_not_fit_is_refused(of_each_kind, groups):
    class Tree:
        def unpack(self):
            return groups

    with pytest.raises(UnsupportedError, match="'scan'"):
        primitives.scan(Changed(of_each_kind["scan"], ft_in=Tree(), jaxpr=None, length=1, reverse=False))


def test_no_other_module_reads_parameters():
    folder = Path(primitives.__file__).parent
    readers = {
        path.name
        for path in folder.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr == "params"
    }
    assert readers == {"primitives.py"}


def test_moves_are_those_of_jax():
    moves = (
        lambda x: x[:, 1:3],
        lambda x: x[2, ::2],
        lambda x: x.T,
        lambda x: jnp.broadcast_to(x[:, None], (3, 5, 4)),
        lambda x: jnp.concatenate([x, x[:1]], axis=0),
        lambda x: jnp.concatenate([x, x], axis=1),
        lambda x: x.reshape(2, 6)[:, ::-1],
        lambda x: jnp.pad(x, ((1, 0), (0, 2))),
        lambda x: jnp.stack([x, x], axis=1),
        lambda x: jnp.concatenate(jnp.split(x, [1, 3], axis=1)[::-1], axis=1),
        lambda x: jnp.unstack(x, axis=1)[2],
        lambda x: jax.lax.optimization_barrier(x),
    )
    for move in moves:
        closed = jax.make_jaxpr(move)(X)
        names = {equation.primitive.name for equation in closed.jaxpr.eqns}
        values = {closed.jaxpr.invars[0]: np.asarray(X)}
        for equation in closed.jaxpr.eqns:
            given = [np.asarray(a.val) if isinstance(a, core.Literal) else values[a] for a in equation.invars]
            if primitives.callee(equation) is not None:
                results = evaluated(primitives.callee(equation), *given)
            else:
                results = primitives.moved(equation, given)
            values.update(zip(equation.outvars, map(np.asarray, results), strict=True))
        assert names
        np.testing.assert_array_equal(values[closed.jaxpr.outvars[0]], move(X))


def test_running_sum():
    assert primitives.running(equations(lambda x: jax.lax.cumsum(x, axis=1, reverse=True), X)["cumsum"]) == (1, True)


@pytest.mark.parametrize(
    ("left", "lower", "transposed", "unit"), [(True, True, False, True), (False, False, True, False)]
)
def test_triangular_solve(left, lower, transposed, unit):
    def solve(a, b):
        return jax.lax.linalg.triangular_solve(
            a, b, left_side=left, lower=lower, transpose_a=transposed, unit_diagonal=unit
        )

    found = primitives.triangular(equations(solve, jnp.eye(3), jnp.eye(3))["triangular_solve"])
    assert found == primitives._Triangular(left=left, lower=lower, transposed=transposed, unit_diagonal=unit)


def test_solver_of_linear_equations():
    A, b = jnp.array([[2.0, 1.0], [1.0, 3.0]]), jnp.array([3.0, 5.0])
    of = equations(jnp.linalg.solve, A, b)["custom_linear_solve"]
    solve, taken = primitives.solver(of)
    shapes = [atom.aval.shape for atom in of.invars]
    assert [v.aval.shape for v in solve.jaxpr.invars] == [shapes[i] for i in taken]
    factors, _, order = jax.lax.linalg.lu(A)
    (found,) = evaluated(solve, factors, order, b.reshape(shapes[taken[-1]]))
    np.testing.assert_allclose(np.ravel(found), np.linalg.solve(A, b))


def test_branches():
    of = equations(lambda x: jax.lax.cond(x > 0.0, lambda y: y + 1.0, lambda y: y - 1.0, x), 0.5)["cond"]
    assert [float(evaluated(branch, 0.5)[0]) for branch in primitives.branches(of)] == [-0.5, 1.5]


def test_gather_along_one_axis():
    of = equations(lambda x, i: x[:, i], X, jnp.array([1, 2]))["gather"]
    assert primitives.gathered_axis(of) == 1
    assert primitives.gathered_offsets(of) == (0,)
    assert primitives.gathered_axis(equations(lambda x, i: x[i, i], X, jnp.array([1, 2]))["gather"]) is None


def test_places_outside_an_array():
    def taken(**how):
        return equations(lambda x, i: jnp.take(x, i, **how), X[0], jnp.array([1, 9]))["gather"]

    assert primitives.gathered_outside(taken(mode="clip")) is None
    assert primitives.gathered_outside(taken(mode="fill", fill_value=-1.0)) == -1.0
    assert np.isnan(primitives.gathered_outside(taken()))


def test_ways_of_rounding():
    ways = jax.lax.RoundingMethod
    for way, name in ((ways.TO_NEAREST_EVEN, "round_even"), (ways.AWAY_FROM_ZERO, "round_away")):
        assert primitives.rounding(equations(lambda x, way=way: jax.lax.round(x, way), 0.5)["round"]) == name


def test_the_part_that_an_equation_stands_in():
    def parts(x):
        with jax.named_scope("sensor"), jax.named_scope("inside"):
            return jnp.sin(x)

    assert primitives.part(equations(parts, 0.5)["sin"]) == "sensor"
    assert primitives.part(equations(jnp.sin, 0.5)["sin"]) is None


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (lambda key: jax.random.bits(key, (3,), jnp.uint32), "random_bits"),
        (lambda key: jax.random.split(key, 4), "random_split"),
        (lambda key: jax.random.fold_in(key, 5), "random_fold_in"),
    ],
    ids=["bits", "split", "fold in"],
)
def test_operations_on_keys(function, name):
    key = jax.random.key(2)
    equation = equations(function, key)[name]
    inside = primitives.of_keys(equation)
    words = [jax.random.key_data(key), *([np.uint32(5)] if name == "random_fold_in" else [])]
    expected = function(key)
    expected = expected if name == "random_bits" else jax.random.key_data(expected)
    np.testing.assert_array_equal(evaluated(inside, *words)[0], expected)


def test_what_is_no_operation_on_keys_and_keys_of_another_kind():
    assert primitives.of_keys(equations(lambda x: x + 1.0, X)["add"]) is None
    key = jax.random.key(0, impl="rbg")
    with pytest.raises(UnsupportedError, match="random keys of another kind"):
        primitives.of_keys(equations(lambda key: jax.random.bits(key), key)["random_bits"])
