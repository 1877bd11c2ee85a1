"""Engines that run a loop over samples for many people, and draw for it: native code, or JAX mapped over them.

Both take the same function of one person and one sample,
``carry, outputs = step(person, carry, reaching, shared, rng)``:

============  =====================================================  ================================
argument      meaning                                                arrays given to `run`
============  =====================================================  ================================
``person``    values of a person                                     ``(..., people)``
``carry``     state that is passed from sample to sample             ``(..., people)``
``reaching``  inputs of the person at a sample                       ``(samples, ..., people)``
``shared``    inputs of all people at a sample                       ``(samples, ...)``
``rng``       the person's random key, and the number of the sample  ``(people,)`` keys
============  =====================================================  ================================
"""

from __future__ import annotations

import contextlib
import functools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import kept_result
from glucoloop.native.flatten import Drawing
from glucoloop.native.lower import Shapes, lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets import FUSED, STRICT
from glucoloop.native.targets.llvm.kernel import Kernel, compile_kernel, vectors_at_once
from glucoloop.native.words import lower_drawing
from glucoloop.refusal import Refusal
from glucoloop.sparse import Sparse, dense


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
    to rounding; products are rounded as `glucoloop.native.targets` says.
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


Array = npt.NDArray[Any]
Step = Callable[[Any, Any, Any, Any, Any], tuple[Any, Any]]

ENGINES: Final = ("native", "xla")


class Engine(Protocol):
    """Protocol of an engine."""

    @property
    def name(self) -> str:
        """Name of the engine."""

    @property
    def precision(self) -> str:
        """Precision, ``"float64"`` or ``"float32"``."""

    @property
    def not_native(self) -> str | None:
        """Operation that native code lacks, and in whose code it is; None if there is none, or xla was asked for."""

    def run(
        self, person: Any, carry: Any, reaching: Any, shared: Any, keys: jax.Array, *, first: int = 0, threads: int = 1
    ) -> tuple[Any, Any]:
        """Final carry ``(..., people)``, and outputs of each sample ``(samples, ..., people)``.

        `first` is the number of the first sample, where the loop goes on from an earlier carry.
        """

    def lanes(self, number: int) -> Lanes:
        """Places for people who are carried from sample to sample one at a time, each at a sample of its own.

        It needs a step without `shared` inputs.
        """


class Lanes(Protocol):
    """People in an engine, sample by sample."""

    person: Any
    """Values ``(..., lanes)``, which may be written in place."""
    carry: Any
    """State ``(..., lanes)``, which may be written in place."""

    def step(self, reaching: Any, key_data: Array, index: Array, *, threads: int = 1) -> Any:
        """Outputs ``(..., lanes)`` of one sample, whose number in each lane is ``index``; the carry goes on.

        Inputs are ``(..., lanes)``, and the data of random keys ``(lanes, ...)``.
        """


def make_engine(
    step: Step,
    person: Any,
    carry: Any,
    reaching: Any,
    shared: Any,
    key: jax.Array,
    *,
    name: str | None,
    precision: str,
    products: str = FUSED,
) -> Engine:
    """An engine for a loop, made from an example of one person and one sample, of which only shapes and types count.

    The key stands in the place of ``rng``. Without a name the engine is native code if the loop allows it. Precision
    and the rounding of products (see `native.targets`) are those of native code; the other engine computes in
    float64 and rounds as its compiler likes. Native code or strict products that are asked for and not possible are
    refused.
    """
    if name not in (None, *ENGINES):
        raise Refusal(f"unknown engine {name!r}; the known ones are: {', '.join(ENGINES)}")
    lacking = None
    if name != "xla":
        try:
            return NativeEngine(step, (person, carry, reaching, shared, key), precision, products)
        except UnsupportedError as error:
            lacking = str(error)
            if name == "native":
                raise Refusal(f"native code cannot take this loop, which has {error}; use xla") from None
            if products == STRICT:
                raise Refusal(
                    f"native code cannot take this loop, which has {error}, and no other engine has portable "
                    "arithmetic; use fused arithmetic, or another controller"
                ) from None
    if products == STRICT:
        raise Refusal("the engine xla has no portable arithmetic; use native code, or fused arithmetic")
    return _MappedEngine(step, (person, carry), lacking)


