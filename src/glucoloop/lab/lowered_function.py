"""A function of the page: lowered, with the names of what it takes and gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from glucoloop.native.lower import Lowered, lower
from glucoloop.native.targets.wasm import CFunction


@dataclass(frozen=True)
class PageFunction:
    """A compiled function with the names of its inputs and outputs."""

    step: Callable[..., Any]
    """The function, in JAX."""
    lowered: Lowered | CFunction
    """The scalar program, or the C of a function whose loops would make that too long."""
    names: Mapping[str, Mapping[str, int]]
    """Name -> number of numbers, in their order, of each group; see `glucoloop.native.lower.Layout`."""

    @property
    def scalar(self) -> Lowered:
        """The scalar program of a function that has one."""
        if isinstance(self.lowered, CFunction):
            raise TypeError("a function that keeps its loops has no scalar program")
        return self.lowered


def page_function(step: Callable[..., Any], person: Any, carry: Any, own: Any, shared: Any = ()) -> PageFunction:
    """Lower a function, and name what it takes and gives by the places in its trees; drawn numbers come last in own."""
    lowered = lower(step, person, carry, own, shared, jax.random.key(0), as_written=True)
    shapes = lowered.shapes
    groups = {"person": shapes.person, "carry": shapes.carry, "own": shapes.own, "shared": shapes.shared}
    names = {name: names_of(tree) for name, tree in {**groups, "outputs": shapes.outputs}.items()}
    drawn = lowered.layout.sizes["own"] - sum(names["own"].values())
    if drawn:
        names["own"]["drawn"] = drawn
    return PageFunction(step=step, lowered=lowered, names=names)


def start_function(init: Callable[..., Any], person: Any, own: Any) -> PageFunction:
    """Lower a function that gives the state at the start: its outputs are the state."""

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared
        return carry, init(person, own, rng)

    return page_function(step, person, (), own)


def names_of(tree: Any) -> dict[str, int]:
    """Names of the leaves of a tree, each with its number of numbers, as a function of the page takes or gives them."""
    result = jax.tree_util.tree_leaves_with_path(tree)
    return {_name(path): int(leaf.size) for path, leaf in result}


def by_name(tree: Any) -> dict[str, Any]:
    """Numbers of a tree, by the names under which a function of the page takes them."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {_name(path): np.asarray(leaf).tolist() for path, leaf in leaves}


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")
