"""A component: a frozen class whose annotated fields are its settings, and which knows what was given to it.

A component is declared once, beside its science::

    class Lag(SensorComponent, name="lag"):
        \"\"\"Glucose behind a first-order lag, as under the skin.\"\"\"

        lag_min: Annotated[float, About("Time constant of the lag.", above=0.0, at_most=120.0)] = 10.0

The grammar of the command line, files, help, checks and documentation follow from the declaration.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import sys
import typing
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, Self, TypeVar, dataclass_transform

from glucoloop.component.code import loaded
from glucoloop.component.effects import Need
from glucoloop.component.grammar import NAME, NONE, GivenValue, Tree, component_text, place, plain
from glucoloop.component.setting import (
    ALL_SETTINGS,
    Default,
    Setting,
    WithUnit,
    declared_setting,
    default_by_noise,
    known_names,
)
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import Quantity

_SCALARS: Final = (int, float, str, bool)
P = TypeVar("P", bound="Component")
WIRING: Final = "wiring"
"""Metadata of a field that is no setting: what an object is connected to, or told of the loop around it."""
_RESERVED: Final = (NAME, "label", "explicit", "source", "display_name", "kind", "default", "sources", NONE)


@dataclass_transform(frozen_default=True, field_specifiers=(default_by_noise, dataclasses.field))
class Component:
    """Something that a user names, with settings. Making one checks them.

    A class is a component under the name that it is given: ``class Lag(SensorComponent, name="lag")``. A class without
    a name is a common declaration of settings.

    Raises
    ------
    Refusal
        For a value out of its bounds, or at odds with another; ``ArgumentTypeError`` for one of another type.
    """

    kind: ClassVar[str] = "component"
    name: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    sources: ClassVar[tuple[str, ...]] = ()
    """Publications that the component is made after: keys of `component.references`, or whole references as texts."""
    may_have: ClassVar[tuple[str, ...]] = ()
    """Reserved names that settings of this class may have all the same."""
    any_number: ClassVar[Quantity | None] = None
    """Plausible range of numbers whose settings declare none."""
    refused: ClassVar[tuple[str, ...]] = ()
    """Settings of a class that this one extends which cannot be given here."""
    explicit: ClassVar[Mapping[str, Any]] = {}
    """Settings that were given explicitly, of each object; the class has none."""
    source: ClassVar[str] = ""
    """Option or file in which each object stood; empty for one that was made in Python."""
    display_name: ClassVar[str] = ""
    """Name under which each object was requested, ``module:Class`` for one that no package has entered."""

    if typing.TYPE_CHECKING:

        def __init_subclass__(cls, *, name: str = "") -> None: ...

    else:

        def __init_subclass__(cls, name: str = "", **more: Any) -> None:
            super().__init_subclass__(**more)
            if name:
                cls.name = name
            _inherit_annotations(cls)
            cls.summary = (vars(cls).get("__doc__") or "").partition("\n")[0].rstrip(".")
            dataclasses.dataclass(frozen=True, repr=False, eq=False)(cls)
            for field in dataclasses.fields(cls):
                if field.name in _RESERVED and field.name not in cls.may_have:
                    raise TypeError(
                        f"a setting of {cls.__name__} is called {field.name!r}, as of every component; rename it"
                    )
            cls.__init__ = _checking(cls, cls.__init__)

    def __post_init__(self) -> None:
        """Refuse settings that are at odds with one another."""

    @classmethod
    def settings(cls) -> Mapping[str, Setting]:
        """Settings of the component by name, as its fields declare them; each has a description and a default."""
        result: dict[str, Setting] | None = vars(cls).get("_settings")
        if result is None:
            result = {}
            for field in dataclasses.fields(typing.cast(Any, cls)):
                if WIRING in field.metadata:
                    continue
                if field.default is not dataclasses.MISSING:
                    value = field.default
                elif field.default_factory is not dataclasses.MISSING:
                    value = field.default_factory()
                else:
                    raise TypeError(f"the setting {field.name} of {cls.__name__} has no default; give it one")
                default = Default(value, field.metadata.get("noisy"))
                result[field.name] = declared_setting(field.name, _annotation(cls, field.name), default)
            type.__setattr__(cls, "_settings", result)
        return result

    @classmethod
    def facts(cls) -> dict[str, Any]:
        """Further plain values for a list of components, beside the settings."""
        return {}

    @classmethod
    def defaults_of_route(cls, insulin_route: str) -> Mapping[str, Any]:
        """Default settings for a route of insulin, where they differ from the defaults."""
        return {}

    @classmethod
    def setting(cls, name: str) -> Setting:
        """A setting by name, also without the unit at its end; Refusal if there is no such setting."""
        result = cls.settings().get(name)
        if result is None:
            alike = [setting for setting in cls.settings().values() if setting.name_without_unit == name]
            if len(alike) == 1:
                return alike[0]
            whose = f"the {cls.kind} {cls.name}" if cls.name else _with_article(cls.kind)
            known = [known for known in cls.settings() if known not in cls.refused]
            raise Refusal(f"{whose} has no setting {name!r}; {known_names(name, known, where=ALL_SETTINGS)}")
        return result

    @classmethod
    def partial(cls, explicit: Mapping[str, Any], source: str = "", display_name: str = "") -> Self:
        """The component with some explicit settings and the others to be completed, before which none are compared.

        An unknown setting, and a value of another type or out of its bounds, are refused. `source` is the option or
        file in which the component stood, and `display_name` the name under which it was requested, if not its own.
        """
        made = object.__new__(cls)
        values = {name: cls.setting(name).check(value, source) for name, value in explicit.items()}
        for name, setting in cls.settings().items():
            object.__setattr__(made, name, _bare(values.get(name, setting.default.noise_free)))
        for field in dataclasses.fields(typing.cast(Any, cls)):
            if WIRING in field.metadata and field.default is not dataclasses.MISSING:
                object.__setattr__(made, field.name, field.default)
            elif WIRING in field.metadata and field.default_factory is not dataclasses.MISSING:
                object.__setattr__(made, field.name, field.default_factory())
        return made._noted(values, source, display_name)

    def _noted(self, explicit: Mapping[str, Any], source: str, name: str) -> Self:
        for key, value in (("explicit", explicit), ("source", source), ("display_name", name or self.name)):
            object.__setattr__(self, key, value)
        return self

    def completed(self, defaults: Mapping[str, Any] | None = None, *, noisy: bool = False) -> Self:
        """The component with a value for every setting: where none is explicit, one of `defaults` or the class's own.

        Defaults are values, or a `Default` that depends on noise. Settings that are at odds with one another are
        refused.
        """
        values = dict(self.explicit)
        for name, setting in self.settings().items():
            value = (defaults or {}).get(name, setting.default)
            values.setdefault(name, value.value(noisy=noisy) if isinstance(value, Default) else value)
        try:
            whole = type(self)(**values)
        except Refusal as error:
            raise error.within(self.source) from None
        return whole._noted(self.explicit, self.source, self.display_name)

    def uses(self) -> frozenset[Need]:
        """Needs that the component meets, for settings of the request or of its own."""
        return frozenset()

    def needs(self) -> tuple[Need, ...]:
        """Needs of the component itself to have an effect."""
        return ()

    def values(self) -> dict[str, Any]:
        """Every setting with its value."""
        return {name: getattr(self, name) for name in self.settings()}

    def tree(self, *, whole: bool = False) -> Tree:
        """Given settings as plain values, the same for TOML and JSON; with `whole` every setting."""
        result: Tree = {NAME: self.display_name} if self.display_name else {}
        for name, value in (self.values() if whole else self.explicit).items():
            if name not in self.refused:
                left_out = value is None and not whole and self.setting(name).is_component
                result[name] = NONE if left_out else _plain(value, whole)
        return result

    @property
    def text(self) -> str:
        """Text from which the same component is read, with every setting."""
        return component_text(self.tree(whole=True))

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        values = (f"{name}={value!r}" for name, value in self._field_values().items())
        return f"{type(self).__qualname__}({', '.join(values)})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return tuple(self._field_values().values()) == tuple(other._field_values().values())

    def __hash__(self) -> int:
        return hash(tuple(self._field_values().values()))

    def _field_values(self) -> dict[str, Any]:
        """Fields by name, by which two components are equal; written once here, for making the methods takes long."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(typing.cast(Any, self))}


