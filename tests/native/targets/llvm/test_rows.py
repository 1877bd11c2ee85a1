"""Rows of matrices are found again in a scalar program, with the places of their numbers."""

import jax.numpy as jnp

from glucoloop.native.lower import lower
from glucoloop.native.program import PERSON, SAMPLE
from glucoloop.native.targets.llvm.rows import find_rows


def rows_of(step, person, carry):
    lowered = lower(step, person, carry, (), (), (), as_written=True)
    program, layout = lowered.program, lowered.layout
    order = program.needed(layout.results)
    places = {value: i for i, value in enumerate(layout.person)}
    varying = [value for value in order if program.levels[value] == SAMPLE and value not in layout.carry]
    once = [value for value in order if program.levels[value] == PERSON]
    places |= {value: len(places) + i for i, value in enumerate(v for v in once if v not in places)}
    return find_rows(program, varying, layout.results, places), layout, places


def test_rows_of_one_matrix_are_one_loop_even_if_not_all_are_needed():
    def step(matrix, x, own, shared, rng):
        product = matrix @ x
        return jnp.stack([product[0], product[2], product[3], x[0], product[1] + product[2]]), ()

    [found], layout, _ = rows_of(step, jnp.zeros((6, 5)), jnp.zeros(5))
    assert list(found.columns) == [0, 1, 2, 3, 4]
    assert sorted(found.places) == [0, 5, 10, 15]
    assert found.starts == []
    assert list(found.factors) == list(layout.carry)


def test_sums_that_begin_with_a_number_of_the_person_know_where_it_lies():
    def step(person, x, own, shared, rng):
        matrix, known = person
        wide = jnp.concatenate([known, x])
        return matrix @ wide, ()

    [found], layout, places = rows_of(step, (jnp.zeros((4, 6)), jnp.zeros(2)), jnp.zeros(4))
    assert len(found.starts) == len(found.sums) == 4
    assert all(place >= len(layout.person) for place in found.starts)
    assert len(set(found.starts)) == 4
    assert set(found.starts) <= set(places.values())
    assert sorted(found.places) == [2, 8, 14, 20]
    assert list(found.columns) == [0, 1, 2, 3]


def test_few_rows_and_parts_that_others_need_stay_as_they_are():
    def few(matrix, x, own, shared, rng):
        return jnp.concatenate([matrix @ x, x[2:]]), ()

    def shared_products(matrix, x, own, shared, rng):
        products = matrix * x
        return products.sum(axis=1) + products[:, 0], ()

    assert rows_of(few, jnp.zeros((2, 4)), jnp.zeros(4))[0] == []
    assert all(len(found.columns) < 4 for found in rows_of(shared_products, jnp.zeros((4, 4)), jnp.zeros(4))[0])
