"""Data that were computed once and are kept for other processes: in a folder, or where the user's JAX keeps its own.

The name of a file is the digest of all that it was made from. The file begins with a digest of its name and its data,
so that what is damaged, or was meant for another name, is computed again. The folder is private and small, and the same
for Python and for the command line, which has JAX keep there what `_kept_programs` does not.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import inspect
import operator
import os
import pickle
import stat
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, ParamSpec, TypeVar

from glucoloop.arithmetic import identity
from glucoloop.private_folder import refuse_of_others
from glucoloop.refusal import Refusal

P = ParamSpec("P")
T = TypeVar("T")

VARIABLE: Final = "GLUCOLOOP_CACHE_DIR"
"""Variable that names the folder of what is kept; ``off`` keeps nothing."""
MAX_BYTES: Final = 256_000_000
"""Largest size of all entries of a folder together; the oldest are removed first."""

SUFFIX: Final = ".kept"
"""End of the names of the files."""
_LARGEST: Final = 10_000
"""Most numbers of an array of which a result is kept."""
ENDS: Final = ("-cache", SUFFIX)
"""Ends of the names of entries: JAX's, and those of this module."""
_KNOWN: Final = sys.stdlib_module_names | {
    *("builtins", "glucoloop", "gymnasium", "jax", "lazy_loader", "matplotlib", "numpy", "polars", "scipy")
}
"""Packages whose functions stand in modules of glucoloop."""
_MOST: Final = 32
"""Most results that a process adds: those of a start are few, and who asks for many has no use for a file of each."""
_left = _MOST
"""Number of results that may still be kept."""


def cache_folder() -> Path | None:
    """Folder of what is kept, which may not exist yet; None if nothing is to be kept."""
    import platformdirs

    value = os.environ.get(VARIABLE, "").strip()
    if value.lower() == "off":
        return None
    return Path(value or Path(platformdirs.user_cache_dir("glucoloop", appauthor=False)) / "compiled")


