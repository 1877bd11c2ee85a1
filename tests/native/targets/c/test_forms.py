"""Both forms of C compute what their definitions say, to the bit, whatever they are given."""

import platform

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native.interpreter import interpret
from glucoloop.native.targets import STRICT
from glucoloop.native.targets.c.compact.arithmetic import Evaluation
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.native.targets.c.source import COMPACT, UNROLLED, trace, write_source
from glucoloop.native.targets.llvm.kernel import compile_kernel

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler: install gcc")

SAMPLES = 24
SETTINGS = ("-O0", "-O2", "-O3")
if platform.machine() == "x86_64":
    SETTINGS += ("-O3 -march=native", "-O3 -march=native -mtune=skylake-avx512")


def scalars(state, seen):
    """Something of every operation on numbers, without a loop that has a length of its own."""
    x, count, alarm = state["x"], state["count"], state["alarm"]
    y, low = seen["y"], seen["valid"]
    z = jnp.stack([jnp.tanh(y), jnp.exp(-x[0] / 40.0), jnp.expm1(x[1] * 0.01), jnp.log(jnp.abs(y))])
    z = jnp.where(low, z, x * 0.9) + jnp.sign(x) * 0.1 - jnp.maximum(x, -z) ** 2 + jnp.minimum(x, 3.0) ** 3
    matrix = jnp.array([[0.1, 0.0, 0.5, -0.2]] * 3 + [[0.0, 1.0, 0.0, 0.3]], x.dtype)
    z = jnp.clip(matrix @ z, -50.0, 50.0) + jnp.floor(y / 7.0) * 0.01 + jnp.sqrt(jnp.abs(x[::-1]))
    low = low ^ alarm | (z[0] >= z[1]) & ~jnp.isfinite(y)
    unit = jnp.asarray([0.0, 0.0, 1.0, 0.0], x.dtype)
    z = z + 1e-3 * jnp.where((z >= -20.0) & (z <= 20.0), z @ matrix.T, unit @ z)  # zeros at the ends of rows
    which = jnp.argmax(z)
    return {"x": z, "count": jnp.where(low, count + 1, which).astype(count.dtype), "alarm": low}, {
        "dose": jnp.sum(z) + jnp.max(z) * 1e-3 + jnp.where(low, 1.0, -1.0),
        "status": which,
    }