def _inherit_annotations(component: type[Component]) -> None:
    """A default that a class gives without a description is one of the setting that it inherits."""
    inherited = next((base for base in component.__mro__[1:] if dataclasses.is_dataclass(base)), None)
    known = () if inherited is None else dataclasses.fields(typing.cast(Any, inherited))
    changed = [field.name for field in known if field.name in vars(component)]
    undescribed = [name for name in changed if not hasattr(_annotation(component, name), "__metadata__")]
    if inherited is not None and undescribed:
        described = {name: _annotation(inherited, name) for name in undescribed}
        component.__annotations__ = {**inspect.get_annotations(component), **described}


def _annotation(component: type[Any], name: str) -> Any:
    """Annotation of a field, evaluated alone: those of other fields may name what imports JAX."""
    base = next(base for base in component.__mro__ if name in inspect.get_annotations(base))
    annotation = inspect.get_annotations(base)[name]
    if isinstance(annotation, str):
        return eval(annotation, vars(sys.modules[base.__module__]), dict(vars(base)))
    return annotation


def _with_article(noun: str) -> str:
    return f"{'an' if noun[:1] in 'aeio' else 'a'} {noun}"


def _plain(value: Any, whole: bool) -> Any:
    if isinstance(value, Component | WithUnit):
        return value.tree(whole=whole) if isinstance(value, Component) else value.text
    return [_plain(item, whole) for item in value] if isinstance(value, tuple | list) else value


