"""Exact snapshots of states as bytes: versioned, with a digest, and refused for another owner."""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass
from typing import Annotated, Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.refusal import Refusal
from glucoloop.schema.values import ValueBounds, checked, json_value

T = TypeVar("T")

_MAGIC: Final = b"glucoloop snapshot "
_VERSION: Final = 1
_DIGEST_BYTES: Final = 32
_Shape = list[Annotated[int, ValueBounds(at_least=0, at_most=10**12)]]


@dataclass(frozen=True)
class _Header:
    """Owner of a snapshot, and type and shape of each array."""

    of: str
    arrays: list[Annotated[list[Any], ValueBounds(shortest=2, longest=2)]]


def pack(state: Any, of: str = "") -> bytes:
    """Bytes of a state.

    Parameters
    ----------
    state : pytree of arrays
        State of a stepper, a controller or an estimator, as ``init`` and ``step`` return it.
    of : str
        Name of the owner, such as a `fingerprint`; `unpack` asks for it again.
    """
    arrays = [_plain(leaf) for leaf in jax.tree.leaves(state)]
    header = {"of": of, "arrays": [[array.dtype.str, list(array.shape)] for array in arrays]}
    lines = _MAGIC + f"{_VERSION}\n{json.dumps(header)}\n".encode()
    data = lines + b"".join(array.tobytes() for array in arrays)
    return data + hashlib.sha256(data).digest()


def unpack(data: bytes, like: T, of: str = "") -> T:
    """State from the bytes of `pack`, to the same bits.

    Parameters
    ----------
    like : pytree of arrays
        Another state of the same kind, such as the one that ``init`` makes. An axis may have another length.
    of : str
        Name of the expected owner.

    Raises
    ------
    ValueError
        For bytes that are no snapshot, were cut short or changed, or are of another version, owner or kind.
    """
    if not isinstance(data, bytes) or not data.startswith(_MAGIC):
        raise Refusal("these bytes are no snapshot of glucoloop; give what was saved")
    version, _, rest = data.removeprefix(_MAGIC).partition(b"\n")
    if version != str(_VERSION).encode():
        result = version[:20].decode(errors="replace")
        raise Refusal(
            f"the snapshot is of version {result!r}, but this program reads version {_VERSION}; save it again"
        )
    body, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    if hashlib.sha256(body).digest() != digest:
        raise Refusal("the snapshot is damaged: its digest is not that of its content; take an earlier one")
    line, _, _ = rest.partition(b"\n")
    start = len(_MAGIC) + len(version) + len(line) + 2
    try:
        header = checked(_Header, json_value(line))
        arrays = [(pair[0], checked(_Shape, pair[-1], "a shape")) for pair in header.arrays]
    except Refusal as error:
        raise Refusal(f"the snapshot is damaged: {error}; take an earlier one") from None
    if header.of != of:
        raise Refusal(
            "the snapshot was taken elsewhere: its patient, sensor, pump, controller or one of their settings differs; "
            "restore it where it was saved"
        )
    leaves, structure = jax.tree.flatten(like)
    kinds = [(_plain(leaf).dtype.str, _plain(leaf).ndim) for leaf in leaves]
    if kinds != [(dtype, len(shape)) for dtype, shape in arrays]:
        raise Refusal("the snapshot holds a state of another kind; restore it where it was saved")
    sizes = [math.prod(shape) * np.dtype(dtype).itemsize for dtype, shape in arrays]
    if start + sum(sizes) != len(body):
        raise Refusal("the snapshot is damaged: its arrays are not as long as it says; take an earlier one")
    state_arrays = []
    for (dtype, shape), size, leaf in zip(arrays, sizes, leaves, strict=True):
        array = np.frombuffer(body[start : start + size], np.dtype(dtype)).reshape(shape)
        start += size
        state_arrays.append(jax.random.wrap_key_data(jnp.asarray(array)) if _is_key(leaf) else jnp.asarray(array))
    state: T = jax.tree.unflatten(structure, state_arrays)
    return state


def fingerprint(tree: Any) -> str:
    """Digest of all numbers of a tree and of its structure, the same in every process."""
    leaves, structure = jax.tree.flatten(tree)
    digest = hashlib.sha256(_without_addresses(str(structure)))
    for leaf in leaves:
        if isinstance(leaf, str) or callable(leaf):
            digest.update(_without_addresses(repr(leaf)))
        else:
            array = _plain(leaf)
            digest.update(f"{array.dtype.str}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def _without_addresses(text: str) -> bytes:
    return re.sub(r" at 0x[0-9a-f]+", "", text).encode()


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and bool(jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key))


def _plain(leaf: Any) -> np.ndarray[Any, np.dtype[Any]]:
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
