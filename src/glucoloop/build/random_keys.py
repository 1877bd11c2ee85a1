"""Random keys: each record, and each person's loop, has its own."""

from __future__ import annotations

from typing import Final

import jax

from glucoloop._kept_programs import kept_jit

# Far from the small numbers by which the loop splits its key, so that the record's noise is not the loop's.
_RECORD: Final = 0x4D4F444C
_PEOPLE: Final = 0x50454F50


@kept_jit
def record_key(seed: int | jax.Array) -> jax.Array:
    """Key of the record from which a model is identified; the loop's own key is that of the seed."""
    key: jax.Array = jax.random.fold_in(jax.random.key(seed), _RECORD)
    return key


@kept_jit
def keys_of_records(seed: jax.Array, person: jax.Array) -> jax.Array:
    """Key of the record from which each person's own model is identified, ``(people,)``."""
    keys: jax.Array = jax.vmap(lambda number: jax.random.fold_in(record_key(seed), number))(person)
    return keys


@kept_jit
def keys_of_people(seed: jax.Array, person: jax.Array) -> jax.Array:
    """Key of each person's loop, ``(people,)``, from the seed and the person's number alone."""
    root = jax.random.fold_in(jax.random.key(seed), _PEOPLE)
    keys: jax.Array = jax.vmap(lambda number: jax.random.fold_in(root, number))(person)
    return keys
