"""JAX, NumPy and SciPy that are imported when they are first used, so that declarations may stand beside their science.

A module that declares settings writes ``from glucoloop._lazy_jax import jax, jnp`` in place of ``import jax``: help and
refusals then come at once. Importing JAX takes more than half a second.
"""

from __future__ import annotations

import functools
import importlib
import importlib.machinery
import importlib.util
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    import jax as jax
    import jax.numpy as jnp
    import numpy as np
    import numpy.typing as npt
    import scipy
    import scipy.linalg
else:

    class _Lazy:
        def __init__(self, module: str) -> None:
            self._module = module

        def __getattr__(self, name: str) -> Any:
            value = getattr(importlib.import_module(self._module), name)
            setattr(self, name, value)
            return value

    jax, jnp, np, npt, scipy = map(_Lazy, ("jax", "jax.numpy", "numpy", "numpy.typing", "scipy"))

__all__ = ["jax", "jit", "jnp", "np", "npt", "once_imported", "scipy"]

F = TypeVar("F", bound=Callable[..., Any])


def jit(**options: Any) -> Callable[[F], F]:
    """Decorator that is ``jax.jit`` with some options, applied when the function is first called."""

    def decorate(function: F) -> F:
        compiled = functools.cache(lambda: jax.jit(function, **options))

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            return compiled()(*args, **kwargs)

        return cast(F, call)

    return decorate


_actions: list[Callable[[], None]] = []


def once_imported(action: Callable[[], None]) -> None:
    """Do something at once if JAX has been imported, by whomever, and otherwise as soon as it has been."""
    if "jax" in sys.modules and hasattr(sys.modules["jax"], "config"):
        action()
        return
    if action not in _actions:
        _actions.append(action)
    if not any(isinstance(finder, _Hook) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Hook())


class _Hook:
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        del path, target
        if fullname != "jax":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        run = spec.loader.exec_module

        def run_and_act(module: ModuleType) -> None:
            run(module)
            while _actions:
                _actions.pop(0)()

        spec.loader.exec_module = run_and_act  # type: ignore[method-assign]
        return spec
