"""Parts from other packages: by an entry point, or named as ``module:attribute``.

A name of the second form is code wherever it stands. In Python all are taken; the command line takes those that were
typed, and not those of files, see `only_code`.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import importlib.metadata
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
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


def added_names(group: str) -> list[str]:
    """Names that installed packages add to a group; the packages are not imported."""
    return sorted(point.name for point in importlib.metadata.entry_points(group=f"glucoloop.{group}"))


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


def added(group: str, name: str, kind: type) -> Any | None:
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
    kind : type
        Expected type of the object.

    Raises
    ------
    ValueError
        For a module that cannot be imported, a missing attribute, one of another type, or code that only a file names.
    """
    if ":" in name and _allowed is not None and not _allowed(name) and name not in added_names(group):
        raise Refusal(
            f"{name!r} names code that would be imported and run, and it stands in a file; give it on the command "
            "line too, or add --allow-code if you trust the file and the module"
        )
    return _added(group, name, kind)


@functools.cache
def _added(group: str, name: str, kind: type) -> Any | None:
    for point in importlib.metadata.entry_points(group=f"glucoloop.{group}"):
        if point.name == name:
            return _found(name, point.value, kind)
    if ":" not in name:
        return None
    global _from_here
    _from_here = True
    return _found(name, name, kind)


def _found(name: str, value: str, kind: type) -> Any:
    found = _of_kind(loaded(value), value, kind)
    _note_code(name, value)
    return found


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
    if not _from_here or here in sys.path:
        return importlib.import_module(module)
    sys.path.append(here)
    try:
        return importlib.import_module(module)
    finally:
        sys.path.remove(here)


def _of_kind(found: Any, name: str, kind: type) -> Any:
    if not isinstance(found, kind):
        raise Refusal(f"{name} is an instance of {type(found).__name__}; it has to be one of {kind.__name__}")
    return found
