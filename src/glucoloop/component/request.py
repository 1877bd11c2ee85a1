"""Request of a component: its class and the settings that are explicit, apart from the component that is made of it.

A text, a table of a file or Python gives a `Request`, whose values are checked one by one. `completed` makes the
component with a value for every setting, once and whole; it knows its request, from which files are written.

A file or the command line is read in two steps: types and bounds at once, without a numerical library, so that a
refusal comes at once; the second step completes the request by defaults, which imports the patient.
"""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from glucoloop.arguments import is_traced
from glucoloop.component.grammar import NAME, NONE, Leaf, Tree, component_text, place, plain
from glucoloop.component.setting import Default, Setting, WithUnit
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.component.base import Component

P = TypeVar("P", bound="Component")


@dataclass(frozen=True, eq=False)
class Request(Generic[P]):
    """A component with some of its settings; two are equal if they would be with the defaults of the class.

    Components among the settings are requests too, or complete.
    """

    component: type[P]
    explicit: Mapping[str, Any] = field(default_factory=dict)
    """Settings that were given explicitly, by name."""
    source: str = ""
    """Option or file in which the component stood; empty for one that was made in Python."""
    alias: str = ""
    """Name under which the component was requested, where it is not its own: ``module:Class``."""

    @property
    def display_name(self) -> str:
        """Name under which the component was requested."""
        return self.alias or self.component.name

    def value(self, name: str) -> Any:
        """A setting, or the default of the class where it is not explicit."""
        default = self.component.settings()[name].default.noise_free
        return self.explicit.get(name, default)

    def tree(self, *, whole: bool = False) -> Tree:
        """The explicit settings as plain values, the same for TOML and JSON; with `whole` defaults of the class too."""
        values = {name: self.value(name) for name in self.component.settings()} if whole else self.explicit
        return tree_of(self.component, self.display_name, values, whole=whole)

    @property
    def text(self) -> str:
        """Text from which the same request is read."""
        return component_text(self.tree())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Request):
            return NotImplemented
        return self.component is other.component and all(
            self.value(name) == other.value(name) for name in self.component.settings()
        )

    def __hash__(self) -> int:
        return hash(self.component)


def requested(component: type[P], explicit: Mapping[str, Any], source: str = "", alias: str = "") -> Request[P]:
    """A request whose settings are checked one by one; an unknown one, and a value that is not possible, is refused."""
    values = {name: component.setting(name).check(value, source) for name, value in explicit.items()}
    return Request(component, values, source, alias)


def by_default(component: type[Component], **explicit: Any) -> Any:
    """Default of a field: a component that is completed with the object that has the field."""
    return Request(component, explicit)


def request_of(component: P | Request[P]) -> Request[P]:
    """The request from which a component was made; a request is its own."""
    return component if isinstance(component, Request) else component.as_request()


def completed(component: P | Request[P], defaults: Mapping[str, Any] | None = None, *, noisy: bool = False) -> P:
    """The component of a request, or of the request of a component, with a value for every setting.

    Where none is explicit it is one of `defaults`, values or `Default` of which some depend on noise, or that of the
    class. Settings that are at odds with one another are refused.
    """
    request = request_of(component)
    defaults = request.component.defaults_of(request, defaults or {})
    values = {}
    for name, setting in request.component.settings().items():
        default = defaults.get(name, setting.default)
        values[name] = default.value(noisy=noisy) if isinstance(default, Default) else default
    try:
        return made_of(request, {**values, **request.explicit})
    except Refusal as error:
        raise error.within(request.source) from None


def made_of(request: Request[P], values: Mapping[str, Any]) -> P:
    """The component of a request with these settings."""
    return typing.cast(Any, request.component)(_request=request, **values)  # type: ignore[no-any-return]


def tree_of(component: type[Component], name: str, values: Mapping[str, Any], *, whole: bool = False) -> Tree:
    """Settings of a component as plain values; with `whole` those within it are whole too."""
    result: Tree = {NAME: name} if name else {}
    for key, value in values.items():
        if key not in component.refused:
            left_out = value is None and not whole and component.setting(key).is_component
            result[key] = NONE if left_out else _plain(value, whole)
    return component.arranged(result)


