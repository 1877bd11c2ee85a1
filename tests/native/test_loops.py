"""Loops that stay loops: what the rounds compute does not depend on whether they are written out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native import flatten
from glucoloop.native.interpreter import interpret
from glucoloop.native.lower import lower
from glucoloop.native.targets.llvm import emit

PEOPLE = 37
MATRIX = np.random.default_rng(3).normal(size=(3, 3)) * 0.4


def rounds(x, rows):
    """A loop in a loop, backwards, with a truth, a number of rounds, and something that no round changes."""

    def one(carried, row):
        x, total, count, high, fixed = carried

        def inner(x, _):
            x = jnp.tanh(MATRIX @ x) + row[0] * fixed
            return x, x[0]

        x, firsts = jax.lax.scan(inner, x, None, length=4)
        high = high ^ (x[1] > 0.0)
        return (x + row[1], total + x[0] * firsts.sum(), count + 1, high, fixed), (
            x[1],
            jnp.where(high, 2.0, count),
            high,
        )

    return jax.lax.scan(one, (x, 0.0, 0, False, rows[0, 0]), rows, reverse=True)


def until(x, rows):
    """Rounds whose number differs between people, some of whom need none."""
    pace = 0.5 + 0.3 * jnp.sin(x[0])

    def goes_on(carried):
        return (carried[0] > 1e-3) & (carried[1] < 30)

    return jax.lax.while_loop(goes_on, lambda c: (c[0] * pace, c[1] + 1, x[1]), (jnp.abs(rows).sum() - 9.0, 0, x[1]))


def settling(x, rows):
    """A fixed number of rounds, of which each person needs fewer, and some none."""

    def one(carried, _):
        x, settled = carried
        new = 0.5 * (x + rows[0, 0] ** 2 / x)
        return (jnp.where(settled, x, new), jnp.where(settled, settled, jnp.abs(new - x) < 1e-3)), None

    return jax.lax.scan(one, (1.0 + x[0] ** 2, x[1] > 0.0), None, length=9)[0]


def everything(x, rows):
    """All of them."""
    return rounds(x, rows), until(x, rows), settling(x, rows)


def numbers(seed=0):
    """States and rows; people trail."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(3, PEOPLE)), rng.normal(size=(7, 2, PEOPLE))


def flat(results):
    """All results as rows."""
    return np.concatenate([np.asarray(leaf, float).reshape(-1, PEOPLE) for leaf in jax.tree.leaves(results)])


@pytest.fixture
def looping(monkeypatch):
    """Every loop stays one."""
    monkeypatch.setattr(flatten, "_LARGEST_LOOP", 0)
    monkeypatch.setattr(flatten, "_FEW_ROUNDS", 0)


def lowered(function, **how):
    def step(person, carry, own, shared, rng):
        del person, shared, rng
        return carry, function(*own)

    shapes = jax.ShapeDtypeStruct((3,), float), jax.ShapeDtypeStruct((7, 2), float)
    return lower(step, (), (), shapes, (), **how)


def test_loops_are_those_of_jax(looping, native, by_jax):
    found, wanted = native(everything, *numbers())(*numbers()), by_jax(everything, *numbers())
    assert np.abs(flat(found) - flat(wanted)).max() < 1e-12


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(("size", "fits"), [(7, 10), (2000, 6000)])
def test_native_code_is_the_interpreter_to_the_bit_however_it_is_cut(
    looping, native, monkeypatch, precision, size, fits
):
    """Several vectors go in turn through each chunk, and one after the other."""
    monkeypatch.setattr(emit, "FITS_THE_CACHE", fits)
    for name in ("OPERATIONS_A_CHUNK", "OPERATIONS_OF_SEVERAL"):
        monkeypatch.setattr(emit, name, (size, size))
    given = [x.astype(precision) for x in numbers()]
    found = native(everything, *numbers(), precision=precision, products="strict")(*given)
    _, wanted = interpret(lowered(everything, precision=precision), own=flat(given))
    np.testing.assert_array_equal(flat(found), wanted)


def test_rounds_as_written_are_the_same_written_out(looping, monkeypatch):
    looped = lowered(rounds, as_written=True)
    monkeypatch.setattr(flatten, "_LARGEST_LOOP", 10**9)
    written_out = lowered(rounds, as_written=True)
    assert len(looped.program.loops) == 2
    assert not written_out.program.loops
    found, wanted = (interpret(one, own=flat(numbers()))[1] for one in (looped, written_out))
    np.testing.assert_array_equal(found, wanted)


def test_rounds_end_where_all_have_settled(looping):
    whole, [settled] = lowered(rounds), lowered(settling).program.loops.values()
    assert settled.length == 9
    assert settled.over == (1, True)
    assert all(loop.over is None for loop in whole.program.loops.values())


@pytest.mark.parametrize("function", [until, settling])
def test_the_bits_of_a_person_do_not_depend_on_how_long_others_go_on(looping, native, function):
    x, rows = numbers()
    carried_out = native(function, x, rows)
    if function is until:
        _, count, _ = carried_out(x, rows)
        assert count.min() == 0.0
        assert len(set(count.tolist())) > 4
    alone = [carried_out(x[:, [i]], rows[..., [i]]) for i in range(PEOPLE)]
    np.testing.assert_array_equal(flat(carried_out(x, rows)), np.concatenate([flat_one(one) for one in alone], axis=1))


def flat_one(results):
    """Results of one person as a column."""
    return np.concatenate([np.asarray(leaf, float).reshape(-1, 1) for leaf in results])


def test_what_no_round_changes_and_what_is_equal_is_carried_once_or_not_at_all(looping):
    def twins(x, rows):
        def one(carried, row):
            a, b, fixed, zero = carried
            return (jnp.sin(a) + fixed + row, jnp.sin(b) + fixed + row, fixed, zero * a[0]), None

        return jax.lax.scan(one, (x, x, rows[0, 0], jnp.zeros(())), rows[:, 0])[0]

    [loop] = lowered(twins).program.loops.values()
    assert len(loop.carry) == 3  # the three numbers of x


def test_a_long_loop_stays_one(native, by_jax):
    def long(x, rows):
        return jax.lax.scan(lambda c, _: (jnp.cos(c), None), x * rows[0, 0], None, length=500)[0]

    assert len(lowered(long).program.needed(lowered(long).layout.results)) < 500
    assert np.abs(flat([native(long, *numbers())(*numbers())]) - flat([by_jax(long, *numbers())])).max() < 1e-12


def test_what_a_loop_leaves_may_be_more_than_the_stack_of_a_thread(native, monkeypatch):
    """13 MB for four vectors of eight people, where a stack has 8 MB or less."""
    monkeypatch.setattr(emit, "FITS_THE_CACHE", 0)

    def many(x, rows):
        left = jax.lax.scan(lambda c, _: (c + rows[0, 0], c), x[0], None, length=50_000)[1]
        return left[7], left[-1]

    x, rows = numbers()
    seventh, last = native(many, x, rows)(x, rows)
    np.testing.assert_allclose(seventh, x[0] + 7.0 * rows[0, 0], rtol=1e-12)
    np.testing.assert_allclose(last, x[0] + 49_999.0 * rows[0, 0], rtol=1e-9)