def angles(state, seen):
    """The same with rounding, remainders, angles, roots and tables."""
    after, decided = scalars(state, seen)
    x, y, low, z = state["x"], seen["y"], seen["valid"], after["x"]
    turned = (
        jnp.sin(z[0]) + jnp.cos(z[1]) + jnp.cbrt(z[2]) + jnp.arctan2(z[3], y) + jnp.sinh(z * 0.01) + jnp.cosh(1e-2 * z)
    )
    coarse = (
        jnp.round(z) + jax.lax.round(0.5 * jnp.ceil(z[0])) + jnp.mod(z[1], 0.3) + jax.nn.sigmoid(z[2]) + jnp.tan(z[3])
    )
    number = jnp.floor(z[0]).astype(jnp.int32)
    place = jnp.where(low, number % 7, number // 3 - jax.lax.rem(number, jnp.int32(4)))
    table = jnp.asarray([0.5, 1.5, 4.0, 2.0], x.dtype)
    z = z + 1e-2 * (turned + coarse) + jnp.take(table, place, mode="clip") + jnp.interp(y, table[:3], table[1:])
    z = jnp.where(jnp.isfinite(z), z, 0.25)
    return {**after, "x": z}, decided


def loops(state, seen):
    """The same with what only the compact form can do: long loops, linear equations, choices, places that vary."""
    after, decided = scalars(state, seen)
    z = after["x"]
    A = jnp.outer(z, z) * 1e-3 + jnp.diag(jnp.arange(1.0, 5.0, dtype=z.dtype)) + jnp.tri(4, dtype=z.dtype)
    solved = jnp.linalg.solve(A, jnp.stack([z, state["x"]], axis=1))

    def round_(carry, row):
        total, kept, n = carry
        total = 0.9 * total + row * solved[:, 0]
        return (total, kept + total[0], n + 1), (total[1:3], n)

    start = (jnp.zeros(4, z.dtype), z[2], state["count"])
    (total, kept, _), (rows, numbers) = jax.lax.scan(round_, start, jnp.linspace(0.0, 1.0, 70, dtype=z.dtype))
    (_, back), _ = jax.lax.scan(lambda c, r: ((c[1], c[0] + r[0]), None), (kept, total[3]), rows, reverse=True)
    chosen = jax.lax.cond(seen["valid"], lambda a: (a @ a, kept), lambda a: (a.T - 1.0, back), A)
    place = jnp.clip(decided["status"], 0, 2)
    window = jax.lax.dynamic_slice(jnp.cumsum(z), (place,), (2,))
    x = chosen[0][:, 1].at[1:3].set(window).at[3].add(chosen[1] * 1e-3) * 0.1 + jnp.min(solved) * 0.01
    x = jnp.where(jnp.all(jnp.isfinite(x)), x, 0.5)
    taken = z[jnp.array([0, 2, 2, 1])]
    decided = {**decided, "dose": decided["dose"] + jnp.sum(taken) + jnp.sum(numbers) * 1e-6}
    return {**after, "x": x}, decided


def matrices(state, seen):
    """Matrices large enough for the functions that take several columns at once, and choices in place."""
    rng = np.random.default_rng(3)
    known, wide = (jnp.asarray(rng.normal(size=shape), state["x"].dtype) for shape in ((11, 12), (11, 23)))
    x = jnp.clip(jnp.concatenate([state["x"], jnp.where(seen["valid"], seen["y"], 1.0)[None] * jnp.arange(7.0)]), -9, 9)
    A = 0.1 * jnp.outer(x, x[::-1]) + 6.0 * jnp.eye(11, dtype=x.dtype)
    tall = A.T @ known  # its columns follow one another, those of its transpose do not
    solved = jnp.linalg.solve(A, jnp.concatenate([wide, A @ A.T, (tall @ known.T).T], axis=1)) @ jnp.ones(45, x.dtype)

    def round_(carry, entry):
        square, past, unused = carry
        small, low = jnp.abs(entry) < 3.0, jnp.min(square)
        square, past = jax.lax.cond(
            small, lambda s, p: (s, p + s[0]), lambda s, p: (1e-2 * s @ s, s[1] - p), square, past
        )
        return (square, past, unused * low), low

    (square, past, _), lows = jax.lax.scan(round_, (A, x, x[0]), x)
    x = jnp.clip(jnp.where(jnp.isfinite(solved + past), solved + past, 0.5), -9.0, 9.0)[:4] + 1e-3 * square[3, :4]
    return {**state, "x": x}, {"dose": jnp.sum(solved) + jnp.sum(lows) + jnp.max(square), "status": state["count"]}


def init(seen):
    y = seen["y"]
    return {"x": jnp.full(4, y), "count": jnp.asarray(0), "alarm": jnp.asarray(False)}


def traced(step, precision):
    seen = {"y": jax.ShapeDtypeStruct((), np.dtype(precision)), "valid": jax.ShapeDtypeStruct((), np.dtype(bool))}
    return trace(init, step, seen, precision)


def looped(state, seen):
    """A loop of many rounds, one until something is small, and what the first takes and gives row by row."""

    def one(carried, row):
        x, high = carried
        x = 0.9 * jnp.sin(x) + row
        return (x, high ^ (x[0] > 0.1)), (x[1], high)

    rows = jnp.linspace(0.0, 1.0, 70, dtype=seen["y"].dtype) * seen["y"]
    (x, alarm), (each, highs) = jax.lax.scan(one, (state["x"], state["alarm"]), rows)
    half, count = jax.lax.while_loop(
        lambda c: (c[0] > 1e-2) & (c[0] < 1e6), lambda c: (c[0] * 0.5, c[1] + 1), (jnp.abs(seen["y"]), state["count"])
    )
    x = jnp.where(jnp.isfinite(x), x, 0.25)
    return {**state, "x": x, "alarm": alarm}, {"dose": jnp.sum(each) + half + jnp.sum(highs), "status": count}


def observations(precision):
    """Readings with nonsense among them, in the order of the leaves: valid, y."""
    rng = np.random.default_rng(7)
    readings = rng.normal(100.0, 80.0, SAMPLES)
    readings[::9] = np.resize([np.nan, np.inf, -np.inf, 1e30, -0.0, 1e-40], readings[::9].shape)
    valid = rng.random(SAMPLES) < 0.7
    return [[np.asarray(v), np.asarray(y, precision)] for v, y in zip(valid, readings, strict=True)][::-1]


def equal(here, there):
    """The same bits, but for those of what is not a number."""
    for a, b in zip(here, there, strict=True):
        a, b = np.asarray(a, float), np.asarray(b, float)
        same = (a == b) & (np.signbit(a) == np.signbit(b)) | (a != a) & (b != b)
        assert same.all(), (a, b)


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("step", [scalars, angles, loops, matrices])
def test_compact_is_its_arithmetic(step, precision):
    of = traced(step, precision)
    library = Library(write_source(of, ["A test"], COMPACT), precision)
    wake, go_on = Evaluation(of.init, precision), Evaluation(of.step, precision)
    state = None
    for seen in observations(precision):
        if state is None:
            state = wake(seen)
            equal(library.init(seen), state)
        after, decided = library.step(state, seen)
        wanted = go_on([*state, *seen])
        equal([*after, *decided], wanted)
        state = wanted[: len(state)]


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("step", [scalars, angles, looped])
def test_unrolled_is_the_program_and_native_code(step, precision):
    of = traced(step, precision)
    source = write_source(of, ["A test"], UNROLLED)
    library, (_, lowered) = Library(source, precision), source.lowered
    states = []
    after = library.init(observations(precision)[0])
    for seen in observations(precision):
        state = after
        states.append((state, seen))
        after, decided = library.step(state, seen)
        flat = [np.concatenate([np.ravel(x) for x in leaves]).astype(precision)[:, None] for leaves in (state, seen)]
        carry, outputs = interpret(lowered, carry=flat[0], own=flat[1])
        equal([np.concatenate([np.ravel(x) for x in (*after, *decided)])], [np.concatenate([carry, outputs])[:, 0]])
    kernel = compile_kernel(lowered, products=STRICT)
    columns = kernel.padded(SAMPLES)

    def side_by_side(rows):
        table = np.zeros((len(rows[0]), columns), precision)
        table[:, :SAMPLES] = np.array(rows, dtype=precision).T
        return table

    carry = side_by_side([np.concatenate([np.ravel(x) for x in state]) for state, _ in states])
    own = side_by_side([np.concatenate([np.ravel(x) for x in seen]) for _, seen in states])[None]
    outputs = np.zeros((1, kernel.sizes["outputs"], columns), precision)
    nobody = np.zeros((0, columns), precision)
    wanted = interpret(lowered, carry=carry, own=own[0])
    kernel.run(nobody, carry, kernel.by_vector(own), np.zeros((1, 0), precision), outputs)
    equal([carry, outputs[0]], wanted)


def tables(state, seen):
    """Known rows in which some numbers are alike, and zeros follow."""
    rows = [[1.0] * ones + [0.0] * (25 - ones) for ones in range(1, 25)]
    rows += [[1.0, *[0.0] * 7, *row[:17]] for row in rows]
    return {**state, "x": state["x"] + seen["y"]}, {f"row{i}": jnp.asarray(row) for i, row in enumerate(rows)}


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("setting", SETTINGS)
def test_tables_are_copied_whole_however_they_are_compiled(setting, precision):
    of = traced(tables, precision)
    library = Library(write_source(of, ["A test"], COMPACT), precision, setting)
    seen = observations(precision)[0]
    state = library.init(seen)
    wanted = Evaluation(of.step, precision)([*state, *seen])
    after, decided = library.step(state, seen)
    for here, there in zip((*after, *decided), wanted, strict=True):
        equal([here], [there])


def test_auto_takes_loops_to_the_compact_form():
    assert write_source(traced(scalars, "float32"), ["A test"]).form == UNROLLED
    assert write_source(traced(loops, "float32"), ["A test"]).form == COMPACT
    with pytest.raises(ValueError, match="the form is 'tiny'; the known ones are: auto, unrolled, compact"):
        write_source(traced(scalars, "float32"), ["A test"], "tiny")


@pytest.mark.long
def test_a_saved_state_comes_back_and_a_damaged_one_does_not():
    of = traced(scalars, "float64")
    library = Library(write_source(of, ["A test"], COMPACT), "float64")
    state = library.init([np.asarray(True), np.asarray(90.0)])
    record = library.saved(state)
    equal(library.restored(record), state)
    for place in (0, 5, 17, len(record) - 1):
        damaged = bytearray(record)
        damaged[place] ^= 0x10
        assert library.restored(bytes(damaged)) is None
    other = Library(write_source(traced(loops, "float64"), ["A test"], COMPACT), "float64")
    assert other.restored(record) is None
