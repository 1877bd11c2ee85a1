"""Code of other packages: by an entry point, or named as ``module:attribute``.

A name of the second form is code wherever it stands. In Python all are taken; the command line takes those that were
typed, and not those of files, see `only_code`.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from glucoloop.refusal import Refusal

_CODE: dict[str, tuple[str, str]] = {}
"""Package or module of each part that was found elsewhere, and the digest of its code, by the name of the part."""


def outside_code(config: object) -> dict[str, str]:
    """Digests of the code of other packages that a configuration names, of which glucoloop's version says nothing."""
    found = dict(_CODE[name] for name in _parts_in(config))
    return {f"code of {package}": digest for package, digest in sorted(found.items())}


def names_code(config: object) -> bool:
    """Whether a configuration names code as ``module:attribute``."""
    return any(":" in name for name in _parts_in(config))


def _parts_in(config: object) -> Iterator[str]:
    """Names of the parts of other packages in a configuration."""
    if isinstance(config, str):
        name = config.partition(",")[0].strip()
        if name in _CODE:
            yield name
    elif isinstance(config, Mapping | list | tuple):
        for inner in config.values() if isinstance(config, Mapping) else config:
            yield from _parts_in(inner)


def _note_code(name: str, value: str) -> None:
    """Note the code of a part as it was when it was loaded: all files of its package, or the file of its module."""
    package = value.partition(":")[0].partition(".")[0]
    module = sys.modules.get(package)
    folders = [Path(folder) for folder in getattr(module, "__path__", ())]
    alone = getattr(module, "__file__", None)
    files = [file for folder in folders for file in sorted(folder.rglob("*.py"))] or ([Path(alone)] if alone else [])
    digest = hashlib.sha256()
    try:
        for file in files:
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    except OSError:
        return
    if files:
        _CODE[name] = package, digest.hexdigest()[:16]


@functools.cache
def entry_points(group: str) -> dict[str, str]:
    """Places that installed packages add to a group, ``"controllers"``, by name; nothing is imported."""
    import importlib.metadata  # slow, and needed for names of other packages only

    return {point.name: point.value for point in importlib.metadata.entry_points(group=f"glucoloop.{group}")}


_allowed: Callable[[str], bool] | None = None
"""Whether a name ``module:attribute`` may be imported; None: any."""
_from_here = False
"""Whether a part was found by such a name, so that what it names may lie in the current folder too."""


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

    What was found is kept, so that a module is looked for once. The current folder is searched only for a module that
    is named as ``module:attribute``.

    Parameters
    ----------
    group : str
        ``"controllers"``; the entry points of a package are then in ``glucoloop.controllers``.
    name : str
        Name of an entry point, or ``module:attribute`` of a module that Python finds or that lies in the current
        folder.

    Raises
    ------
    Refusal
        For a module that cannot be imported, a missing attribute, or code that only a file names.
    """
    points = entry_points(group)
    if ":" in name and _allowed is not None and not _allowed(name) and name not in points:
        raise Refusal(
            f"{name!r} names code that would be imported and run, and it stands in a file; give it on the command "
            "line too, or add --allow-code if you trust the file and the module"
        )
    return found(name, points.get(name, name)) if ":" in name or name in points else None


@functools.cache
def found(name: str, value: str) -> Any:
    """Object at a place, noted under the name by which it was asked for."""
    if name == value:
        global _from_here
        _from_here = True
    part = loaded(value)
    _note_code(name, value)
    return part


def loaded(value: str) -> Any:
    """Object that ``module:attribute`` names, in a module that Python finds.

    The current folder is searched too, last, once a part was found by such a name: nothing that lies there takes the
    place of an installed module.

    Raises
    ------
    ValueError
        For a module that cannot be imported, or a missing attribute.
    """
    module, _, attribute = value.partition(":")
    try:
        found: Any = _imported(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except AttributeError:
        raise Refusal(f"{module} has no {attribute}; name what it defines, like {module}:NAME") from None
    except Exception as error:  # whatever somebody else's module does when it is imported
        raise Refusal(f"{module} cannot be imported: {type(error).__name__}: {error}") from error
    return found


def _imported(module: str) -> Any:
    here = str(Path.cwd())
    if not _from_here or here in sys.path:
        return importlib.import_module(module)
    sys.path.append(here)
    try:
        return importlib.import_module(module)
    finally:
        sys.path.remove(here)
