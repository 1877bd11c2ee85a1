"""A lowered function of one person and one sample, compiled and run for many people and all samples."""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._disk_cache import is_kept, kept
from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered
from glucoloop.native.program import SAMPLE
from glucoloop.native.targets import FUSED, STRICT
from glucoloop.native.targets.llvm.emit import Emitter
from glucoloop.refusal import Refusal

Array = npt.NDArray[Any]

_QUICK, _BEST = 0, 2
"""Levels of LLVM's code generation. The first takes a tenth of the time of the second, and what it makes up to twice as
long to run, with the same bits: no level changes the operations or their order.
"""
MANY_ROUNDS = 200_000
"""Rounds, of a vector of people over a sample, in which the best code saves what it takes longer to compile."""
_CODE_MODEL: Final = "small"
"""Constants lie near the code, so that no instruction has to load the address of one."""
_DIVISION: Final = 4
"""Time of a division in that of a product."""
_BESIDE: Final = 9.0
"""Operations that the processor carries out in the time from the beginning of one to its result, about."""

_LINE_BYTES: Final = 64
"""Length of a line of the cache, at whose beginning the room of a kernel lies."""

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


def _machine(level: int) -> Any:
    """LLVM's machine for this processor; each kernel has one, which ends with the kernel."""
    from llvmlite import binding

    name, features, _ = _processor()
    target = binding.Target.from_default_triple()
    return target.create_target_machine(cpu=name, features=features, opt=level, codemodel=_CODE_MODEL, jit=True)


def lanes(precision: str) -> int:
    """Number of people side by side in one vector."""
    return _processor()[2] // (64 if precision == DOUBLE else 32)


@functools.lru_cache(maxsize=8)
def _compiled(text: str, level: int) -> tuple[Any, int]:
    """Owner of the machine code, and its address; it is cached, since one process often makes the same loop again."""
    from llvmlite import binding

    machine = _machine(level)

    def compiled() -> bytes:
        module = binding.parse_assembly(text)
        module.verify()
        code: bytes = machine.emit_object(module)
        return code

    code = binding.ObjectFileRef.from_data(kept(_made_from(text, level), compiled))
    # llvmlite's memory manager puts all of an object into one place, as the code model needs it.
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine, use_lmm=True)
    engine.add_object_file(code)
    engine.finalize_object()
    return engine, engine.get_function_address("kernel")


def _made_from(text: str, level: int) -> tuple[str, ...]:
    """All that machine code depends on."""
    import llvmlite
    from llvmlite import binding

    name, features, _ = _processor()
    llvm, triple = ".".join(map(str, binding.llvm_version_info)), binding.get_default_triple()
    return text, triple, name, features, llvm, llvmlite.__version__, str(level), _CODE_MODEL


class Kernel:
    """Code that is compiled when it first runs; see `compile_kernel`.

    It is compiled quickly, and again for speed by the run in which so much is computed that this pays, or as soon as
    code for speed is kept from an earlier process. Both give the same bits.
    """

    def __init__(self, text: str, precision: str, sizes: dict[str, int], lanes: int, room: int) -> None:
        self._made_of = text, precision, sizes, lanes, room
        self.precision = precision
        self.dtype: Final = np.dtype(precision)
        self.lanes = lanes
        self.sizes = sizes
        self.text = text
        self._room = room * (1 << (lanes - 1).bit_length())  # as many as LLVM lays vectors apart
        self._rounds = 0
        self._level: int | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Kernel, self._made_of

    def _code_for(self, rounds: int) -> Callable[..., None]:
        """Code as good as pays for all rounds so far, these included."""
        with _lock:
            self._rounds += rounds
            if self._level != _BEST:
                many = self._rounds > MANY_ROUNDS
                if many or (self._level is None and is_kept(_made_from(self.text, _BEST))):
                    self._compile(_BEST)
                elif self._level is None:
                    self._compile(_QUICK)
            return self._call

    def _compile(self, level: int) -> None:
        self._engine, address = _compiled(self.text, level)
        pointer, whole = ctypes.c_void_p, ctypes.c_int64
        self._call: Callable[..., None] = ctypes.CFUNCTYPE(None, *[pointer] * 6, *[whole] * 4)(address)
        self._level = level

    def padded(self, people: int) -> int:
        """Number of columns of arrays for a number of people."""
        return -(-people // self.lanes) * self.lanes

    def by_vector(self, own: Array) -> Array:
        """Numbers ``(samples, numbers, people)`` as `run` takes those that reach people."""
        parts = np.asarray(own, self.dtype).reshape(*own.shape[:2], own.shape[2] // self.lanes, self.lanes)
        return np.ascontiguousarray(parts.transpose(2, 0, 1, 3))

    def run(self, person: Array, carry: Array, own: Array, shared: Array, outputs: Array, *, threads: int = 1) -> None:
        """Carry all people through all samples, in place.

        `person` and `carry` are (numbers, people) arrays, `own` (vectors, samples, numbers, lanes), `shared` (samples,
        numbers), and `outputs` (samples, numbers, people). The state at the end is written over `carry`, and the
        outputs over `outputs`.
        """
        samples, people = shared.shape[0], carry.shape[1]
        blocks = people // self.lanes
        pointers = [a.ctypes.data for a in (person, carry, own, shared, outputs)]
        for a in (person, carry, own, shared, outputs):
            if a.dtype != self.dtype or not a.flags.c_contiguous:
                raise TypeError(f"an array of {a.dtype} that is not contiguous, or not of {self.dtype}")
        edges = [blocks * i // threads for i in range(threads + 1)]
        code = self._code_for(blocks * samples)

        def part(i: int) -> None:
            room = np.empty(self._room + _LINE_BYTES // self.dtype.itemsize, self.dtype)
            begins = room.ctypes.data + -room.ctypes.data % _LINE_BYTES
            code(*pointers, begins, people, edges[i], edges[i + 1], samples)

        if threads == 1:
            part(0)
            return
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, range(threads)))


def compile_kernel(lowered: Lowered, *, products: str = FUSED, vectors: int = 1) -> Kernel:
    """Compile a lowered function for this processor, with products fused or strict (see `targets`).

    Each operation is carried out on so many `vectors` at once; see `vectors_at_once`.
    """
    if products not in (FUSED, STRICT):
        raise Refusal(f"products are {products!r}; the known ones are: {FUSED}, {STRICT}")
    width = lanes(lowered.precision)
    emitter = Emitter(lowered, products, width, vectors=vectors)
    text = emitter.text()
    return Kernel(text, lowered.precision, lowered.layout.sizes, vectors * width, emitter.room)


def vectors_at_once(lowered: Lowered) -> int:
    """Number of vectors, 1, 2 or 4, that fill the time in which the operations of a program wait for one another.

    Two fill more registers, too: it takes a long chain of operations, as of an integrator of many steps, to gain by it.
    """
    program, depth, operations = lowered.program, dict[int, int](), 0
    for value in program.needed(lowered.layout.results):
        operation, arguments = program.operations[value]
        if arguments and program.levels[value] == SAMPLE:
            operations += 1
            depth[value] = max(depth.get(a, 0) for a in arguments) + (_DIVISION if operation == "div" else 1)
    idle = _BESIDE * max(depth.values(), default=0) / max(operations, 1)
    return next(vectors for vectors in (4, 2, 1) if vectors <= max(idle, 1.0))