class NativeEngine:
    """Engine with straight-line vector code, several people in each vector."""

    name: Final = "native"
    not_native: Final = None

    def __init__(self, step: Step, example: tuple[Any, ...], precision: str, products: str = FUSED) -> None:
        self.precision = precision
        shapes = jax.eval_shape(lambda *parts: parts, *example)
        self._kernel, self._draw, self._shapes = kept_result(_native_code, step, shapes, precision, products)

    def run(
        self, person: Any, carry: Any, reaching: Any, shared: Any, keys: jax.Array, *, first: int = 0, threads: int = 1
    ) -> tuple[Any, Any]:
        """Run the compiled loop; see `Engine.run`."""
        kernel, n = self._kernel, keys.shape[0]
        columns, dtype = kernel.padded(n), kernel.dtype
        shared_leaves = [np.asarray(leaf, dtype) for leaf in jax.tree.leaves(shared)]
        samples = shared_leaves[0].shape[0]
        at_sample = np.concatenate([leaf.reshape(samples, -1) for leaf in shared_leaves], axis=1)
        reaches = list(jax.tree.leaves(reaching))
        if self._draw is not None:
            with one_at_a_time:
                words = np.asarray(jax.random.key_data(keys))
            reaches.append(self._draw(words, np.full(n, first), samples))
        values, state = (_rows(jax.tree.leaves(tree), n, columns, dtype) for tree in (person, carry))
        written = np.empty((samples, kernel.sizes["outputs"], columns), dtype)
        with _arriving(kernel, samples, reaches, n) as own:
            kernel.run(values, state, own, at_sample, written, threads=threads)
        return _tree(self._shapes.carry, state[:, :n], axis=0), _tree(self._shapes.outputs, written[..., :n], axis=1)

    def lanes(self, number: int) -> Lanes:
        """Places for people in the arrays of the kernel; see `Engine.lanes`."""
        return _NativeLanes(self._kernel, self._shapes, self._draw, number)


def _native_code(
    step: Step, example: tuple[Any, ...], precision: str, products: str
) -> tuple[Kernel, Draws | None, Shapes]:
    """Code of a sample, what draws its random numbers, and the trees that it takes and returns."""
    person, carry, reaching, shared, key = example
    rng = key, jnp.zeros((), int)
    lowered = lower(step, person, carry, reaching, shared, rng, precision=precision, as_written=products == STRICT)
    kernel = compile_kernel(lowered, products=products, vectors=vectors_at_once(lowered))
    return kernel, draws(lowered.drawing, key, products), lowered.shapes


class _NativeLanes:
    """Rows of the kernel, of which the trees are views, so that a sample copies no state."""

    def __init__(self, kernel: Kernel, shapes: Shapes, draw: Draws | None, number: int) -> None:
        self._kernel, self._shapes, self._draw, self._number = kernel, shapes, draw, number
        columns = kernel.padded(number)
        self._rows = {
            name: np.zeros((kernel.sizes[name], columns), kernel.dtype) for name in ("person", "carry", "outputs")
        }
        self.person = _tree(self._shapes.person, self._rows["person"][:, :number], axis=0)
        self.carry = _tree(self._shapes.carry, self._rows["carry"][:, :number], axis=0)
        self._shared = np.zeros((1, kernel.sizes["shared"]), kernel.dtype)

    def step(self, reaching: Any, key_data: Array, index: Array, *, threads: int = 1) -> Any:
        """One sample of the compiled loop; see `Lanes.step`."""
        rows, n = self._rows, self._number
        inputs = [np.asarray(leaf)[None] for leaf in jax.tree.leaves(reaching)]
        if self._draw is not None:
            inputs.append(self._draw(key_data, index, 1))
        for array in rows.values():
            array[:, n:] = array[:, n - 1 : n]
        with _arriving(self._kernel, 1, inputs, n) as own:
            self._kernel.run(rows["person"], rows["carry"], own, self._shared, rows["outputs"][None], threads=threads)
        return _tree(self._shapes.outputs, rows["outputs"][:, :n], axis=0)


class _MappedEngine:
    """Engine with JAX mapped over people, in float64, on the default device."""

    name: Final = "xla"
    precision: Final = "float64"

    def __init__(self, step: Step, example: tuple[Any, ...], not_native: str | None = None) -> None:
        self.not_native = not_native
        self._one_sample, self._example = step, example[:2]

        def scan(person: Any, carry: Any, reaching: Any, shared: Any, keys: Any, first: Any) -> tuple[Any, Any]:
            def one(carry: Any, entry: Any) -> tuple[Any, Any]:
                reaching, shared, index = entry

                def one_person(person: Any, carry: Any, reaching: Any, key: Any) -> tuple[Any, Any]:
                    return step(person, carry, reaching, shared, (key, index))

                of_people = jax.vmap(one_person, in_axes=(-1, -1, -1, 0), out_axes=-1)
                results: tuple[Any, Any] = of_people(person, carry, reaching, keys)
                return results

            index = first + jnp.arange(jax.tree.leaves(shared)[0].shape[0])
            return jax.lax.scan(one, carry, (reaching, shared, index))

        self._scan = jax.jit(scan)

    def run(
        self, person: Any, carry: Any, reaching: Any, shared: Any, keys: jax.Array, *, first: int = 0, threads: int = 1
    ) -> tuple[Any, Any]:
        """Run the mapped loop with JAX's own threads; see `Engine.run`."""
        del threads
        reaching = jax.tree.map(dense, reaching)
        with one_at_a_time:
            carry, outputs = jax.tree.map(np.asarray, self._scan(person, carry, reaching, shared, keys, first))
        return carry, outputs

    def lanes(self, number: int) -> Lanes:
        """Places for people in arrays; see `Engine.lanes`."""
        return _MappedLanes(self._one_sample, self._example, number)


