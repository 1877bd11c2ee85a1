"""Functions that JAX compiles, whose programs another process finds again without tracing them.

The name of a program is the digest of glucoloop's source, the arithmetic of the process, the function, what is static,
and structure, shapes and types of the arguments. Programs are kept in the folder of `glucoloop._disk_cache`, in Python
and by the command line, and JAX's settings are left alone. JAX's own cache never has them: a program that JAX has read
from there cannot be written again. Where the user has given JAX a folder, JAX keeps them there, as it does all others.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
import pickle
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar, cast, overload

import jax
import numpy as np
from jax._src import config, core
from jax._src.array import ArrayImpl
from jax.experimental import serialize_executable

from glucoloop import _disk_cache
from glucoloop._disk_cache import NoNameError
from glucoloop.arithmetic import identity

T = TypeVar("T")

_MANY: Final = 20_000
"""Calls of a function after which JAX compiles it for itself: it finds a program .08 ms sooner in each call, which
by then has cost as much as compiling does.
"""


@overload
def kept_jit(function: Callable[..., T], /) -> Callable[..., T]: ...


@overload
def kept_jit(
    *, static_argnums: int | Sequence[int] = (), science: Callable[..., Any] | None = None
) -> Callable[[Callable[..., T]], Callable[..., T]]: ...


def kept_jit(
    function: Any = None, *, static_argnums: int | Sequence[int] = (), science: Callable[..., Any] | None = None
) -> Any:
    """`jax.jit` of a function of a module, which keeps its programs; static arguments are given by place.

    `science` is the function of a module that `function`, which has no name of its own, calls.
    """
    if function is None:
        return lambda function: functools.wraps(function)(_Program(function, static_argnums, science or function))
    return functools.wraps(function)(_Program(function, static_argnums, science or function))


class _Program:
    def __init__(
        self, function: Callable[..., Any], static_argnums: int | Sequence[int], science: Callable[..., Any]
    ) -> None:
        self._static = sorted({static_argnums} if isinstance(static_argnums, int) else set(static_argnums))
        self._science = science
        self._jitted = jax.jit(function, static_argnums=tuple(self._static))
        self._programs: dict[Any, list[tuple[list[Any], Any]]] = {}
        self._calls = 0
        self.lower = self._jitted.lower

        def own(*args: Any) -> Any:
            return function(*args)

        own.__name__ = own.__qualname__ = f"kept_{science.__name__}"  # the name of no program in JAX's own cache
        self._own = jax.jit(own, static_argnums=tuple(self._static))

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self._calls += 1
        if self._calls > _MANY:
            return self._jitted(*args, **kwargs)
        numbers = [arg for place, arg in enumerate(args) if place not in self._static]
        program = self._program(args, numbers) if not kwargs else None
        return self._jitted(*args, **kwargs) if program is None else program(*numbers)

    def _program(self, args: Sequence[Any], numbers: Sequence[Any]) -> Any:
        """The program of one call; None where JAX has to do without one that is kept."""
        if not core.trace_state_clean():
            return None
        leaves, structure = jax.tree.flatten(numbers)
        static = [args[place] for place in self._static if place < len(args)]
        try:
            # A stepper comes here with a hundred arrays in each sample: their kinds are compared, which is quick, and
            # not hashed, which is slow.
            kinds = [(a.shape, a.dtype, a.weak_type) if type(a) is ArrayImpl else _shape(a) for a in leaves]
            programs = self._programs.setdefault((tuple(static), structure, config.trace_context()), [])
        except (NoNameError, TypeError, ValueError):  # what has no hash, or cannot be compared: JAX refuses or takes it
            return None
        for of_program, program in programs:
            if of_program == kinds:
                return program
        result = None
        with contextlib.suppress(NoNameError):
            result = self._kept(args, static, structure, [_shape(leaf) for leaf in leaves])
        programs.append((kinds, result))
        return result

    def _kept(self, args: Sequence[Any], static: Sequence[Any], structure: Any, shapes: Any) -> Any:
        """A program that is kept, or one that is compiled and then kept; None where none can be."""
        if not _can_keep():
            return None
        made_from = (
            _disk_cache.name_of(inspect.unwrap(self._science)),
            self._static,
            [_key(value) for value in static],
            _disk_cache.structure_key(structure),
            shapes,
            [repr(value) for value in config.trace_context() if value is None or isinstance(value, (bool, int, str))],
            sorted(identity().items()),
        )
        compiled = list[Any]()

        def made() -> bytes:
            with config.persistent_cache_min_compile_time_secs(math.inf):  # here JAX's own cache does not keep it
                compiled.append(self._own.lower(*args).compile())
            return _written(compiled[0])

        with contextlib.suppress(_NotWrittenError):
            data = _disk_cache.kept((repr(made_from), _disk_cache.source()), made)
            if not compiled:
                return _read(data)
        return compiled[0] if compiled else None


class _NotWrittenError(Exception):
    """A program that cannot be kept, or not be read again."""


def _written(compiled: Any) -> bytes:
    """A program as bytes."""
    parts = getattr(getattr(compiled, "_executable", None), "_unloaded_executable", None)
    if parts is None or parts.host_callbacks or parts.keepalive:  # addresses in this process
        raise _NotWrittenError
    try:
        calls_lapack = "lapack" in compiled.as_text()
        return pickle.dumps((calls_lapack, serialize_executable.serialize(compiled)))
    except Exception as error:  # JAX has many kinds, and the program runs without being kept
        raise _NotWrittenError from error


def _read(data: bytes) -> Any:
    """A program of its bytes."""
    try:
        calls_lapack, program = pickle.loads(data)
        if calls_lapack:
            from jaxlib import lapack

            # What lowering does, and what imports SciPy. The module of functions is JAX's own.
            getattr(lapack, "_lapack").initialize()  # noqa: B009
        return serialize_executable.deserialize_and_load(*program)
    except Exception as error:  # not what this version writes; it is compiled instead
        raise _NotWrittenError from error


def _can_keep() -> bool:
    """Whether this process keeps programs of its own, and computes on one processor as they do."""
    with contextlib.suppress(RuntimeError):
        usual = not any(getattr(jax.config, name) for name in ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs"))
        alone = jax.default_backend() == "cpu" and jax.local_device_count() == 1 and jax.process_count() == 1
        return usual and alone and _disk_cache.is_own() and not _disk_cache.is_changed()
    return False


def _shape(leaf: Any) -> tuple[Any, ...]:
    if isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer):
        return leaf.shape, str(leaf.dtype), bool(getattr(leaf, "weak_type", False))
    if isinstance(leaf, (bool, int, float)):
        return (), type(leaf).__name__, True
    if isinstance(leaf, (np.ndarray, np.generic)) and not leaf.dtype.hasobject:
        return np.shape(leaf), leaf.dtype.str, False
    raise NoNameError


def _key(value: Any) -> Any:
    """A static argument in words that another process finds again."""
    if isinstance(value, jax.tree_util.PyTreeDef):
        return _disk_cache.structure_key(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _disk_cache.name_of(type(value)), [_key(part) for part in vars(value).values()]
    if type(value) in (tuple, list):
        return [_key(part) for part in cast("Sequence[Any]", value)]
    if isinstance(value, str):  # it may name what a user adds
        raise NoNameError
    return _disk_cache.static_key(value)
