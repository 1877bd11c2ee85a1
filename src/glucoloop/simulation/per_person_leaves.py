"""Numbers of a tree that differ between people, taken out of it and put in again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp


def varying(many: Any, one: Any) -> list[bool]:
    """Whether each leaf has one number per person."""
    leaves = zip(jax.tree.leaves(many), jax.tree.leaves(one), strict=True)
    return [jnp.ndim(a) > jnp.ndim(b) for a, b in leaves]


def chosen(tree: Any, varies: Sequence[bool]) -> list[jax.Array]:
    """Leaves that vary between people."""
    return [jnp.asarray(leaf) for leaf, differs in zip(jax.tree.leaves(tree), varies, strict=True) if differs]


def replaced(tree: Any, varies: Sequence[bool], values: Sequence[Any]) -> Any:
    """A tree with other leaves where they vary."""
    leaves, structure = jax.tree.flatten(tree)
    new = iter(values)
    return jax.tree.unflatten(structure, [next(new) if v else leaf for leaf, v in zip(leaves, varies, strict=True)])
