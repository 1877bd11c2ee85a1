"""Every part of a kind by its name: those of this package, and those of others by entry point or ``module:Class``."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from glucoloop.parts.grammar import NAME, Given, part_tree, place
from glucoloop.parts.part import Part, loaded, read
from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal

P = TypeVar("P", bound=Part)

HOMES: Final = {
    "patient": "glucoloop.parts.patients:PATIENTS",
    "sensor": "glucoloop.parts.sensors:SENSORS",
    "pump": "glucoloop.parts.pumps:PUMPS",
    "fault": "glucoloop.parts.faults:FAULTS",
    "controller": "glucoloop.control.settings:CONTROLLERS",
    "guard": "glucoloop.parts.guard:GUARDS",
    "metric": "glucoloop.parts.metrics:METRICS",
}
"""Catalogue of each kind, as ``module:attribute``."""


class Catalogue(Mapping[str, type[P]], Generic[P]):
    """Parts of one kind by name; `find` adds those of other packages.

    Parameters
    ----------
    of : type
        Class of which each part is a subclass; its ``kind`` names the kind, and its entry points are in the group
        ``glucoloop.<kind>s``.
    parts : iterable of type
        Parts of this package, the usual one first.
    example : str
        Text of a part, for messages.
    """

    def __init__(self, of: type[P], parts: Iterable[type[P]], *, example: str) -> None:
        self._of, self._parts, self.example = of, {part.name: part for part in parts}, example
        self._group = f"glucoloop.{of.kind.replace(' ', '_')}s"
        of.catalogue = self  # type: ignore[attr-defined]

    def __getitem__(self, name: str) -> type[P]:
        return self._parts[name]

    def __iter__(self) -> Any:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def usual(self) -> str:
        """Name of the part that is usual."""
        return next(iter(self._parts))

    def names(self) -> list[str]:
        """Names of all parts, those of other packages included, which are not imported."""
        return [*self, *sorted(entry_points(self._group))]

    def find(self, name: str, *, code: bool = True) -> type[P]:
        """A part by name: of this package, of another one, or ``module:Class``.

        Parameters
        ----------
        name : str
        code : bool
            Whether a name of code may be imported, ``module:Class``: a file must not run code by naming it.

        Raises
        ------
        Refusal
            For an unknown name, or code that cannot be imported or is no such part.
        """
        if name in self._parts:
            return self._parts[name]
        kind = self._of.kind
        if ":" in name:
            if not code:
                raise Refusal(
                    f"the {kind} {name!r} is code of a file, which is run only if it is named on the command line; "
                    f"name it there, or add --allow-code"
                )
            return self._loaded(name, name)
        points = entry_points(self._group)
        if name not in points:
            raise Refusal(f"unknown {kind} {name!r}; {known_names(name, self.names())}")
        return self._loaded(name, points[name])

    def choose(self, text: str) -> P:
        """A part from its text, with its defaults for the settings that it does not give.

        Raises
        ------
        Refusal
            As `parse`.
        """
        return self.parse(text).completed()

    def _loaded(self, name: str, value: str) -> type[P]:
        found = loaded(value)
        _note_code(name, value)
        if not (isinstance(found, type) and issubclass(found, self._of)):
            raise Refusal(f"{value} is no {self._of.kind}: make it a class of {self._of.__name__}")
        if not found.name:
            found.name = name
        return found

    def parse(self, text: str, where: str = "") -> P:
        """A part from its text; what it does not give is left to be completed.

        Raises
        ------
        Refusal
            For a text that is no part, an unknown part or setting, or a value that is not possible.
        """
        return self.read(part_tree(text, where, self.example))

    def read(self, tree: Any) -> P:
        """A part from its tree.

        Raises
        ------
        Refusal
            As `parse`.
        """
        leaf = tree.get(NAME) if isinstance(tree, Mapping) else tree
        name = leaf.value if isinstance(leaf, Given) else leaf
        where = place(tree)
        if not isinstance(name, str) or not name:
            given = "nothing" if name is None else repr(name)
            told = f"{given} names no {self._of.kind}; begin with its name, like {self.example!r}"
            raise Refusal(f"{where}: {told}" if where else told)
        try:
            part = self.find(name, code=not isinstance(leaf, Given) or leaf.text)
        except Refusal as error:
            raise Refusal(f"{where}: {error}" if where else str(error)) from None
        return read(part, tree if isinstance(tree, Mapping) else {})  # type: ignore[return-value]


@functools.cache
def entry_points(group: str) -> dict[str, str]:
    """Places that installed packages add to a group, by name; nothing is imported."""
    return {point.name: point.value for point in importlib.metadata.entry_points(group=group)}


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


def catalogues() -> dict[str, Catalogue[Any]]:
    """Every catalogue by the kind of its parts."""
    return {kind: loaded(home) for kind, home in HOMES.items()}
