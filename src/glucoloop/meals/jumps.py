"""Jumps of people's meals, and what each adds to the step of a run in which it lies, for any linear meal model.

There are sixteen jumps in a day of four meals, and the answer to each is integrated by quadrature, so native code
computes them where it has all that a model's `propagator` is made of.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop.meals.linear import LinearAbsorption, added_by_jump
from glucoloop.native.lower import lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets import FUSED, STRICT
from glucoloop.native.targets.llvm.kernel import Kernel, compile_kernel
from glucoloop.sparse import Sparse

Array = npt.NDArray[Any]
Added = Callable[[Any, Array, Array], Array]
"""Function of a gut, the times of jumps ``(jumps, people)`` in their step and sizes ``(inputs, jumps, people)``."""


class JumpsInSteps:
    """Jumps of people, each with the number of the step in which it lies and what it adds there."""

    def __init__(self, absorption: LinearAbsorption, step_min: float, products: str = FUSED) -> None:
        """The absorption has jumps ``(jumps, people)``, which are computed once, however long the run is."""
        t_min, size = (np.asarray(part) for part in (absorption.jumps.t_min, absorption.jumps.size))
        step = np.floor(t_min / step_min)
        added = _added(jax.tree.structure(absorption.model), size.shape[0], step_min, products)
        self._added = added(absorption.model, t_min - step * step_min, size)
        self._step = step.astype(np.intp)
        self._first, self._last = self._step.min(axis=1), self._step.max(axis=1)

    def table(self, first: int, steps: int) -> Sparse:
        """Contributions ``(steps, 3 + states, people)`` to the moments of each step and the state at its end.

        The steps are those from the one of a number on; jumps before and after them are left out.
        """
        near = np.flatnonzero((self._last >= first) & (self._first < first + steps))
        step, entries = self._step[near] - first, self._added.shape[1]
        jump, person = np.nonzero((step >= 0) & (step < steps))
        row = step[jump, person][:, None] * entries + np.arange(entries)
        return Sparse(
            shape=(steps, entries, step.shape[1]),
            row=row.ravel(),
            person=np.repeat(person, entries),
            number=self._added[near[jump], :, person].ravel(),
        )


@functools.lru_cache(maxsize=8)
def _added(of_model: Any, inputs: int, step_min: float, products: str) -> Added:
    """Function that gives what jumps add, ``(jumps, 3 + states, people)``, for guts of one structure."""
    model = jax.tree.unflatten(of_model, [np.zeros(())] * of_model.num_leaves)

    try:
        kernel = kept_result(_kernel, model, inputs, step_min, products)
    except UnsupportedError:
        return _by_jax(step_min)

    def added(model: Any, since_min: Array, size: Array) -> Array:
        jumps, people = since_min.shape
        columns = kernel.padded(people)
        person = np.zeros((of_model.num_leaves, columns))
        for row, leaf in zip(person, jax.tree.leaves(model), strict=True):
            row[:people] = leaf
        own = np.zeros((jumps, 1 + inputs, columns))
        own[:, 0, :people], own[:, 1:, :people] = since_min, np.moveaxis(size, 0, 1)
        outputs = np.empty((jumps, kernel.sizes["outputs"], columns))
        kernel.run(person, np.zeros((0, columns)), kernel.by_vector(own), np.zeros((jumps, 0)), outputs)
        return outputs[..., :people]

    return added


def _kernel(model: Any, inputs: int, step_min: float, products: str) -> Kernel:
    def one(model: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del carry, shared, rng
        since_min, size = own
        return (), added_by_jump(model, since_min, size, step_min)

    lowered = lower(one, model, (), (np.zeros(()), np.zeros(inputs)), (), as_written=products == STRICT)
    return compile_kernel(lowered, products=products)


def _by_jax(step_min: float) -> Added:
    by_jax = jax.jit(lambda model, since_min, size: jnp.moveaxis(added_by_jump(model, since_min, size, step_min), 0, 1))
    return lambda model, since_min, size: np.asarray(by_jax(model, since_min, size))
