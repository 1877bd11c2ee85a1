"""Meals together with the gut that absorbs them, of either kind, for one person and for many.

An `Absorption` knows the meals and gives the moments of the appearance, for a whole run or sample by sample. A
`Digestion` carries the gut of a person in the loop of a cohort, where what is eaten is an input.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop.meals.linear import LinearAbsorption, absorb_linearly, added_by_jump, linear_digestion
from glucoloop.meals.moments import points_of_sample
from glucoloop.meals.ode import OdeDigestion, absorb_by_equations, eaten_in_points
from glucoloop.meals.protocol import Eaten, Ingestion, MealModel, OdeMealModel
from glucoloop.native.lower import lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets import FUSED, STRICT
from glucoloop.native.targets.llvm.kernel import Kernel, compile_kernel
from glucoloop.sparse import Sparse


class Absorption(Protocol):
    """Meals together with the gut that absorbs them; a pytree."""

    @property
    def state(self) -> Any:
        """State of the gut before the coming sample."""

    def goes_on(self, state: Any) -> Absorption:
        """The same meals with the gut in another state, that before the coming sample."""

    def moments(self, samples: int, substeps: int, step_min: float) -> jax.Array:
        """Moments of the appearance over every step of a run, ``(samples, substeps, 3, ...)``."""

    def at_sample(self, index: jax.Array, substeps: int, step_min: float) -> tuple[jax.Array, Any]:
        """The same of the coming sample, which has the number `index`, and the state of the gut after it."""

    def emptying_mg_min(self, samples: int, sample_time_min: float) -> jax.Array:
        """Rate at which the stomach empties at every sample of a run, ``(samples, ...)``."""


class Digestion(Protocol):
    """A gut that is carried from sample to sample; a pytree whose numbers are those that vary between people."""

    @property
    def inputs(self) -> tuple[int, int]:
        """Shape of what reaches one person's gut in a sample."""

    def init(self) -> jax.Array:
        """State of one person who has eaten nothing."""

    def sample(self, state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Digestion of one person over one sample: the state at its end, and the moments ``(substeps, 3)``."""


def absorb(model: MealModel, eaten: Eaten) -> Absorption:
    """Combine meals with the meal model that absorbs them; with a model of people, meals have an axis of people too."""
    return absorb_by_equations(model, eaten) if isinstance(model, OdeMealModel) else absorb_linearly(model, eaten)


def fasting() -> Absorption:
    """Absorption without any meal, the same for every gut."""
    none = np.zeros(0)
    return absorb(Ingestion(), Eaten(t_min=none, carbs_g=none, eating_min=none))


def digestion(model: MealModel, substeps: int, step_min: float) -> Digestion:
    """Digestion with a gut, of one person or of many, for samples of so many steps."""
    if isinstance(model, OdeMealModel):
        return OdeDigestion(model=model, substeps=substeps, sample_time_min=substeps * step_min)
    made: Digestion = linear_digestion(model, substeps, step_min)
    return made


def digestion_inputs(
    model: MealModel, eaten: Eaten, substeps: int, step_min: float, products: str = FUSED
) -> Callable[[int, int], Sparse]:
    """Inputs of the `digestion` of people with meals ``(meals, people)``, piece by piece of a run.

    The function takes the number of a piece's first sample and the number of its samples, and gives
    ``(samples, *inputs, people)``.
    """
    if not isinstance(model, OdeMealModel):
        jumps = JumpsInSteps(absorb_linearly(model, eaten), step_min, products)

        def of_jumps(first: int, samples: int) -> Sparse:
            table = jumps.table(first * substeps, samples * substeps)
            return table.reshaped(samples, substeps, table.shape[1])

        return of_jumps
    points = points_of_sample(substeps * step_min)
    point_min = substeps * step_min / points

    def of_points(first: int, samples: int) -> Sparse:
        eating = eaten_in_points(eaten, samples * points, point_min, first=first * points)
        return eating.reshaped(samples, points, 2)

    return of_points


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