def _plain(value: Any, whole: bool) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(item, whole) for item in value]
    if isinstance(value, WithUnit):
        return value.text
    if hasattr(value, "tolist") and not is_traced(value):  # of NumPy or JAX, where numbers were replaced by people's
        return value.tolist()
    return value.tree(whole=whole) if isinstance(value, Request) or hasattr(value, "as_request") else value


def read(
    component: type[P], tree: Mapping[str, Any], *, allow_unusual: bool = True, source: str | None = None
) -> Request[P]:
    """A request from a tree of given values, some of them texts; components in it are read by their catalogues.

    Values that are possible and implausible are taken only with `allow_unusual`. `source` is the option or file in
    which the component stands, by default that of its first value.
    """
    values: dict[str, Any] = {}
    places: dict[str, str] = {}
    for key, leaf in tree.items():
        if key == NAME:
            continue
        at = place(leaf)
        if key in component.refused:
            what = at if at.startswith("--") else f"{at}: {key}" if at else key
            raise Refusal(f"{what} is no part of {with_article(component.kind)}; leave it out")
        try:
            setting = component.setting(key)
        except Refusal as error:
            raise error.within(at) from None
        key = setting.name
        if places.setdefault(key, at) == at and key in values:
            raise Refusal(f"{at}: {key} is given twice, once without its unit; leave one out")
        if setting.is_component:
            values[key] = _components(setting, leaf, allow_unusual)
            continue
        value, label = _value(setting, leaf), ": ".join(filter(None, (at, component.name if NAME in tree else "")))
        first = leaf[0] if isinstance(leaf, list) and leaf else leaf
        if isinstance(first, Leaf) and first.by_option:
            setting, label = setting.renamed(at), ""
        values[key] = setting.check(value, label)
        if not allow_unusual:
            setting.refuse_unusual(values[key], ": ".join(filter(None, (label, setting.name))), component.any_number)
    return requested(component, values, place(tree) if source is None else source, plain(tree.get(NAME, "")))


def _value(setting: Setting, leaf: Any) -> Any:
    """The value of a leaf, read from its text where it has no type yet."""
    if isinstance(leaf, list):
        return tuple(_value(setting, item) for item in leaf)
    value = plain(leaf)
    if not isinstance(value, str):
        return value
    typed = isinstance(leaf, Leaf) and leaf.text
    return setting.read(value) if typed or has_unit(setting, value) else value


def has_unit(setting: Setting, value: Any) -> bool:
    """Whether a value is a text with a unit, such as ``"10h"``, which files and Python may hold too."""
    return setting.kind is float and isinstance(value, str) and not value.rstrip()[-1:].isdecimal()


def _components(setting: Setting, leaf: Any, allow_unusual: bool) -> Any:
    catalogue = setting.kind.catalogue
    if setting.optional and plain(leaf) in (None, NONE):
        return None
    if setting.many:
        items = leaf if isinstance(leaf, list) else [leaf]
        return tuple(catalogue.read(item, allow_unusual=allow_unusual) for item in items)
    if isinstance(leaf, list):
        raise Refusal(f"{place(leaf)}: {setting.name} is a list; give one, a table with a {NAME}")
    return catalogue.read(leaf, allow_unusual=allow_unusual)


def with_article(noun: str) -> str:
    """A noun after its indefinite article."""
    return f"{'an' if noun[:1] in 'aeio' else 'a'} {noun}"


def read_root(root: type[P], tree: Mapping[str, Any], *, allow_unusual: bool = False) -> Request[P]:
    """A request with bounds and types checked; implausible values are refused unless they were allowed."""
    prepared = getattr(root, "prepared", dict)(tree)
    return read(root, prepared, allow_unusual=allow_unusual or plain(tree.get("allow_unusual")) is True, source="")


def configuration_from(root: type[P], tree: Mapping[str, Any]) -> P:
    """A configuration from a tree of given values; what is at odds, or implausible together, is refused."""
    whole = completed(read_root(root, tree))
    if hasattr(whole, "refuse_unusual") and not getattr(whole, "allow_unusual", False):
        whole.refuse_unusual()
    return whole
