"""What was computed once and is kept for other processes, where JAX keeps what it compiles, if it keeps anything.

The name of a file is the digest of all that it was made from. The file begins with a digest of its name and its data,
so that what is damaged, or was meant for another name, is computed again. `storage.programs` keeps the command line's
folder private and small.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import jax
import numpy as np

from glucoloop.arithmetic import identity

T = TypeVar("T")

SUFFIX: Final = ".kept"
"""End of the names of the files."""
_PLACES: Final = " at 0x"
"""Mark of an object that prints its place in memory, and not what it is."""


def kept(made_from: Sequence[str | bytes], made: Callable[[], bytes]) -> bytes:
    """Data that are kept, or those that `made` returns, which are then kept; `made_from` is all that they depend on."""
    folder = _folder()
    if folder is None:
        return made()
    parts = (part.encode() if isinstance(part, str) else part for part in made_from)
    name = hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()
    place = folder / f"{name}{SUFFIX}"
    with contextlib.suppress(OSError):
        found = place.read_bytes()
        data = found[hashlib.sha256().digest_size :]
        if found == _sealed(name, data):
            return data
    data = made()
    with contextlib.suppress(OSError):
        _put(place, _sealed(name, data))
    return data


def kept_result(function: Callable[..., T], **arguments: Any) -> T:
    """Result of a function of glucoloop, for trees of numbers as arguments; to the bit as it would be computed.

    It is kept by the source of the whole package, the arithmetic of the process, and the arguments. A tree that tells
    the place of a function in memory is no name for what the function does, so nothing is kept.
    """
    leaves, structure = jax.tree.flatten(arguments)
    numbers = [np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf) for leaf in leaves]
    told = repr((structure, [(type(leaf), number.dtype, number.shape) for leaf, number in zip(leaves, numbers, strict=True)]))
    if _PLACES in told or any(number.dtype.hasobject for number in numbers) or _folder() is None:
        return function(**arguments)
    name = f"{function.__module__}.{function.__qualname__}"
    made_from = (name, _source(), repr(sorted(identity().items())), told, *(number.tobytes() for number in numbers))
    result: T = pickle.loads(kept(made_from, lambda: pickle.dumps(function(**arguments))))
    return result


def _folder() -> Path | None:
    folder = jax.config.jax_compilation_cache_dir if jax.config.jax_enable_compilation_cache else None
    return None if not folder or "://" in folder else Path(folder)  # JAX alone reaches other computers


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


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
