"""Random numbers of people for their loop, drawn before it: by native code, or by JAX where native code lacks it."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.native.flatten import Drawing
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.llvm.kernel import Kernel, compile_kernel, vectors_at_once
from glucoloop.native.targets.products import STRICT
from glucoloop.native.words import lower_drawing


class Draws(Protocol):
    """Function that draws the numbers of people."""

    def __call__(self, words: npt.NDArray[np.uint32], first: npt.NDArray[Any], samples: int) -> npt.NDArray[np.float64]:
        """Numbers ``(samples, numbers, people)`` by the words of keys ``(people, 2)``.

        `first` is the first sample of each person, ``(people,)``.
        """


one_at_a_time = threading.RLock()
"""Lock held while JAX computes: on the CPU two of its programs in two threads can deadlock."""


def draws(drawing: Drawing, key: Any, products: str) -> Draws | None:
    """Function that draws the numbers of people; None where nothing is drawn.

    `key` is an example of a random key. The numbers are those that JAX draws for one person, with normal numbers equal
    to rounding; products are rounded as `glucoloop.native.targets.products` says.
    """
    if not drawing.results:
        return None
    try:
        lowered = lower_drawing(drawing, key, jnp.zeros((), int), as_written=products == STRICT)
    except UnsupportedError:
        return _ByJax(drawing)
    return _ByKernel(compile_kernel(lowered, products=products, vectors=vectors_at_once(lowered)))


@dataclass(frozen=True)
class _ByKernel:
    kernel: Kernel

    def __call__(self, words: npt.NDArray[np.uint32], first: npt.NDArray[Any], samples: int) -> npt.NDArray[np.float64]:
        kernel, people, columns = self.kernel, first.size, self.kernel.padded(first.size)
        person, index = np.zeros((kernel.sizes["person"], columns)), np.zeros((1, columns))
        person[:, :people], index[:, :people] = words.T, first
        drawn = np.empty((samples, kernel.sizes["outputs"], columns))
        kernel.run(person, index, np.zeros((samples, 0, columns)), np.zeros((samples, 0)), drawn)
        return drawn[..., :people]


@dataclass(frozen=True)
class _ByJax:
    drawing: Drawing

    def __call__(self, words: npt.NDArray[np.uint32], first: npt.NDArray[Any], samples: int) -> npt.NDArray[np.float64]:
        with one_at_a_time:
            drawn = self._of_samples(words, np.arange(samples)[:, None] + first)
            parts = [np.asarray(part, np.float64).reshape(samples, -1, first.size) for part in drawn]
        return np.concatenate(parts, axis=1)

    @functools.cached_property
    def _of_samples(self) -> Callable[..., list[jax.Array]]:
        def of_one(words: Any, index: Any) -> list[jax.Array]:
            return self.drawing(jax.random.wrap_key_data(words), index)

        return jax.jit(jax.vmap(jax.vmap(of_one, out_axes=-1), in_axes=(None, 0)))
