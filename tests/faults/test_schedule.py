import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.faults import Episodes, always, never, once, recurring
from glucoloop.faults.schedule import LARGEST_KEY

SAMPLES = 40
ONE = jnp.asarray(0.0)


@jax.jit
def scan(episodes, like, key):
    """Ages at each sample; the numbers of samples fold into the key as in the loop."""
    first, rest = jax.random.split(key)

    def step(state, number):
        return episodes.step(state, jax.random.fold_in(rest, number))

    return jax.lax.scan(step, episodes.init(like, first), jnp.arange(SAMPLES))[1]


@jax.jit
def scan_each(episodes, keys):
    return jax.vmap(lambda key: scan(episodes, ONE, key))(keys)


def ages(episodes, like=ONE, seed=0):
    return np.asarray(scan(episodes, like, jax.random.key(seed)))


def many(episodes, n=500, seed=1):
    return np.asarray(scan_each(episodes, jax.random.split(jax.random.key(seed), n)))


def plain(start, length):
    return [t - start if 0 <= t - start < length else -1 for t in range(SAMPLES)]


@given(st.integers(0, SAMPLES + 5), st.one_of(st.integers(1, SAMPLES + 5), st.just(np.inf)))
def test_one_episode_begins_and_ends_as_planned(start, length):
    np.testing.assert_array_equal(ages(once(start, length)), plain(start, length))


def test_always_and_never():
    np.testing.assert_array_equal(ages(always()), np.arange(SAMPLES))
    np.testing.assert_array_equal(ages(never()), -1)


def test_an_onset_is_drawn_evenly_with_both_ends():
    found = many(once(3, 2, latest_sample=9), 2000)
    assert set(np.unique(found)) == {-1.0, 0.0, 1.0}
    assert np.all((found == 0).sum(axis=1) == 1)
    onsets = np.argmax(found == 0, axis=1)
    counts = np.bincount(onsets, minlength=SAMPLES)
    assert counts[:3].sum() == counts[10:].sum() == 0
    assert scipy.stats.chisquare(counts[3:10]).pvalue > 1e-6


@pytest.mark.parametrize(("probability", "length"), [(0.05, 1), (0.2, 3), (0.5, 2)])
def test_recurring_episodes_begin_with_their_probability_and_last_as_long_as_they_should(probability, length):
    found = many(recurring(probability, length))
    before = np.concatenate([np.full((len(found), 1), -1.0), found[:, :-1]], axis=1)
    free = (before == -1) | (before == length - 1)
    np.testing.assert_array_equal(found[~free], before[~free] + 1)
    assert set(np.unique(found[free])) == {-1.0, 0.0}
    begun = (found[free] == 0).mean()
    assert abs(begun - probability) < 5.0 * np.sqrt(probability * (1 - probability) / free.sum())
    share = length * probability / (length * probability + 1 - probability)
    late = (found[:, SAMPLES // 2 :] >= 0).mean()  # the start is free of faults
    assert abs(late - share) < 0.02


def test_certain_and_impossible_episodes():
    np.testing.assert_array_equal(ages(recurring(1.0, 3)), np.arange(SAMPLES) % 3)
    np.testing.assert_array_equal(ages(recurring(0.0, 3)), -1)


def test_an_episode_that_recurs_for_ever_begins_once():
    found = many(recurring(0.2, np.inf))
    assert np.all((found == 0).sum(axis=1) <= 1)
    assert np.all(np.diff(found, axis=1) >= 0)


def test_an_episode_can_be_planned_and_others_random():
    found = many(dataclasses.replace(once(4, 2), probability=0.1, random=True))
    assert np.all(found[:, 4] >= 0)
    assert (found[:, 10:] == 0).sum() > 100


def test_a_key_gives_one_course_and_another_gives_another():
    drawn = recurring(0.3)
    np.testing.assert_array_equal(ages(drawn, seed=5), ages(drawn, seed=5))
    assert np.any(ages(drawn, seed=5) != ages(drawn, seed=6))
    one, other = (many(recurring(0.3, key=key)) >= 0 for key in (1, 2))
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 5.0 / np.sqrt(one.size)


def test_the_draws_of_a_fault_are_not_those_of_anything_inside():
    key = jax.random.key(3)
    data = {tuple(np.asarray(jax.random.key_data(k)).tolist()) for k in jax.random.split(key, 8)}
    data |= {tuple(np.asarray(jax.random.key_data(jax.random.fold_in(key, i))).tolist()) for i in range(8)}
    own = [once(0, key=k).own(key) for k in (*range(8), LARGEST_KEY)]
    own_data = {tuple(np.asarray(jax.random.key_data(k)).tolist()) for k in own}
    assert len(own_data) == len(own)
    assert not own_data & data


def test_people_have_onsets_and_lengths_of_their_own():
    starts, lengths = np.array([0.0, 7.0, np.inf]), np.array([np.inf, 5.0, 1.0])
    found = ages(Episodes(earliest=starts, latest=starts, length=lengths), jnp.zeros(3))
    for person in range(3):
        np.testing.assert_array_equal(found[:, person], plain(starts[person], lengths[person]))
    drawn = ages(once(0, 1, latest_sample=SAMPLES - 1), jnp.zeros(20))
    assert np.all((drawn == 0).sum(axis=0) == 1)
    assert len(np.unique(np.argmax(drawn == 0, axis=0))) > 5


def test_the_kind_of_numbers_is_kept():
    for episodes in (once(1, 2, latest_sample=3), recurring(0.5)):
        state = episodes.init(jnp.zeros(2, jnp.float32), jax.random.key(0))
        state, age = episodes.step(state, jax.random.key(1))
        assert {a.dtype for a in (state.until, state.age, age)} == {jnp.dtype("float32")}


@pytest.mark.parametrize("start", [-1, 1.5, np.nan, np.inf, True])
def test_an_impossible_onset_is_refused(start):
    with pytest.raises(ValueError, match=r"an onset at sample .* is not possible; give a whole number of 0 or more"):
        once(start)


@pytest.mark.parametrize("latest", [4, 5.5, np.inf])
def test_an_impossible_latest_onset_is_refused(latest):
    with pytest.raises(ValueError, match=r"a latest onset at sample .* is not possible; give a whole number of 5"):
        once(5, latest_sample=latest)


@pytest.mark.parametrize("samples", [0, -1, 2.5, np.nan, -np.inf, True])
def test_an_impossible_length_is_refused(samples):
    for make in (lambda: once(0, samples), lambda: recurring(0.1, samples)):
        with pytest.raises(ValueError, match=r"an episode of .* samples is not possible; give a whole number of 1"):
            make()


@pytest.mark.parametrize("probability", [-0.1, 1.1, np.nan, True])
def test_an_impossible_probability_is_refused(probability):
    with pytest.raises(ValueError, match=r"a probability of .* per sample is not possible; give a value from 0 to 1"):
        recurring(probability)


@pytest.mark.parametrize("key", [-1, 65536, 1.0, True, "1"])
def test_an_impossible_key_is_refused(key):
    for make in (lambda: once(0, key=key), lambda: recurring(0.1, key=key), lambda: always(key=key)):
        with pytest.raises(ValueError, match=r"a key of .* is not possible; give a whole number from 0 to 65535"):
            make()
