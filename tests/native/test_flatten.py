"""Native code against JAX, operation by operation and for random small functions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.native.lower import lower
from glucoloop.native.primitives import UnsupportedError

NOT = [np.nan, np.inf, -np.inf]
ROWS = np.array(
    [
        [1.5, -2.0, np.nan, 0.0, 7.0, np.inf, 0.25, -np.inf],
        [2.5, -2.0, 1.0, -0.0, np.nan, 3.0, 0.5, -1.0],
        [-1.0, 4.0, 0.5, 2.0, np.nan, np.inf, -0.5, 9.0],
    ]
)
FINITE = np.random.default_rng(3).uniform(-4.0, 4.0, (3, 4, 9))
A, B, C = (np.random.default_rng(4).normal(size=shape) for shape in ((4, 3), (3, 5), (2, 3, 4)))


def both_ways(x):
    return [x[0] < x[1], x[0] <= x[1], x[0] > x[1], x[0] >= x[1], x[0] == x[1], x[0] != x[1]]


def rounds(x):
    def one(carry, entry):
        total, flag = carry
        total = jnp.where(flag, total + entry, total - 2.0 * entry)
        return (total, total > 0.0), (total, flag)

    return jax.lax.scan(one, (x[0, 0], x[0, 0] < 1.0), x[1])


SAME = {
    "arithmetic": lambda x: [x[0] + x[1], x[0] - x[1], x[0] * x[1], x[0] / x[1], -x[0], abs(x[0])],
    "comparisons": both_ways,
    "floor and root": lambda x: [jnp.floor(x), jnp.sqrt(x), jnp.sign(x), jnp.square(x), jnp.isfinite(x)],
    "extremes and what is no number": lambda x: [
        jnp.maximum(x[0], x[1]),
        jnp.minimum(x[0], x[1]),
        jnp.maximum(x[0], 1.0),
        jnp.minimum(1.0, x[0]),
        jnp.maximum(x[0], jnp.nan),
        jnp.clip(x[0], -1.0, 2.0),
        jnp.clip(x[0], x[1], 5.0),
        jax.lax.clamp(0.0, x[1], 2.0),
    ],
    "largest and minimum of several": lambda x: [x.max(), x.min(), x.sum(), jnp.max(x, axis=0), jnp.nanmax(x)],
    "where the largest is": lambda x: [
        jnp.argmax(x),
        jnp.argmax(x > 1.0),
        jnp.argmax(x, axis=0),
        jnp.argmax(jnp.stack([jnp.asarray(0.3), jnp.asarray(0.9), x[0]])),
    ],
    "choice": lambda x: [
        jnp.where(jnp.isnan(x), -7.0, x),
        jnp.where(x > 0.0, x, jnp.nan),
        jnp.select([x[0] > 1.0, x[1] > 1.0, x[2] > 1.0], [10, 20, 30], 40),
        jax.lax.select_n((x[0] > 0.0).astype(int) + (x[1] > 0.0), x[0], x[1], x[2]),
    ],
    "truths": lambda x: [
        jnp.any(x > 0.0),
        jnp.all(x > 0.0),
        (x[0] > 0.0) & ~(x[1] > 0.0) | (x[2] > 1.0),
        (x[0] > 0.0) ^ (x[1] > 0.0),
        (x[0] > 0.0) == (x[1] > 0.0),
        (x > 0.0).astype(float).sum(),
        (x > 0.0).astype(int) * 3 - 1,
        x.astype(bool),
    ],
    "constants": lambda x: [x + jnp.asarray([1.0, 2.0, 3.0]), 3.0 - x, x / 3.0],
    "powers": lambda x: [x**2, x**3, x**-1, x**0],
    "not a number anywhere": lambda x: [jnp.nan * x, x + jnp.inf, jnp.where(x > 0.0, jnp.inf, -jnp.inf)],
}


@pytest.mark.parametrize("function", SAME.values(), ids=SAME.keys())
def test_operations_on_numbers_of_all_kinds(native, by_jax, function):
    with np.errstate(all="ignore"):
        found, expected = native(function, ROWS)(ROWS), by_jax(function, ROWS)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        # a quotient by a constant is a product
        np.testing.assert_allclose(a, np.asarray(b, float), rtol=4e-16)


MOVES = {
    "slices": lambda x: [x[1:, ::2], x[:, -1], x[::-1], x[..., None], jnp.flip(x, 1)],
    "shapes": lambda x: [x.reshape(4, 3), x.T, x.ravel()[3:7], jnp.expand_dims(x, 1), jnp.squeeze(x[:1])],
    "together": lambda x: [jnp.concatenate([x[1:], x[:1]]), jnp.stack([x[0], x[1]], -1), jnp.tile(x[0], 2), *x],
    "splits": lambda x: jnp.split(x, 2, axis=1),
    "gather": lambda x: [x[jnp.array([2, 0, 0])], x[1, jnp.array([3, -1])], jnp.take(x, jnp.array([1, 1]), axis=1)],
    "gather beyond the end": lambda x: [x[jnp.clip(jnp.arange(5), 0, 2)], x[0].at[jnp.array([1, 9])].get(mode="clip")],
    "scatter": lambda x: [x.at[0].set(x[1]), x.at[1, 2].set(9.0), x.at[:, 1:3].set(0.0), x.at[7].set(1.0)],
    "dynamic slice": lambda x: [jax.lax.dynamic_slice(x, (1, 2), (2, 2)), jax.lax.dynamic_index_in_dim(x, 2)],
    "numbers in order": lambda x: [x * jnp.arange(4), jnp.eye(3) @ x, jnp.tril(x), x + jnp.linspace(0.0, 1.0, 4)],
    "edges": lambda x: [jnp.pad(x, ((1, 0), (0, 2)), constant_values=7.0), jnp.pad(x, 1, mode="edge")],
    "broadcast": lambda x: [x[0] + x[:, :1], jnp.broadcast_to(x[0], (2, 4)), jnp.full((2,), 3.0)],
}


@pytest.mark.long
@pytest.mark.parametrize("function", MOVES.values(), ids=MOVES.keys())
def test_numbers_that_are_moved_about(native, by_jax, function):
    found, expected = native(function, FINITE)(FINITE), by_jax(function, FINITE)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-15)


PRODUCTS = {
    "matrices": lambda x: [A @ x, x.T @ B, x @ x.T, jnp.dot(x[0], x[1]), jnp.outer(x[0], x[1])],
    "several axes": lambda x: [jnp.tensordot(C, x, 2), jnp.tensordot(C, x, ((2, 1), (1, 0)))],
    "batches": lambda x: [jnp.einsum("bij,ij->bi", C, x), jnp.einsum("ij,kj,il->kl", x, x, x), jnp.matmul(C, x.T)],
    "outer": lambda x: [jnp.multiply.outer(x[0], x[1]), jnp.vdot(x, x)],
}


@pytest.mark.parametrize("function", PRODUCTS.values(), ids=PRODUCTS.keys())
def test_products_of_arrays(native, by_jax, function):
    found, expected = native(function, FINITE)(FINITE), by_jax(function, FINITE)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


LOOPS = {
    "scan": rounds,
    "backwards": lambda x: jax.lax.scan(lambda c, e: (c * 0.5 + e, c), x[0], x, reverse=True),
    "without entries": lambda x: jax.lax.scan(lambda c, _: (c * 0.5 + 1.0, None), x, None, length=64)[0],
    "within a loop": lambda x: jax.lax.fori_loop(0, 5, lambda i, c: c + i * x[1], x[0]),
    "calls": lambda x: [jax.jit(lambda y: y + x[0])(x), jax.nn.relu(x)],
    "running sums": lambda x: [jnp.cumsum(x, axis=0), jnp.cumsum(x, axis=1), jax.lax.cumsum(x, axis=1, reverse=True)],
    "remat": lambda x: jax.checkpoint(lambda y: y * y)(x),
    "derivative": lambda x: [jax.grad(lambda y: (y**3).sum())(x), jax.jacfwd(lambda y: y * y[0])(x[0])],
}


@pytest.mark.parametrize("function", LOOPS.values(), ids=LOOPS.keys())
def test_loops_and_calls(native, by_jax, function):
    found, expected = native(function, FINITE)(FINITE), by_jax(function, FINITE)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, np.asarray(b, float), rtol=1e-13, atol=1e-14)


def test_a_product_with_a_constant_zero_is_zero(native):
    np.testing.assert_array_equal(native(lambda x: jnp.zeros((2, 3)) @ x, ROWS)(ROWS), np.zeros((2, 8)))


TABLE = jnp.array([0.0, 1.0, 3.0, 4.5, 4.5, 9.0])
VALUES = jnp.array([2.0, -1.0, 5.0, 0.0, 7.0, 7.5])
NEAR = np.concatenate([[np.nan, -0.0, 0.49999999999999994, 2.0**29], np.arange(-9.0, 12.0, 0.25), np.asarray(TABLE)])
FAR = np.array([2.0**51 + 0.5, -(2.0**52) - 1.0, 1e300, *NOT])
CHOICES = {
    "rounding": lambda x: [jnp.round(x), jax.lax.round(x), jnp.ceil(x), jnp.trunc(x)],
    "made whole": lambda x: [x.astype(int), x.astype(int).astype(float), jnp.floor(jnp.clip(x, -9, 9)).astype(int)],
    "remainders": lambda x: [jnp.mod(x, 3.0), jax.lax.rem(x, 0.7), x % -2.5, jnp.fmod(3.0, x), x // 3.0],
    "of whole numbers": lambda x: [x.astype(int) // 3, x.astype(int) % -7, jax.lax.div(7, x.astype(int))],
    "by zero": lambda x: [jax.lax.div(x.astype(int), 0 * x.astype(int)), jax.lax.rem(x.astype(int), 0 * x.astype(int))],
    "one of several functions": lambda x: [
        jax.lax.cond(x > 0.0, lambda: (x, 1.0), lambda: (-x, 2.0)),
        jax.lax.switch(x.astype(int), [lambda y: y + 1.0, lambda y: y * 2.0, lambda y: 0.0 * y], x),
    ],
    "places": lambda x: [
        VALUES[x.astype(int)],
        jnp.take(VALUES, x.astype(int)),
        jnp.take(VALUES, jnp.stack([x, x + 1.0]).astype(int), mode="clip"),
        jnp.take(VALUES.reshape(3, 2), x.astype(int), axis=1, fill_value=-1.0),
        jax.lax.dynamic_slice(VALUES, (x.astype(int),), (3,)),
        jax.lax.dynamic_slice(VALUES.reshape(3, 2), (x.astype(int), 0), (1, 2)),
    ],
    "tables": lambda x: [jnp.interp(x, TABLE, VALUES), jnp.interp(x, TABLE, VALUES, left=-3.0)],
    "places in order": lambda x: [jnp.searchsorted(TABLE, x, side=side) for side in ("left", "right")],
}


@pytest.mark.parametrize("function", CHOICES.values(), ids=CHOICES.keys())
def test_whole_numbers_and_choices_are_those_of_jax_to_the_bit(native, by_jax, function):
    x = np.concatenate([NEAR, FAR]) if function is CHOICES["rounding"] else NEAR
    found, expected = native(function, x, products="strict", as_written=True)(x), by_jax(function, x)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, np.asarray(b, float))


def test_numbers_made_whole_stay_within_bounds(native):
    far = native(lambda x: x.astype(int), FAR)(FAR)
    np.testing.assert_array_equal(far, 2.0**30 * np.array([1.0, -1.0, 1.0, 0.0, 1.0, -1.0]))


def test_a_remainder_that_needs_more_digits_is_not_a_number(native):
    assert np.isnan(native(lambda x: jax.lax.rem(x, 0.3), FAR)(FAR)).all()


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(-1e9, 1e9), st.floats(-1e4, 1e4)), min_size=1, max_size=20))
def test_a_remainder_is_exact(native, pairs):
    x, y = np.array(pairs).T
    y = np.where(np.abs(y) < 1e-5, 1.0, y)
    for precision in ("float64", "float32"):
        a, b = x.astype(precision), y.astype(precision)
        small = np.abs(a / b) < 2e6
        found, truth = native(jax.lax.rem, x, y, precision=precision)(a, b)[small], np.fmod(a, b)[small]
        np.testing.assert_array_equal(found, truth)
        np.testing.assert_array_equal(np.signbit(found), np.signbit(truth))


REFUSED = {
    "the operation 'sort'": jnp.sort,
    "the operation 'cumprod'": lambda x: jnp.cumprod(x, axis=0),
    "a loop of 0 rounds": lambda x: jax.lax.scan(lambda c, e: (c + 1.0, e), x, None, length=0)[0],
    "a choice among 300 places in an array .at most 256.": lambda x: jnp.arange(300.0)[jnp.argmax(x[:, 0])],
    "a place in an array that depends on what happens": lambda x: x.at[jnp.argmax(x[:, 0])].set(0.0),
    "a place outside an array": lambda x: x.at[jnp.array([5])].get(mode="fill", fill_value=0.0),
    "bits of whole numbers": lambda x: jnp.argmax(x) & 3,
    "an order of truths": lambda x: jnp.maximum(x > 0.0, x < 1.0),
}


@pytest.mark.parametrize(("told", "function"), REFUSED.items(), ids=REFUSED.keys())
def test_what_straight_line_code_cannot_do_is_refused(native, told, function):
    with pytest.raises(UnsupportedError, match=told):
        native(function, FINITE)


def test_a_refusal_says_in_whose_code_the_operation_stands(native):
    def step(x):
        with jax.named_scope("controller"):
            y = jnp.tanh(x)
        with jax.named_scope("sensor"):
            return jax.jit(lambda z: jax.lax.scan(lambda c, _: (jnp.sort(c), None), z, None, length=2)[0])(y)

    with pytest.raises(UnsupportedError, match=r"^the operation 'sort' in the sensor$"):
        native(step, FINITE)


STEPS = st.one_of(
    st.tuples(st.sampled_from(["add", "sub", "mul", "max", "min", "where"]), st.integers(0, 9), st.integers(0, 9)),
    st.tuples(st.sampled_from(["shift", "flip", "sum", "largest", "halve", "set", "scan", "mean"]), st.integers(0, 9)),
    st.tuples(st.sampled_from(["plus", "times"]), st.integers(0, 9), st.sampled_from([-2.0, 0.5, 1.0, 3.0])),
)


def from_steps(steps):
    """A function of two arrays of four numbers; of short binary fractions all it does is exact."""

    def function(x, y):
        made = [x, y]
        for name, i, *rest in steps:
            a = made[i % len(made)]
            b = made[rest[0] % len(made)] if rest and isinstance(rest[0], int) else None
            made.append(
                {
                    "add": lambda a=a, b=b: a + b,
                    "sub": lambda a=a, b=b: a - b,
                    "mul": lambda a=a, b=b: jnp.clip(a, -4.0, 4.0) * jnp.clip(b, -4.0, 4.0),
                    "max": lambda a=a, b=b: jnp.maximum(a, b),
                    "min": lambda a=a, b=b: jnp.minimum(a, b),
                    "where": lambda a=a, b=b: jnp.where(a < b, b, jnp.where(jnp.isnan(a), 1.0, a)),
                    "shift": lambda a=a: jnp.concatenate([a[1:], a[:1]]),
                    "flip": lambda a=a: a[::-1] + a[jnp.array([0, 0, 3, 1])],
                    "sum": lambda a=a: jnp.full(4, a.sum()),
                    "largest": lambda a=a: jnp.argmax(a) + jnp.zeros(4),
                    "halve": lambda a=a: a / 2.0,
                    "set": lambda a=a: a.at[2].set(a[0] - 1.0),
                    "scan": lambda a=a: jax.lax.scan(lambda c, e: (jnp.where(e > 0.0, c + e, -c), c), a[0], a)[1],
                    "mean": lambda a=a: jnp.eye(4)[::-1] @ jnp.where(jnp.isfinite(a), a, 0.0),
                    "plus": lambda a=a, rest=rest: a + rest[0],
                    "times": lambda a=a, rest=rest: a * rest[0],
                }[name]()
            )
        return made[2:]

    return function


@settings(max_examples=15)
@given(st.lists(STEPS, min_size=3, max_size=12), st.integers(0, 1000))
def test_random_functions_come_to_the_same_to_the_bit(native, by_jax, steps, seed):
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-8, 9, (2, 4, 9)) / 4.0
    x[rng.integers(4), rng.integers(9)] = rng.choice(NOT)
    function = from_steps(steps)
    with np.errstate(all="ignore"):
        for a, b in zip(native(function, x, y)(x, y), by_jax(function, x, y), strict=True):
            np.testing.assert_array_equal(a, np.asarray(b))


KEYS = jax.random.split(jax.random.key(7), 5)


def noisy(carry, own, rng):
    """Draws of several kinds, some of one key, mixed with what happens."""
    key, index = rng
    here = jax.random.fold_in(key, index)
    one, two = jax.random.split(here)
    noise = jnp.clip(1.7 * jax.random.normal(one), -2.0, 2.0)
    lost = jax.random.bernoulli(two, 0.3)
    several = jax.nn.relu(jax.random.uniform(key, (3,)) + jnp.asarray([0.0, -0.5, 1.0]))
    reading = jnp.where(lost, carry, own + noise)
    return reading, (reading, lost, several * own, noise)


def test_random_numbers_are_those_that_jax_draws_for_one_person():
    def step(person, carry, own, shared, rng):
        del person, shared
        return noisy(carry, own, rng)

    number = jnp.zeros(())
    lowered = lower(step, (), number, number, (), (KEYS[0], jnp.zeros((), int)))
    for key in KEYS:
        for index in (0, 3):
            _, (_, lost, several, noise) = noisy(number, jnp.ones(()), (key, jnp.asarray(index)))
            wanted = [np.asarray(w) for w in lowered.drawing(key, jnp.asarray(index))]
            assert sorted(np.concatenate([w.ravel() for w in wanted]).tolist()) == pytest.approx(
                sorted([float(lost), *several.tolist(), float(noise)]), abs=0.0
            )
    assert lowered.layout.sizes["own"] == 1 + 5


def test_random_numbers_may_be_made_numbers_of_another_kind():
    def step(person, carry, own, shared, rng):
        del person, shared
        return carry, own + jax.random.randint(rng, (), 0, 9)

    drawing = lower(step, (), jnp.zeros(()), jnp.zeros(()), (), KEYS[0]).drawing
    assert float(drawing(KEYS[1])[0]) == int(jax.random.randint(KEYS[1], (), 0, 9))


def test_drawing_many_at_once_draws_the_same():
    def step(person, carry, own, shared, rng):
        del person, own, shared
        return carry, jax.random.normal(jax.random.fold_in(*rng), (2,))

    drawing = lower(step, (), jnp.zeros(()), (), (), (KEYS[0], jnp.zeros((), int))).drawing
    index = jnp.arange(4)
    (many,) = jax.jit(jax.vmap(jax.vmap(drawing, in_axes=(0, None), out_axes=-1), in_axes=(None, 0)))(KEYS, index)
    assert many.shape == (4, 2, 5)
    one = np.stack([[jax.random.normal(jax.random.fold_in(key, i), (2,)) for key in KEYS] for i in range(4)]).transpose(
        0, 2, 1
    )
    np.testing.assert_array_equal(many, one)


@pytest.mark.parametrize(
    ("told", "function"),
    [
        (
            "random numbers of type int64",
            lambda key, x: jnp.argmax(jnp.stack([x, -x])) < jax.random.randint(key, (), 0, 2),
        ),
        ("random numbers of type key", lambda key, x: jax.lax.scan(lambda c, k: (c, c), x, jax.random.split(key))[0]),
    ],
    ids=["whole", "keys"],
)
def test_a_random_value_that_is_no_number_is_refused(told, function):
    def step(person, carry, own, shared, rng):
        del person, shared
        return carry, function(rng, own)

    with pytest.raises(UnsupportedError, match=told):
        lower(step, (), jnp.zeros(()), jnp.zeros(()), (), KEYS[0])
