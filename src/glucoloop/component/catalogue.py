"""Every component of a kind by its name: those of this package, and those of others by entry point or ``module:Class``.

An entry is a name and a place, so that nothing is imported for a list of names.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Any, Final, Generic, TypeVar

from glucoloop.component.base import Component
from glucoloop.component.code import added, entry_points, loaded
from glucoloop.component.grammar import NAME, Tree, as_table, component_tree, place, plain
from glucoloop.component.request import Request, completed, read
from glucoloop.component.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.text import shown

P = TypeVar("P", bound=Component)

HOMES: Final = {
    "patient": "glucoloop.patients.catalogue:PATIENTS",
    "meal model": "glucoloop.meals.models:MEAL_MODELS",
    "rescue": "glucoloop.meals.rescue:RESCUES",
    "habit": "glucoloop.meals.habits:HABITS",
    "scenario": "glucoloop.situations.scenarios:SCENARIOS",
    "sensor": "glucoloop.sensors:SENSORS",
    "pump": "glucoloop.pumps:PUMPS",
    "fault": "glucoloop.faults:FAULTS",
    "controller": "glucoloop.control.catalogue:CONTROLLERS",
    "profile error": "glucoloop.situations.therapy_settings:PROFILE_ERRORS",
    "override": "glucoloop.situations.therapy_settings:OVERRIDES",
    "action": "glucoloop.control.action:ACTIONS",
    "glucagon controller": "glucoloop.control.glucagon:GLUCAGON",
    "estimator": "glucoloop.estimation.unknown_meal:ESTIMATORS",
    "guard": "glucoloop.control.guard_settings:GUARDS",
    "rhythm": "glucoloop.physiology.rhythm:RHYTHMS",
    "metric": "glucoloop.metrics.metric:METRICS",
    "sampler": "glucoloop.tuning.samplers:SAMPLERS",
    "model": "glucoloop.models.settings:MODELS",
    "reader": "glucoloop.records.reader:READERS",
    "forecast method": "glucoloop.forecasts.method:METHODS",
}
"""Catalogue of each kind, as ``module:attribute``."""


class Catalogue(Mapping[str, type[P]], Generic[P]):
    """Classes of the components of one kind by name, each imported when it is first used.

    `find` adds those of other packages.

    Parameters
    ----------
    base : type
        Class of which each component is a subclass; its ``kind`` names the kind, and its entry points are in the group
        ``glucoloop.<kind>s``, with an underscore for a space.
    places : mapping of str to str
        Place ``module:Class`` of each component of this package by its name, the default one first.
    example : str
        Text of a component, for messages.
    unnamed : bool
        Whether a text or a table without a name is one of the default component.
    """

    def __init__(self, base: type[P], places: Mapping[str, str], *, example: str, unnamed: bool = False) -> None:
        self._places = places
        self._base, self.example, self.unnamed = base, example, unnamed
        self._group = f"{base.kind.replace(' ', '_')}s"
        base.catalogue = self  # type: ignore[attr-defined]

    def __getitem__(self, name: str) -> type[P]:
        module, _, attribute = self._places[name].partition(":")
        component: type[P] = getattr(importlib.import_module(module), attribute)
        return component

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    @property
    def default(self) -> str:
        """Name of the default component."""
        return next(iter(self))

    def names(self) -> list[str]:
        """Names of all components, those of other packages included, which are not imported."""
        return [*self, *sorted(entry_points(self._group))]

    def find(self, name: str) -> type[P]:
        """A component by name: of this package, of another one, or ``module:Class``."""
        if name in self:
            return self[name]
        kind, component = self._base.kind, added(self._group, name)
        if component is None:
            raise Refusal(f"unknown {kind} {name!r}; {known_names(name, self.names())}")
        if not (isinstance(component, type) and issubclass(component, self._base)):
            raise Refusal(f"{name} is no {kind}: make it a class of {self._base.__name__}")
        if not component.name:
            component.name = name
        try:
            component.settings()
        except TypeError as error:  # of a class of a user that declares a setting in another way
            raise Refusal(f"{name} is no {kind}: {error}") from None
        return component

    def choose(self, text: str) -> P:
        """A component from its text, with its defaults for the settings that it does not give."""
        return completed(self.parse(text))

    def parse(self, text: str, source: str = "") -> Request[P]:
        """Request of a component from its text."""
        return self.read(self.tree(text, source))

    def by_default(self, text: str) -> Any:
        """Default of a field from its text; see `component.request.by_default`."""
        return self.parse(text)

    def tree(self, text: str, source: str = "") -> Tree:
        """Tree of a component from its text."""
        return component_tree(text, source, self.example)

    def read(self, tree: Any, *, allow_unusual: bool = True) -> Request[P]:
        """Request from the tree of a component, or its text as a leaf of one; `allow_unusual` as for `request.read`."""
        tree = as_table(tree, self.tree)
        source = place(tree)
        try:
            if not isinstance(tree, Mapping):
                raise Refusal(
                    f"{shown(plain(tree))} is no {self._base.kind}; give a text like {self.example!r}, or a table"
                )
            name = plain(tree.get(NAME, self.default if self.unnamed else None))
            if not isinstance(name, str) or not name:
                problem = f"no {self._base.kind} is named" if name is None else f"{name!r} names no {self._base.kind}"
                raise Refusal(f"{problem}; begin with its name, like {self.example!r}")
            component = self.find(name)
        except Refusal as error:
            raise error.within(source) from None
        return read(component, tree, allow_unusual=allow_unusual)


def catalogues() -> dict[str, Catalogue[Any]]:
    """Every catalogue by the kind of its components."""
    return {kind: loaded(home) for kind, home in HOMES.items()}