class _MappedLanes:
    """Arrays of people, carried by JAX."""

    def __init__(self, step: Step, example: tuple[Any, Any], number: int) -> None:
        def of_lanes(leaf: Any) -> Array:
            shape = jax.eval_shape(jnp.asarray, leaf)
            return np.zeros((*shape.shape, number), shape.dtype)

        def one(person: Any, carry: Any, reaching: Any, data: Any, index: Any) -> tuple[Any, Any]:
            return step(person, carry, reaching, {}, (jax.random.wrap_key_data(data), index))

        self.person, self.carry = jax.tree.map(of_lanes, example)
        self._step = jax.jit(jax.vmap(one, in_axes=(-1, -1, -1, 0, 0), out_axes=-1))

    def step(self, reaching: Any, key_data: Array, index: Array, *, threads: int = 1) -> Any:
        """One sample of the mapped loop with JAX's own threads; see `Lanes.step`."""
        del threads
        with one_at_a_time:
            carry, outputs = self._step(self.person, self.carry, reaching, key_data, index)
            jax.tree.map(lambda to, new: np.copyto(to, np.asarray(new)), self.carry, carry)
            return jax.tree.map(np.asarray, outputs)


class _Room(threading.local):
    """Memory of a thread for what arrives, by precision. It is zero but while a kernel reads it."""

    def __init__(self) -> None:
        self._numbers: dict[Any, Array] = {}

    def of(self, shape: tuple[int, ...], dtype: Any) -> Array:
        """An array of zeros."""
        size, kept = math.prod(shape), self._numbers.get(dtype)
        if kept is None or kept.size < size:
            kept = self._numbers[dtype] = np.zeros(size, dtype)
        return kept[:size].reshape(shape)

    def drop(self, dtype: Any) -> None:
        """Forget the memory, of which somebody may have left a part as it was."""
        self._numbers.pop(dtype, None)


_room = _Room()


@contextlib.contextmanager
def _arriving(kernel: Kernel, samples: int, leaves: Sequence[Any], n: int) -> Iterator[Array]:
    """Inputs of people at all samples as the kernel takes them; lanes without anybody have zeros.

    What is zero almost everywhere is written where it is not, and that is cleared afterwards.
    """
    vectors, numbers, lanes = kernel.padded(n) // kernel.lanes, kernel.sizes["own"], kernel.lanes
    arriving = _room.of((vectors, samples, numbers, lanes), kernel.dtype)
    flat, whole, row, written = arriving.reshape(-1), n // lanes, 0, list[tuple[Array, Any]]()
    try:
        for leaf in leaves:
            size = math.prod(leaf.shape[1:-1])
            if isinstance(leaf, Sparse):
                # the number, sample and lane that a place in the leaf has in `arriving`
                within = leaf.row + leaf.row // size * (numbers - size) + row
                place = within * lanes + leaf.person + leaf.person // lanes * (samples * numbers - 1) * lanes
                written.append((flat, place))
                np.add.at(flat, place, leaf.number.astype(kernel.dtype))
            else:
                rows = np.s_[:, :, row : row + size]
                written.append((arriving, rows))
                part = np.asarray(leaf).reshape(samples, size, n)
                of_whole = part[..., : whole * lanes].reshape(samples, size, whole, lanes)
                arriving[:whole][rows] = of_whole.transpose(2, 0, 1, 3)
                if whole < vectors:
                    arriving[whole, :, row : row + size, : n - whole * lanes] = part[..., whole * lanes :]
            row += size
        yield arriving
        for array, places in written:
            array[places] = 0.0
    except BaseException:
        _room.drop(kernel.dtype)
        raise


def _rows(leaves: Sequence[Any], n: int, columns: int, dtype: Any) -> Array:
    """Numbers of people as rows; the columns that fill the last vector repeat the last person."""
    rows = [np.asarray(leaf).reshape(-1, n) for leaf in leaves]
    wide = np.empty((sum(row.shape[0] for row in rows), columns), dtype)
    if rows:
        np.concatenate(rows, out=wide[:, :n], casting="unsafe")
    wide[:, n:] = wide[:, n - 1 : n]
    return wide


def _tree(shapes: Any, rows: Array, *, axis: int) -> Any:
    """Rows along an axis, as the leaves of a tree of shapes."""
    like, structure = jax.tree.flatten(shapes)
    leaves, start = [], 0
    for leaf in like:
        part = rows[(slice(None),) * axis + (slice(start, start + leaf.size),)]
        leaves.append(part.reshape(*part.shape[:axis], *leaf.shape, part.shape[-1]))
        start += leaf.size
    return jax.tree.unflatten(structure, leaves)
