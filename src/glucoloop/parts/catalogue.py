"""Every part of a kind by its name: those of this package, and those of others by entry point or ``module:Class``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, Generic, TypeVar

from glucoloop.parts.code import added, entry_points, loaded
from glucoloop.parts.grammar import NAME, GivenValue, Tree, part_tree, place, plain
from glucoloop.parts.part import Part, read
from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal

P = TypeVar("P", bound=Part)

HOMES: Final = {
    "patient": "glucoloop.parts.patients:PATIENTS",
    "sensor": "glucoloop.parts.sensors:SENSORS",
    "pump": "glucoloop.parts.pumps:PUMPS",
    "fault": "glucoloop.parts.faults:FAULTS",
    "controller": "glucoloop.control.catalogue:CONTROLLERS",
    "guard": "glucoloop.parts.guard:GUARDS",
    "metric": "glucoloop.parts.metrics:METRICS",
    "model": "glucoloop.parts.models:MODELS",
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
    unnamed : bool
        Whether a text or a table without a name is one of the usual part.
    """

    def __init__(self, of: type[P], parts: Iterable[type[P]], *, example: str, unnamed: bool = False) -> None:
        self._of, self._parts, self.example = of, {part.name: part for part in parts}, example
        self.unnamed = unnamed
        self._group = f"{of.kind.replace(' ', '_')}s"
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

    def find(self, name: str) -> type[P]:
        """A part by name: of this package, of another one, or ``module:Class``.

        Raises
        ------
        Refusal
            For an unknown name, code that cannot be imported or that only a file names, or code that is no such part.
        """
        if name in self._parts:
            return self._parts[name]
        kind, part = self._of.kind, added(self._group, name)
        if part is None:
            raise Refusal(f"unknown {kind} {name!r}; {known_names(name, self.names())}")
        if not (isinstance(part, type) and issubclass(part, self._of)):
            raise Refusal(f"{name} is no {kind}: make it a class of {self._of.__name__}")
        if not part.name:
            part.name = name
        return part

    def choose(self, text: str) -> P:
        """A part from its text, with its defaults for the settings that it does not give.

        Raises
        ------
        Refusal
            As `parse`.
        """
        return self.parse(text).completed()

    def parse(self, text: str, where: str = "") -> P:
        """A part from its text; what it does not give is left to be completed.

        Raises
        ------
        Refusal
            For a text that is no part, an unknown part or setting, or a value that is not possible.
        """
        return self.read(self.tree(text, where))

    def tree(self, text: str, where: str = "") -> Tree:
        """Tree of a part from its text.

        Raises
        ------
        Refusal
            For a text that is no part.
        """
        return part_tree(text, where, self.example)

    def read(self, tree: Any, *, ask: bool = False) -> P:
        """A part from its tree, or from its text as a leaf of one; `ask` as for `part.read`.

        Raises
        ------
        Refusal
            As `parse`.
        """
        if isinstance(tree, GivenValue) and isinstance(tree.value, str):
            tree = self.tree(tree.value, tree.where)
        where = place(tree)
        prefix = f"{where}: " if where else ""
        if not isinstance(tree, Mapping):
            raise Refusal(
                f"{prefix}{plain(tree)!r} is no {self._of.kind}; give a text like {self.example!r}, or a table"
            )
        name = plain(tree.get(NAME, self.usual if self.unnamed else None))
        if not isinstance(name, str) or not name:
            given = f"no {self._of.kind} is named" if name is None else f"{name!r} names no {self._of.kind}"
            raise Refusal(f"{prefix}{given}; begin with its name, like {self.example!r}")
        try:
            part = self.find(name)
        except Refusal as error:
            raise Refusal(f"{prefix}{error}") from None
        return read(part, tree, ask=ask)


def catalogues() -> dict[str, Catalogue[Any]]:
    """Every catalogue by the kind of its parts."""
    return {kind: loaded(home) for kind, home in HOMES.items()}
