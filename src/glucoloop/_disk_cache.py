"""Data that were computed once and are kept for other processes, where JAX keeps what it compiles, if it does.

The name of a file is the digest of all that it was made from. The file begins with a digest of its name and its data,
so that what is damaged, or was meant for another name, is computed again. `storage.programs` keeps the command line's
folder private and small.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import os
import pickle
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any, Final, TypeVar

from glucoloop.arithmetic import identity

T = TypeVar("T")

SUFFIX: Final = ".kept"
"""End of the names of the files."""
_LARGEST: Final = 10_000
"""Most numbers of an array of which a result is kept."""
_MOST: Final = 16
"""Most results that a process adds: those of a start are few, and who asks for many has no use for a file of each."""
_left = 0
"""Number of results that may still be kept."""


def keep_results() -> None:
    """Have `kept_result` keep results from here on, in a process in which nobody replaces functions of glucoloop."""
    global _left
    _left = _MOST


def kept(made_from: Sequence[str | bytes], made: Callable[[], bytes]) -> bytes:
    """Data that are kept, or those that `made` returns, which are then kept; `made_from` is all that they depend on."""
    folder = _folder()
    if folder is None:
        return made()
    parts = (part.encode() if isinstance(part, str) else part for part in made_from)
    name = hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()
    place = folder / f"{name}{SUFFIX}"
    with contextlib.suppress(OSError):
        result = place.read_bytes()
        data = result[hashlib.sha256().digest_size :]
        if result == _sealed(name, data):
            return data
    data = made()
    with contextlib.suppress(OSError):
        _put(place, _sealed(name, data))
    return data


def kept_result(function: Callable[..., T], *arguments: Any, **named: Any) -> T:
    """Result of a function of glucoloop, to the bit as it would be computed.

    Where results are kept, they are so by the source of the whole package, the arithmetic of the process, and the
    arguments: trees of numbers of glucoloop's own classes. Code of others has no name that tells what it does, so what
    depends on it is not kept, and neither is what depends on large arrays.
    """
    if not _left or _folder() is None:
        return function(*arguments, **named)
    import jax

    leaves, structure = jax.tree.flatten((arguments, named))
    try:
        key = _named(inspect.unwrap(function)), _structure_key(structure)
        numbers = [_number_key(leaf) for leaf in leaves]
    except _NoNameError:
        return function(*arguments, **named)

    def made() -> bytes:
        global _left
        _left -= 1
        return pickle.dumps(function(*arguments, **named))

    made_from = (repr((key, sorted(identity().items()))), _source(), *(part for number in numbers for part in number))
    result: T = pickle.loads(kept(made_from, made))
    return result


class _NoNameError(Exception):
    """Something whose name does not tell all that it does."""


def _structure_key(structure: Any) -> Any:
    """Classes and static fields of a tree, in words that another process finds again."""
    node = structure.node_data()
    return (
        None
        if node is None
        else (_named(node[0]), _static(node[1]), [_structure_key(child) for child in structure.children()])
    )


def _static(value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if type(value) in (tuple, list):
        return [_static(part) for part in value]
    return _named(value)


def _named(value: Any) -> str:
    """Name of a class or function of a module of glucoloop or of Python itself."""
    if not isinstance(value, (type, FunctionType)) or "<" in value.__qualname__:
        raise _NoNameError
    if value.__module__.partition(".")[0] not in ("glucoloop", "builtins"):
        raise _NoNameError
    return f"{value.__module__}.{value.__qualname__}"


def _number_key(leaf: Any) -> tuple[str, bytes]:
    """Kind of a number or an array, and its bytes."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    if not isinstance(leaf, (bool, int, float, np.ndarray, np.generic, jax.Array)) or isinstance(leaf, jax.core.Tracer):
        raise _NoNameError
    data: Any = leaf
    is_key = isinstance(data, jax.Array) and bool(jnp.issubdtype(data.dtype, jax.dtypes.prng_key))
    array = np.asarray(jax.random.key_data(data) if is_key else data)
    if array.size > _LARGEST or array.dtype.hasobject:
        raise _NoNameError
    kind = type(leaf).__name__, is_key, getattr(leaf, "weak_type", False), array.dtype.str, array.shape
    return repr(kind), array.tobytes()


def _folder() -> Path | None:
    import jax

    on, folder = (jax.config.values[f"jax_{name}"] for name in ("enable_compilation_cache", "compilation_cache_dir"))
    return Path(folder) if on and folder and "://" not in folder else None  # JAX alone reaches other computers


@functools.cache
def _source() -> bytes:
    """Digest of all modules of the package."""
    folder = Path(__file__).parent
    files = sorted(folder.rglob("*.py"))
    return b"".join(hashlib.sha256(bytes(file.relative_to(folder)) + file.read_bytes()).digest() for file in files)


def _sealed(name: str, data: bytes) -> bytes:
    return hashlib.sha256(name.encode() + data).digest() + data


def _put(place: Path, data: bytes) -> None:
    """Write a file completely or not at all."""
    descriptor, part = tempfile.mkstemp(SUFFIX, ".", place.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        os.replace(part, place)
    except BaseException:
        os.unlink(part)
        raise
