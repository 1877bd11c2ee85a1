"""A function of one person and one sample, compiled for many people and all samples."""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.native.chunks import Layout
from glucoloop.native.divisions import share_divisions
from glucoloop.native.drawing import Drawing
from glucoloop.native.emit import Emitter
from glucoloop.native.flatten import Flattener, Values, kind_of
from glucoloop.native.functions import DOUBLE
from glucoloop.native.program import PERSON, SAMPLE, Program

Array = npt.NDArray[Any]

_lock = threading.Lock()  # LLVM is started and asked for code by one thread at a time


@functools.lru_cache(maxsize=1)
def _processor() -> tuple[str, str, int]:
    """Name and features of this processor, and the bits of its vectors."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    features = binding.get_host_cpu_features()
    bits = 512 if features.get("avx512f") else 256 if features.get("avx2") else 128
    return binding.get_host_cpu_name(), features.flatten(), bits


def _machine() -> Any:
    """LLVM for this processor: one for each kernel, which ends with it."""
    from llvmlite import binding

    name, features, _ = _processor()
    target = binding.Target.from_default_triple()
    return target.create_target_machine(cpu=name, features=features, opt=2, jit=True)


def lanes(precision: str) -> int:
    """People side by side in one vector."""
    return _processor()[2] // (64 if precision == DOUBLE else 32)


class Kernel:
    """Compiled code; see `compile_kernel`."""

    def __init__(self, text: str, precision: str, sizes: dict[str, int]) -> None:
        from llvmlite import binding

        self.precision = precision
        self.dtype: Final = np.dtype(precision)
        self.lanes = lanes(precision)
        self.sizes = sizes
        self.text = text
        with _lock:
            module = binding.parse_assembly(text)
            module.verify()
            self._engine = binding.create_mcjit_compiler(module, _machine())
            self._engine.finalize_object()
            address = self._engine.get_function_address("kernel")
        pointer, whole = ctypes.c_void_p, ctypes.c_int64
        self._call = ctypes.CFUNCTYPE(None, *[pointer] * 5, *[whole] * 4)(address)

    def padded(self, people: int) -> int:
        """Columns that arrays for so many people have."""
        return -(-people // self.lanes) * self.lanes

    def run(self, person: Array, carry: Array, own: Array, shared: Array, outputs: Array, *, threads: int = 1) -> None:
        """Carry all people through all samples, in place.

        Parameters
        ----------
        person : (numbers, people) array
        carry : (numbers, people) array
            At the start; afterwards at the end.
        own : (samples, numbers, people) array
        shared : (samples, numbers) array
        outputs : (samples, numbers, people) array
            Is written.
        threads : int
        """
        samples, people = shared.shape[0], carry.shape[1]
        blocks = people // self.lanes
        pointers = [a.ctypes.data for a in (person, carry, own, shared, outputs)]
        for a in (person, carry, own, shared, outputs):
            if a.dtype != self.dtype or not a.flags.c_contiguous:
                raise TypeError(f"an array of {a.dtype} that is not contiguous, or not of {self.dtype}")
        edges = [blocks * i // threads for i in range(threads + 1)]

        def part(i: int) -> None:
            self._call(*pointers, people, edges[i], edges[i + 1], samples)

        if threads == 1:
            part(0)
            return
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, range(threads)))


def _inputs(program: Program, leaves: Sequence[Any], name: str, level: int) -> list[Values]:
    """A value for each element of each leaf."""
    made = []
    for position, leaf in enumerate(leaves):
        shape = tuple(leaf.shape)
        flat = [program.input((name, position, i), level, kind_of(leaf)) for i in range(int(np.prod(shape, dtype=int)))]
        made.append(np.array(flat, np.int64).reshape(shape))
    return made


def _flat(values: Sequence[Values]) -> list[int]:
    return [int(v) for array in values for v in array.ravel()]


def compile_kernel(
    step: Callable[..., tuple[Any, Any]],
    person: Any,
    carry: Any,
    own: Any,
    shared: Any,
    chance: Any = (),
    *,
    precision: str = DOUBLE,
) -> tuple[Kernel, Drawing]:
    """Compile ``carry, outputs = step(person, carry, own, shared, chance)``.

    Parameters
    ----------
    step : callable
        A pure JAX function of one person and one sample.
    person, carry, own, shared, chance : pytrees of arrays or shapes, without a people axis
        What a person is; what is handed on; what reaches him, and what reaches everybody, at a sample; random keys and
        the number of the sample.
    precision : {"float64", "float32"}

    Returns
    -------
    kernel : Kernel
    drawing : Drawing
        What has to be computed of `chance` beforehand; it reaches the kernel as the last rows of `own`.

    Raises
    ------
    UnsupportedError
        If the function does what straight-line code cannot.
    """
    groups = (person, carry, own, shared, chance)
    shapes = jax.eval_shape(lambda *of: of, *groups)
    closed = jax.make_jaxpr(step)(*shapes)
    program = Program()
    flattener = Flattener(program, precision)
    names, levels = ("person", "carry", "own", "shared"), (PERSON, SAMPLE, SAMPLE, SAMPLE)
    made = [
        _inputs(program, jax.tree.leaves(group), name, level)
        for group, name, level in zip(shapes[:4], names, levels, strict=True)
    ]
    keys = [flattener.chance(leaf) for leaf in jax.tree.leaves(shapes[4])]
    results = flattener.run(closed, [*(leaf for group in made for leaf in group), *keys])
    drawing, drawn = flattener.drawing()
    carried = len(made[1])
    program, place = share_divisions(program, _flat(results))

    def flat(values: Sequence[Values]) -> list[int]:
        return [place[v] for v in _flat(values)]

    layout = Layout(
        person=flat(made[0]),
        carry=flat(made[1]),
        own=flat([*made[2], *drawn]),
        shared=flat(made[3]),
        next_carry=flat(results[:carried]),
        outputs=flat(results[carried:]),
    )
    text = Emitter(program, layout, precision, lanes(precision)).text()
    sizes = {name: len(getattr(layout, name)) for name in ("person", "carry", "own", "shared", "outputs")}
    return Kernel(text, precision, sizes), drawing
