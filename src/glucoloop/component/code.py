"""Code of other packages: by an entry point, or named as ``module:attribute``.

A name of the second form is code wherever it stands. In Python all are taken; the command line takes those that were
typed, and not those of files, see `only_code`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from glucoloop.refusal import Refusal

_CODE: dict[str, tuple[str, str]] = {}
"""Package or module of each component from elsewhere, and the digest of its code, by the name of the component."""


def outside_code(config: object) -> dict[str, str]:
    """Digests of the code of other packages that a configuration names, of which glucoloop's version says nothing."""
    result = dict(_CODE[name] for name in _outside_components(config))
    return {f"code of {package}": digest for package, digest in sorted(result.items())}


def names_code(config: object) -> bool:
    """Whether a configuration names code as ``module:attribute``."""
    return any(":" in name for name in _outside_components(config))


def _outside_components(config: object) -> Iterator[str]:
    """Names of the components of other packages in a configuration."""
    if isinstance(config, str):
        name = config.partition(",")[0].strip()
        if name in _CODE:
            yield name
    elif isinstance(config, Mapping | list | tuple):
        for inner in config.values() if isinstance(config, Mapping) else config:
            yield from _outside_components(inner)


def _note_code(name: str, value: str) -> None:
    """Note the code of a component when it is loaded: all files of its package, or the file of its module."""
    import hashlib  # slow, and not needed for help

    package = value.partition(":")[0].partition(".")[0]
    module = sys.modules.get(package)
    alone = getattr(module, "__file__", None)
    files = [file for folder in getattr(module, "__path__", ()) for file in sorted(Path(folder).rglob("*.py"))]
    files = files or ([Path(alone)] if alone else [])
    with contextlib.suppress(OSError):
        digests = b"".join(hashlib.sha256(file.read_bytes()).digest() for file in files)
        if files:
            _CODE[name] = package, hashlib.sha256(digests).hexdigest()[:16]


@functools.cache
def entry_points(group: str) -> dict[str, str]:
    """Places that installed packages add to a group, ``"controllers"``, by name; nothing is imported."""
    import importlib.metadata  # slow, and needed for names of other packages only

    return {point.name: point.value for point in importlib.metadata.entry_points(group=f"glucoloop.{group}")}


_allowed: Callable[[str], bool] | None = None
"""Whether a name ``module:attribute`` may be imported; None: any."""
_from_here = False
"""Whether a component was found by such a name, so that what it names may lie in the current folder too."""


@contextlib.contextmanager
def only_code(allowed: Callable[[str], bool]) -> Iterator[None]:
    """Import only some names ``module:attribute`` in the block; those of entry points are always imported.

    It holds for the process, since designs are made in threads.
    """
    global _allowed, _from_here
    before = _allowed, _from_here
    _allowed = allowed
    try:
        yield
    finally:
        _allowed, _from_here = before


def added(group: str, name: str) -> Any | None:
    """Object that a package adds under a name, or that ``module:attribute`` names; None if there is none.

    The entry points of a package for the group ``"controllers"`` are in ``glucoloop.controllers``. A module that is
    named as ``module:attribute`` may lie in the current folder. Code that only a file names is refused.
    """
    points = entry_points(group)
    if ":" in name and _allowed is not None and not _allowed(name) and name not in points:
        raise Refusal(
            f"{name!r} names code that would be imported and run, and it stands in a file",
            "give it on the command line too",
            "add --allow-code if you trust the file and the module",
        )
    return entry_point(name, points.get(name, name)) if ":" in name or name in points else None


@functools.cache
def entry_point(name: str, value: str) -> Any:
    """Object at a place, noted under the name by which it was asked for; a module is looked for once."""
    if name == value:
        global _from_here
        _from_here = True
    component = loaded(value)
    _note_code(name, value)
    return component


def loaded(value: str) -> Any:
    """Object that ``module:attribute`` names; Refusal for a module that cannot be imported, or a missing attribute.

    The current folder is searched too, last, once a component was found by such a name: nothing that lies there takes
    the place of an installed module.
    """
    module, _, attribute = value.partition(":")
    added = ""
    try:
        if _from_here and str(Path.cwd()) not in sys.path:
            added = str(Path.cwd())
            sys.path.append(added)
        result: Any = importlib.import_module(module)
        for name in attribute.split("."):
            result = getattr(result, name)
    except AttributeError:
        raise Refusal(f"{module} has no {attribute}; name what it defines, like {module}:NAME") from None
    except Exception as error:  # whatever somebody else's module does when it is imported
        if (
            isinstance(error, ModuleNotFoundError)
            and error.name is not None
            and f"{module}.".startswith(f"{error.name}.")
        ):
            mend = "check its name, and that it is installed for this Python or lies in this folder"
        else:
            mend = f"mend that in the module or what it imports, and try python -c 'import {module}'"
        raise Refusal(f"{module} cannot be imported: {type(error).__name__}: {error}", mend) from error
    finally:
        if added:
            sys.path.remove(added)
    return result