def keeps_result(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator of a function whose results are those of `kept_result`."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        return kept_result(function, *args, **kwargs)

    return call


def kept(made_from: Sequence[str | bytes], made: Callable[[], bytes]) -> bytes:
    """Data that are kept, or those that `made` returns, which are then kept; `made_from` is all that they depend on."""
    folder = _folder()
    if folder is None:
        return made()
    name = _name_for(made_from)
    data = _read(folder, name)
    if data is None:
        data = made()
        with contextlib.suppress(OSError):
            _put(folder / f"{name}{SUFFIX}", _sealed(name, data))
    return data


def is_kept(made_from: Sequence[str | bytes]) -> bool:
    """Whether `kept` has data without making them."""
    folder = _folder()
    return folder is not None and _read(folder, _name_for(made_from)) is not None


def _name_for(made_from: Sequence[str | bytes]) -> str:
    parts = (part.encode() if isinstance(part, str) else part for part in made_from)
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()


def _read(folder: Path, name: str) -> bytes | None:
    """Data of a name; None where there are none, or what is there is damaged or of another name."""
    with contextlib.suppress(OSError):
        result = (folder / f"{name}{SUFFIX}").read_bytes()
        data = result[hashlib.sha256().digest_size :]
        if result == _sealed(name, data):
            return data
    return None


def kept_result(function: Callable[..., T], *arguments: Any, **named: Any) -> T:
    """Result of a function of glucoloop, to the bit as it would be computed.

    Where results are kept, they are so by the source of the whole package, the arithmetic of the process, and the
    arguments: trees of numbers of glucoloop's own classes. Code of others has no name that tells what it does, so what
    depends on it is not kept, and neither is what depends on large arrays. A process in which somebody has replaced a
    function of glucoloop keeps nothing and finds nothing.
    """
    if not _left or _folder() is None:
        return function(*arguments, **named)
    import jax

    leaves, structure = jax.tree.flatten((arguments, named))
    try:
        key = name_of(inspect.unwrap(function)), structure_key(structure)
        numbers = [_number_key(leaf) for leaf in leaves]
    except NoNameError:
        return function(*arguments, **named)
    if is_changed():
        return function(*arguments, **named)

    computed = list[T]()

    def made() -> bytes:
        global _left
        computed.append(function(*arguments, **named))
        data = pickle.dumps(computed[0])
        _left -= 1
        return data

    made_from = (repr((key, sorted(identity().items()))), source(), *(part for number in numbers for part in number))
    try:
        data = kept(made_from, made)
    except NoNameError:  # a result that another process would not understand
        if computed:
            return computed[0]
        raise
    try:
        result: T = pickle.loads(data)
    except Exception:  # not what this program writes; a slower start is no reason to stop
        return function(*arguments, **named)
    return result


class NoNameError(Exception):
    """Something whose name does not tell all that it does."""


def structure_key(structure: Any) -> Any:
    """Classes and static fields of a tree, in words that another process finds again."""
    node = structure.node_data()
    if node is None:
        return None
    kind, fields = node
    static = [static_key(part) for part in fields] if type(fields) in (tuple, list) else static_key(fields)
    return name_of(kind), static, [structure_key(child) for child in structure.children()]


def static_key(value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if type(value) in (tuple, list):
        if any(isinstance(part, str) for part in value):
            raise NoNameError  # they may name what a user adds
        return [static_key(part) for part in value]
    return name_of(value)


def name_of(value: Any) -> str:
    """Name of a class or function of a module of glucoloop or of Python itself."""
    if not isinstance(value, (type, FunctionType)) or "<" in value.__qualname__:
        raise NoNameError
    if value.__module__.partition(".")[0] not in ("glucoloop", "builtins"):
        raise NoNameError
    return f"{value.__module__}.{value.__qualname__}"


def _number_key(leaf: Any) -> tuple[str, bytes]:
    """Kind of a number or an array, and its bytes."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    if isinstance(leaf, str):
        return "str", leaf.encode()
    if isinstance(leaf, jax.ShapeDtypeStruct):
        return repr(("shape", leaf.shape, str(leaf.dtype), leaf.weak_type)), b""
    if not isinstance(leaf, (bool, int, float, np.ndarray, np.generic, jax.Array)) or isinstance(leaf, jax.core.Tracer):
        raise NoNameError
    data: Any = leaf
    is_key = isinstance(data, jax.Array) and bool(jnp.issubdtype(data.dtype, jax.dtypes.prng_key))
    array = np.asarray(jax.random.key_data(data) if is_key else data)
    if array.size > _LARGEST or array.dtype.hasobject:
        raise NoNameError
    kind = type(leaf).__name__, is_key, getattr(leaf, "weak_type", False), array.dtype.str, array.shape
    return repr(kind), array.tobytes()


def is_changed() -> bool:
    """Whether some code that is no part of glucoloop stands in place of a function or method of it.

    What is kept is named by the files, which do not tell of it. Nor do they of a constant that somebody has replaced.
    """
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == __package__ and type(module) is ModuleType:  # a lazy one has not been loaded yet
            values = list(vars(module).values())
            classes, before = _own.get(name, ([], []))
            if not _same(values, before[: len(values)]):
                # isinstance loads lazy modules
                classes = [v for v in values if issubclass(type(v), type) and v.__module__ == name]
            members = values + [member for of_class in classes for member in vars(of_class).values()]
            if _same(members, before):
                continue
            if any(type(member) is FunctionType and not _is_known(member) for member in members):
                return True
            _own[name] = classes, members
    return False


_own: dict[str, tuple[list[type], list[Any]]] = {}
"""Classes of the modules in which all was glucoloop's own, and all members: comparing them with these is quick."""


def _same(values: list[Any], others: list[Any]) -> bool:
    return len(values) == len(others) and all(map(operator.is_, values, others))


def _is_known(function: FunctionType) -> bool:
    return function.__globals__.get("__name__", "").partition(".")[0] in _KNOWN


def _folder() -> Path | None:
    import jax

    on, folder = (jax.config.values[f"jax_{name}"] for name in ("enable_compilation_cache", "compilation_cache_dir"))
    if on and folder:
        return Path(folder) if "://" not in folder else None  # JAX alone reaches other computers
    return own_folder()


def is_own() -> bool:
    """Whether what is kept is in glucoloop's own folder."""
    folder = own_folder()
    return folder is not None and _folder() == folder


def own_folder() -> Path | None:
    """The folder of glucoloop's own, private and small; None where nothing is to be kept or none can be private."""
    folder = cache_folder()
    return None if folder is None else _prepared(folder)


@functools.cache
def _prepared(folder: Path) -> Path | None:
    with contextlib.suppress(OSError, Refusal):
        private_folder(folder)
        remove_oldest(folder)
        return folder
    return None


def private_folder(folder: Path) -> None:
    """Make a folder that only this user can use; Refusal for one that others own, can write to or can replace."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(0o700)
    mode = folder.lstat().st_mode
    if not stat.S_ISDIR(mode):
        kind = "a symbolic link" if stat.S_ISLNK(mode) else "a file"
        raise Refusal(f"{folder} is {kind}, not a folder")
    if os.name == "nt":
        return
    refuse_of_others(folder)
    if stat.S_IMODE(mode) != 0o700:
        folder.chmod(0o700)
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))


def entries(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Files of a folder that hold what is kept, the newest first."""
    results = list[tuple[Path, os.stat_result]]()
    with contextlib.suppress(FileNotFoundError):
        for place in folder.iterdir():
            with contextlib.suppress(OSError):
                status = place.lstat()
                if place.name.endswith(ENDS) and stat.S_ISREG(status.st_mode):
                    results.append((place, status))
    return sorted(results, key=lambda entry: entry[1].st_mtime, reverse=True)


def remove_oldest(folder: Path, max_bytes: int = MAX_BYTES) -> None:
    """Remove the oldest entries beyond a total size."""
    total = 0
    for place, status in entries(folder):
        total += status.st_size
        if total > max_bytes:
            with contextlib.suppress(OSError):
                place.unlink()


@functools.cache
def source() -> bytes:
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
