"""Random numbers in words: the bits that JAX draws, and the numbers that are made of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.native.interpreter import interpret
from glucoloop.native.lower import lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.program import SAMPLE, WORD, Program
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.native.words import _WordFlattener, lower_drawing

PEOPLE = 61
KEYS = jax.random.split(jax.random.key(11), PEOPLE)
WORDS = np.asarray(jax.random.key_data(KEYS))
SAMPLES, FIRST = 5, 7


def drawing_of(function):
    """The drawing of a loop whose outputs are what is drawn from the key and the number of a sample."""

    def step(person, carry, own, shared, rng):
        del person, own, shared
        return carry, function(*rng)

    return lower(step, (), jnp.zeros(()), (), (), (KEYS[0], jnp.zeros((), int))).drawing


def by_kernel(lowered, products="fused", vectors=1):
    kernel = compile_kernel(lowered, products=products, vectors=vectors)
    columns = kernel.padded(PEOPLE)
    person, index = np.zeros((2, columns)), np.full((1, columns), float(FIRST))
    person[:, :PEOPLE] = WORDS.T
    drawn = np.empty((SAMPLES, kernel.sizes["outputs"], columns))
    kernel.run(person, index, kernel.by_vector(np.zeros((SAMPLES, 0, columns))), np.zeros((SAMPLES, 0)), drawn)
    return drawn[..., :PEOPLE]


def by_jax(drawing):
    one = jax.vmap(jax.vmap(drawing, in_axes=(0, None), out_axes=-1), in_axes=(None, 0))
    parts = jax.jit(one)(KEYS, FIRST + jnp.arange(SAMPLES))
    return np.concatenate([np.asarray(part, float).reshape(SAMPLES, -1, PEOPLE) for part in parts], axis=1)


def of_bits(key, index):
    """Words and parts of words, as numbers, of keys that are made in every way."""
    here = jax.random.fold_in(key, index)
    one, two, three = jax.random.split(here, 3)
    words = jax.random.bits(jnp.stack([one, two])[1], (3,), jnp.uint32)
    own = jax.random.fold_in(jax.random.fold_in(three, 0x50554D50), 2**32 - 1)
    several = jax.random.bits(own, (2, 2), jnp.uint32)
    mixed = ((words << 3) ^ (words >> 30) | jnp.uint32(5)) & jnp.uint32(0xF0F0F0F5)
    return [x.astype(float) for x in (words, several, mixed, words + several[0, 0], jax.random.key_data(own))]


def of_numbers(key, index):
    here = jax.random.fold_in(key, index)
    one, two = jax.random.split(here)
    return jax.random.uniform(one, (2, 3)), jax.random.bernoulli(two, 0.3), jax.random.uniform(two, (), minval=-3.0)


@pytest.mark.long
@pytest.mark.parametrize("function", [of_bits, of_numbers])
def test_what_is_drawn_is_what_jax_draws_to_the_bit(function):
    drawing = drawing_of(function)
    lowered, expected = lower_drawing(drawing, KEYS[0], jnp.zeros((), int)), by_jax(drawing)
    np.testing.assert_array_equal(by_kernel(lowered), expected)
    np.testing.assert_array_equal(by_kernel(lowered, vectors=3), expected)
    index = np.full((1, PEOPLE), float(FIRST))
    after, drawn = interpret(lowered, person=WORDS.T, carry=index, own=np.zeros((0, PEOPLE)))
    np.testing.assert_array_equal(drawn, expected[0])
    np.testing.assert_array_equal(after, index + 1.0)


@pytest.mark.long
@pytest.mark.parametrize("products", ["fused", "strict"])
def test_normal_numbers_are_those_of_jax_to_rounding(products):
    drawing = drawing_of(lambda key, index: jax.random.normal(jax.random.fold_in(key, index), (40,)))
    lowered = lower_drawing(drawing, KEYS[0], jnp.zeros((), int), as_written=products == "strict")
    np.testing.assert_allclose(by_kernel(lowered, products), by_jax(drawing), rtol=4e-15, atol=0.0)


def inverse_of_erf(x):
    def step(person, carry, own, shared, rng):
        del person, shared, rng
        return carry, jax.lax.erf_inv(own)

    lowered = lower(step, (), jnp.zeros(()), jnp.zeros(()), (), flattener=_WordFlattener)
    return interpret(lowered, carry=np.zeros((1, x.size)), own=x[None])[1][0]


def test_the_inverse_of_the_error_function():
    size = 1.0 - 10.0 ** np.linspace(-9.0, 0.0, 2001)[:-1]
    x = np.concatenate([-size, size, 10.0 ** np.linspace(-300.0, -1.0, 200), [0.0]])
    truth = np.where(np.abs(x) > 0.5, np.sign(x) * scipy.special.erfcinv(1.0 - np.abs(x)), scipy.special.erfinv(x))
    # 1 - x^2 is rounded, as by JAX
    allowed = 1e-15 + 1e-16 / (1.0 - x * x)
    assert (np.abs(inverse_of_erf(x) - truth) <= allowed * np.abs(truth)).all()
    ends = np.array([1.0 - 2.0**-53, 2.0**-53 - 1.0])
    np.testing.assert_allclose(inverse_of_erf(ends), np.asarray(jax.lax.erf_inv(ends)), rtol=1e-15)


@pytest.mark.parametrize(
    ("told", "function"),
    [
        ("converted from int64 to uint64", lambda key: jax.random.randint(key, (), 0, 9) * 1.0),
        ("bits of uint32 as float32", lambda key: jax.random.uniform(key, dtype=jnp.float32) * 1.0),
        ("several keys at once", lambda key: jax.vmap(jax.random.uniform)(jax.random.split(key, 3))),
    ],
    ids=["whole", "single", "keys"],
)
def test_what_is_not_made_of_words_is_refused(told, function):
    drawing = drawing_of(lambda key, index: function(jax.random.fold_in(key, index)))
    with pytest.raises(UnsupportedError, match=told):
        lower_drawing(drawing, KEYS[0], jnp.zeros((), int))


@pytest.mark.long
@settings(max_examples=200)
@given(st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1), st.integers(0, 63))
def test_pairs_of_words_are_whole_numbers_of_64_bits(x, y, bits):
    def function(x, y):
        return [x & y, x | y, x ^ y, x << bits, x >> bits]

    numbers = np.uint64(x), np.uint64(y)
    closed = jax.make_jaxpr(function)(*numbers)
    program = Program()
    flattener = _WordFlattener(program, "float64")
    found = flattener.run(closed, [flattener.constants(np.asarray(n)) for n in numbers])
    for values, expected in zip(found, function(x, y), strict=True):
        high, low = (program.constants[v] for v in program.operations[int(values)][1])
        assert (high << 32) + low == expected % 2**64


def test_constant_words_are_carried_out_and_known_apart_from_numbers():
    p = Program()
    assert p.word(-1) == p.word(2**32 - 1) != p.constant(float(2**32 - 1))
    assert p.constants[p.apply("word_add", p.word(2**32 - 1), p.word(3))] == 2
    assert p.types[p.word(1)] == WORD == p.types[p.apply("word", p.input("x", SAMPLE))]