def _bare(value: Any) -> Any:
    """A value without the text in which a number of it was given."""
    if isinstance(value, tuple):
        return tuple(map(_bare, value))
    return float(value) if isinstance(value, WithUnit) else value


def _checking(component: type[Component], plain_init: Callable[..., None]) -> Callable[..., None]:
    """Constructor that takes numbers of NumPy and JAX as well, and refuses what is out of bounds."""

    @functools.wraps(plain_init)
    def init(self: Component, *args: Any, **kwargs: Any) -> None:
        if type(self) is not component:  # a class that extends this one checks all of its settings itself
            plain_init(self, *args, **kwargs)
            return
        fields = dataclasses.fields(typing.cast(Any, component))
        names = [field.name for field in fields if not field.kw_only]
        given = {**dict(zip(names, args, strict=False)), **kwargs}
        known = {field.name for field in fields if field.init}
        if len(args) > len(names) or len(given) < len(args) + len(kwargs) or not given.keys() <= known:
            plain_init(self, *args, **kwargs)  # Python says itself what is too much
        settings = component.settings()
        values = {name: _bare(_taken(component, name, value)) for name, value in given.items() if name in settings}
        unconnected = {field.name for field in fields if field.default is None and given.get(field.name) is None}
        wiring = {
            name: None if name in unconnected else _connected(component, name, value)
            for name, value in given.items()
            if name not in settings
        }
        plain_init(self, **values, **wiring)
        self._noted(values, "", "")

    return init


def _taken(component: type[Component], name: str, value: Any) -> Any:
    """A value within its bounds, in the type of its setting."""
    setting = component.settings()[name]
    if setting.kind not in _SCALARS or setting.many:
        return setting.check(value)
    value = setting.read(value) if _has_unit(setting, value) else value
    of_python = type(value) in (*_SCALARS, WithUnit) or value is None
    if not (of_python and (setting.choices or setting.has_type(value) or (value is None and setting.optional))):
        from glucoloop.arguments import converted, is_traced  # which imports JAX

        value = converted(name, value, setting.kind, component.__name__)
        if is_traced(value):
            return value
    return setting.check(value)


def _connected(component: type[Component], name: str, value: Any) -> Any:
    """A value of a field that is no setting, of the type of its annotation."""
    from glucoloop.arguments import converted

    return converted(name, value, typing.get_type_hints(component)[name], component.__name__)


def read(component: type[P], tree: Mapping[str, Any], *, allow_unusual: bool = True, source: str | None = None) -> P:
    """A component from a tree of given values, some of them texts; components in it are read by their catalogues.

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
            raise Refusal(f"{what} is no part of {_with_article(component.kind)}; leave it out")
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
        if isinstance(first, GivenValue) and first.by_option:
            setting, label = setting.renamed(at), ""
        values[key] = setting.check(value, label)
        if not allow_unusual:
            setting.refuse_unusual(values[key], ": ".join(filter(None, (label, setting.name))), component.any_number)
    return component.partial(values, place(tree) if source is None else source, plain(tree.get(NAME, "")))


def _value(setting: Setting, leaf: Any) -> Any:
    """The value of a leaf, read from its text where it has no type yet."""
    if isinstance(leaf, list):
        return tuple(_value(setting, item) for item in leaf)
    value = plain(leaf)
    if not isinstance(value, str):
        return value
    typed = isinstance(leaf, GivenValue) and leaf.text
    return setting.read(value) if typed or _has_unit(setting, value) else value


def _has_unit(setting: Setting, value: Any) -> bool:
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


class MadeComponent(Component):
    """A component of which a function makes something.

    It is called with all settings by name, and with what else is known if it has a parameter of that name. A class that
    overrides `made` needs no such function.
    """

    make: ClassVar[str] = ""
    """The function, as ``module:function``; a class will do."""

    def made(self, **known: Any) -> Any:
        """Object that the component stands for; making it imports JAX."""
        return self.made_of(self.values(), known)

    @classmethod
    def takes(cls, name: str) -> bool:
        """Whether the function has a parameter of a name, or `made` of a class that overrides it."""
        return name in inspect.signature(loaded(cls.make) if cls.make else cls.made).parameters

    def made_of(self, settings: Mapping[str, Any], known: Mapping[str, Any]) -> Any:
        """Object that the function makes of these settings, and of what it takes of the rest."""
        maker = loaded(self.make)
        taken = inspect.signature(maker).parameters
        return maker(**settings, **{name: value for name, value in known.items() if name in taken})
