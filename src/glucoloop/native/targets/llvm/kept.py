"""Machine code that is kept between processes, in the folder in which JAX keeps what it compiles, if it keeps anything.

The name of a file is the digest of all that the code was made from: the text of the module, the processor, LLVM's
version and settings. The file begins with a digest of its name and its code, so that one which is damaged, or which was
meant for another module, is compiled again. `storage.programs` keeps the command line's folder private and small.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import jax

SUFFIX: Final = ".machine-code"
"""End of the names of the files."""


def kept(made_from: Sequence[str], compiled: Callable[[], bytes]) -> bytes:
    """Machine code of a module: what is kept of it, or what `compiled` makes, which is then kept."""
    folder = jax.config.jax_compilation_cache_dir if jax.config.jax_enable_compilation_cache else None
    if not folder or "://" in folder:  # another computer's, which JAX alone reaches
        return compiled()
    name = hashlib.sha256("\0".join(made_from).encode()).hexdigest()
    place = Path(folder) / f"{name}{SUFFIX}"
    with contextlib.suppress(OSError):
        found = place.read_bytes()
        code = found[hashlib.sha256().digest_size :]
        if found == _sealed(name, code):
            return code
    code = compiled()
    with contextlib.suppress(OSError):
        _put(place, _sealed(name, code))
    return code


def _sealed(name: str, code: bytes) -> bytes:
    return hashlib.sha256(name.encode() + code).digest() + code


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
