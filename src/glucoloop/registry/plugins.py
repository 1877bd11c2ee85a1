"""Parts from other packages: by an entry point, or named as ``module:attribute``."""

from __future__ import annotations

import functools
import hashlib
import importlib
import importlib.metadata
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol, TypeVar

from glucoloop.refusal import Refusal
from glucoloop.registry.settings import known_names


class Named(Protocol):
    """Anything with a name."""

    @property
    def name(self) -> str:
        """Name under which it is found."""
        ...


E = TypeVar("E", bound=Named)


class Catalogue(dict[str, E]):
    """Entries of one kind by name: those of this package, to which `find` adds those of other packages.

    Parameters
    ----------
    what : str
        Kind in messages, ``"controller"``; entry points of packages are in the group ``glucoloop.controllers``.
    kind : type
        Class of the entries.
    entries : iterable
        Entries of this package.
    """

    def __init__(self, what: str, kind: type[E], entries: Iterable[E]) -> None:
        super().__init__({entry.name: entry for entry in entries})
        self._what, self._kind, self._group = what, kind, f"{what}s"

    def find(self, name: str) -> E:
        """An entry by name: of this package, of another one, or ``module:attribute``.

        Raises
        ------
        ValueError
            For an unknown name, or an entry of another package that cannot be loaded.
        """
        entry: E | None = self.get(name) or added(self._group, name, self._kind)
        if entry is None:
            raise Refusal(f"unknown {self._what} {name!r}; {known_names(name, self.names())}")
        return entry

    def names(self) -> list[str]:
        """Names of all entries, those of other packages included."""
        return [*self, *added_names(self._group)]


_CODE: dict[str, tuple[str, str]] = {}
"""Package or module of each part that was found elsewhere, and the digest of its code, by the name of the part."""


def code_of(names: Iterable[str]) -> dict[str, str]:
    """Digests of the code of other packages from which parts of these names were loaded; other names are left out."""
    found = dict(_CODE[name] for name in names if name in _CODE)
    return {f"code of {package}": digest for package, digest in sorted(found.items())}


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


def added_names(group: str) -> list[str]:
    """Names that installed packages add to a group; the packages are not imported."""
    return sorted(point.name for point in importlib.metadata.entry_points(group=f"glucoloop.{group}"))


@functools.cache
def added(group: str, name: str, kind: type) -> Any | None:
    """Object that a package adds under a name, or that ``module:attribute`` names; None if there is none.

    What was found is kept, so that a module is looked for once.

    Parameters
    ----------
    group : str
        ``"controllers"``; the entry points of a package are then in ``glucoloop.controllers``.
    name : str
        Name of an entry point, or ``module:attribute`` of a module that Python finds or that lies in the current
        folder.
    kind : type
        Expected type of the object.

    Raises
    ------
    ValueError
        For a module that cannot be imported, a missing attribute, or one of another type.
    """
    for point in importlib.metadata.entry_points(group=f"glucoloop.{group}"):
        if point.name == name:
            return _found(name, point.value, kind)
    return _found(name, name, kind) if ":" in name else None


def _found(name: str, value: str, kind: type) -> Any:
    found = _of_kind(loaded(value), value, kind)
    _note_code(name, value)
    return found


def loaded(value: str) -> Any:
    """Object that ``module:attribute`` names, in a module that Python finds or that lies in the current folder.

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


def made_by(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Result of a function that an entry names.

    Raises
    ------
    ValueError
        With the words of the function, where it refuses what it is given: that is as much the user's mistake in
        another package as in this one, while an error further down is a mistake of the package.
    """
    try:
        return function(*args, **kwargs)
    except Refusal:
        raise
    except ValueError as error:
        [*_, (frame, _)] = traceback.walk_tb(error.__traceback__)
        raised_by = str(frame.f_globals.get("__name__")).partition(".")[0]
        if raised_by != function.__module__.partition(".")[0] or raised_by == __name__.partition(".")[0]:
            raise
        raise Refusal(str(error)) from error


def _imported(module: str) -> Any:
    here = str(Path.cwd())
    if here in sys.path:
        return importlib.import_module(module)
    sys.path.insert(0, here)
    try:
        return importlib.import_module(module)
    finally:
        sys.path.remove(here)


def _of_kind(found: Any, name: str, kind: type) -> Any:
    if not isinstance(found, kind):
        raise Refusal(f"{name} is an instance of {type(found).__name__}; it has to be one of {kind.__name__}")
    return found
