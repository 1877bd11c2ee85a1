"""Functions that JAX compiles, whose programs another process finds again without tracing them.

The name of a program is the digest of glucoloop's source, the arithmetic of the process, the function, what is static,
and structure, shapes and types of the arguments. Programs are kept where `glucoloop._disk_cache` has a folder of its
own. Where JAX keeps what it compiles, in the command line for one, it does so here too: a program that JAX has read
from its own folder cannot be written again. JAX's settings are left alone.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import pickle
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast, overload

import jax
import numpy as np
from jax._src import config, core
from jax.experimental import serialize_executable

from glucoloop import _disk_cache
from glucoloop._disk_cache import NoNameError
from glucoloop.arithmetic import identity

T = TypeVar("T")


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
        self._static = {static_argnums} if isinstance(static_argnums, int) else set(static_argnums)
        self._science = science
        self._jitted = jax.jit(function, static_argnums=tuple(sorted(self._static)))
        self._programs: dict[Any, Any] = {}
        self.lower = self._jitted.lower

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        numbers = [arg for place, arg in enumerate(args) if place not in self._static]
        program = self._program(args, numbers, kwargs) if not kwargs else None
        return self._jitted(*args, **kwargs) if program is None else program(*numbers)

    def _program(self, args: Sequence[Any], numbers: Sequence[Any], kwargs: Any) -> Any:
        """The program of one call; None where JAX has to do without one that is kept."""
        leaves, structure = jax.tree.flatten(numbers)
        if not core.trace_state_clean() or any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return None
        static = [args[place] for place in sorted(self._static) if place < len(args)]
        try:
            shapes = tuple(_shape(leaf) for leaf in leaves)
            key = (tuple(static), structure, shapes, config.trace_context())
            if key in self._programs:
                return self._programs[key]
            program = self._kept(args, static, structure, shapes)
        except (NoNameError, TypeError):  # a static argument without a hash among them, which JAX refuses itself
            return None
        self._programs[key] = program
        return program

    def _kept(self, args: Sequence[Any], static: Sequence[Any], structure: Any, shapes: Any) -> Any:
        if not _can_keep():
            return None
        told = (
            _disk_cache.name_of(inspect.unwrap(self._science)),
            sorted(self._static),
            [_key(value) for value in static],
            _disk_cache.structure_key(structure),
            shapes,
            [repr(value) for value in config.trace_context() if value is None or isinstance(value, (bool, int, str))],
            sorted(identity().items()),
        )
        compiled = list[Any]()

        def made() -> bytes:
            compiled.append(self._jitted.lower(*args).compile())
            return pickle.dumps(serialize_executable.serialize(compiled[0]))

        try:
            data = _disk_cache.kept((repr(told), _disk_cache.source()), made)
        except (NotImplementedError, ValueError, pickle.PicklingError, jax.errors.JaxRuntimeError):
            if not compiled:
                raise
            return compiled[0]  # JAX cannot write this one
        if compiled:
            return compiled[0]
        with contextlib.suppress(ImportError, AttributeError):
            from jaxlib import lapack

            # What lowering does: a program that is read may call LAPACK. The module of functions is JAX's own.
            getattr(lapack, "_lapack").initialize()  # noqa: B009
        return serialize_executable.deserialize_and_load(*pickle.loads(data))


def _can_keep() -> bool:
    """Whether this process keeps programs of its own, and computes on one processor as they do."""
    with contextlib.suppress(RuntimeError):
        usual = not any(getattr(jax.config, name) for name in ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs"))
        alone = jax.default_backend() == "cpu" and jax.local_device_count() == 1 and jax.process_count() == 1
        return usual and alone and _disk_cache.is_own() and not _disk_cache.is_changed()
    return False


def _shape(leaf: Any) -> tuple[Any, ...]:
    if isinstance(leaf, jax.Array):
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
