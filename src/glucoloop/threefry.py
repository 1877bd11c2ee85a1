"""Counter-based random numbers: a value is a function of a seed, a name and two counters, and of nothing else.

The numbers of one person therefore do not depend on who else is drawn, in which order, or where. Everything is integer
arithmetic on the host, the same on every machine.

References
----------
J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3", Proc. SC11, 2011
(Threefry-2x32 of 20 rounds, which is also JAX's own).
"""

from __future__ import annotations

from typing import Any, Final

from glucoloop._lazy_jax import np, npt
from glucoloop.refusal import Refusal
from glucoloop.units import LARGEST_COUNTER

_PARITY: Final = 0x1BD11BDA
_ROTATIONS: Final = ((13, 15, 26, 6), (17, 29, 16, 24))
_BLOCK: Final = 1 << 14  # numbers at a time, which stay in the cache


def threefry_2x32(key: tuple[Any, Any], first: Any, second: Any) -> tuple[Any, Any]:
    """Encrypt two words of counters with a key of two words; all are of ``uint32``, arrays of NumPy or JAX."""
    keys = (*key, key[0] ^ key[1] ^ np.uint32(_PARITY))
    x, y = first + keys[0], second + keys[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = x + y
            y = ((y << np.uint32(rotation)) | (y >> np.uint32(32 - rotation))) ^ x
        x = x + keys[(group + 1) % 3]
        y = y + keys[(group + 2) % 3] + np.uint32(group + 1)
    return x, y


def name_word(name: str) -> int:
    """Word of 32 bits that represents a name, the same on every machine."""
    import hashlib  # slow, and not needed for help

    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")


def uniforms(
    seed: int, name: str, person: npt.ArrayLike, index: int | npt.NDArray[np.int64] = 0
) -> npt.NDArray[np.float64]:
    """Uniform numbers ``(n,)`` between 0 and 1, both excluded, multiples of 2**-53.

    Different names have independent numbers, and so have the indices of one name: one for all, or one for each number.
    Seed, persons and index are whole numbers from 0 to 2**32 - 1.
    """
    checked_counter("seed", seed)
    people = checked_people(person)
    for least_or_most in (index.min(initial=0), index.max(initial=0)) if isinstance(index, np.ndarray) else (index,):
        checked_counter("index", least_or_most)
    indices = np.broadcast_to(index, people.shape)
    key = (np.uint32(seed), np.uint32(name_word(name)))
    drawn = np.empty(people.shape)
    for start in range(0, people.size, _BLOCK):
        block = slice(start, start + _BLOCK)
        words = people[block].astype(np.uint32)
        high, low = threefry_2x32(key, words, indices[block].astype(np.uint32))
        # 52 bits and a half: exact in float64, and never 0 or 1
        bits = (high.astype(np.uint64) << np.uint64(20)) | (low.astype(np.uint64) >> np.uint64(12))
        drawn[block] = (bits.astype(np.float64) + 0.5) * 2.0**-52
    return drawn


def checked_counter(what: str, value: int) -> int:
    """The value, if it is a whole number from 0 to 2**32 - 1."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value <= LARGEST_COUNTER:
        raise Refusal(f"{what} is {value!r}; give a whole number from 0 to {LARGEST_COUNTER}")
    return int(value)


def checked_people(person: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Numbers of persons ``(n,)``, if all are whole numbers from 0 to 2**32 - 1."""
    people = np.asarray(person)
    if people.ndim != 1:
        raise Refusal(f"persons of shape {people.shape} are not possible; give their numbers in one row")
    if people.size and people.dtype.kind not in "iu":
        raise Refusal(f"persons are {people.dtype} numbers; give whole numbers from 0 to {LARGEST_COUNTER}")
    if people.size and not (people.min() >= 0 and people.max() <= LARGEST_COUNTER):
        worst = people.min() if people.min() < 0 else people.max()
        raise Refusal(f"person {worst} does not exist; give whole numbers from 0 to {LARGEST_COUNTER}")
    return people.astype(np.int64)
