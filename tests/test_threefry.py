"""Random numbers by counter: the published answers, JAX's own, and independence of the batch."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from jax.extend.random import threefry_2x32 as of_jax

from glucoloop.threefry import name_word, threefry_2x32, uniforms

WORDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [  # known answers of Random123
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
        ((0x243F6A88, 0x85A308D3), (0x13198A2E, 0x03707344), (0xC4923A9C, 0x483DF7A0)),
    ],
)
def test_published_answers(counter, key, answer):
    found = threefry_2x32(np.array(key, np.uint32), *(np.array([word], np.uint32) for word in counter))
    assert tuple(int(word[0]) for word in found) == answer


@given(WORDS, WORDS, WORDS, WORDS)
def test_words_are_those_of_jax(k0, k1, c0, c1):
    first, second, *counter = np.array([[k0], [k1], [c0], [c1]], np.uint32)
    found = threefry_2x32((first, second), *counter)
    truth = of_jax(jnp.array([k0, k1], jnp.uint32), jnp.array([c0, c1], jnp.uint32))
    assert [int(word[0]) for word in found] == np.asarray(truth).tolist()


def test_a_number_does_not_depend_on_the_others():
    together = uniforms(7, "a", np.arange(40_000))
    some = np.random.default_rng(0).permutation(40_000)[:1001]
    assert np.array_equal(uniforms(7, "a", some), together[some])
    assert uniforms(7, "a", [39_999])[0] == together[-1]
    assert uniforms(7, "a", []).shape == (0,)
    index = np.array([3, 0, 5])
    each = [uniforms(7, "a", [person], int(i))[0] for person, i in zip([1, 2, 1], index, strict=True)]
    assert np.array_equal(uniforms(7, "a", [1, 2, 1], index), each)


def test_numbers_are_uniform_and_independent():
    n = 20_000
    a, b, c, d = (
        uniforms(1, "a", np.arange(n)),
        uniforms(1, "b", np.arange(n)),
        uniforms(2, "a", np.arange(n)),
        uniforms(1, "a", np.arange(n), 1),
    )
    for drawn in (a, b, c, d):
        assert scipy.stats.kstest(drawn, "uniform").pvalue > 1e-3
        assert 0.0 < drawn.min() < drawn.max() < 1.0
    assert np.abs(np.corrcoef([a, b, c, d, np.roll(a, 1)]) - np.eye(5)).max() < 0.03


def test_a_name_stands_for_the_same_word_everywhere():
    assert name_word("parameter F_LC") == 0x8A539732  # as sha256sum begins


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5, True, "1"])
def test_an_impossible_seed_is_refused(seed):
    with pytest.raises(ValueError, match=r"^seed is .*; give a whole number from 0 to 4294967295$"):
        uniforms(seed, "a", [0])


@pytest.mark.parametrize(
    ("person", "told"),
    [([-1], "person -1 does"), ([2**32], "person 4294967296 does"), ([0.5], "float64 numbers"), ([[1]], "in one row")],
)
def test_an_impossible_person_is_refused(person, told):
    with pytest.raises(ValueError, match=told):
        uniforms(0, "a", person)
