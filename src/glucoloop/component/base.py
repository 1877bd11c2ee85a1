"""A component: a frozen class whose annotated fields are its settings, and which knows its request.

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
from typing import Any, ClassVar, Final, Self, dataclass_transform

from glucoloop.component.code import loaded
from glucoloop.component.effects import Need
from glucoloop.component.grammar import NAME, NONE, Tree, component_text
from glucoloop.component.request import Request, has_unit, tree_of, with_article
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
WIRING: Final = "wiring"
"""Metadata of a field that is no setting: what an object is connected to, or told of the loop around it."""
_RESERVED: Final = (NAME, "request", "label", "explicit", "source", "display_name", "kind", "default", "sources", NONE)


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
    """Publications that the component is made after: keys of `references.toml`, or whole references as texts."""
    may_have: ClassVar[tuple[str, ...]] = ()
    """Reserved names that settings of this class may have all the same."""
    any_number: ClassVar[Quantity | None] = None
    """Plausible range of numbers whose settings declare none."""
    refused: ClassVar[tuple[str, ...]] = ()
    """Settings of a class that this one extends which cannot be given here."""

    request: Request[Any]
    """Request from which each object was made; its constructor makes one of what it is given."""

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
            whose = f"the {cls.kind} {cls.name}" if cls.name else with_article(cls.kind)
            known = [known for known in cls.settings() if known not in cls.refused]
            raise Refusal(f"{whose} has no setting {name!r}; {known_names(name, known, where=ALL_SETTINGS)}")
        return result

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults with those that follow from what is explicit of a request; a request that is at odds is refused."""
        return defaults

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes of an object, from all settings and what it is connected to: components are complete.

        Those of a setting that is annotated as `Request` are completed later, and are requests until then.
        """
        result = dict(values)
        for name, setting in cls.settings().items():
            if setting.is_component:
                value = result[name]
                result[name] = tuple(map(setting.settled, value)) if setting.many else setting.settled(value)
        return result

    @classmethod
    def arranged(cls, tree: Tree) -> Tree:
        """Plain values of the settings as they stand in a file."""
        return tree

    def as_request(self) -> Request[Self]:
        """The request from which the same component is made."""
        return self.request

    @property
    def explicit(self) -> Mapping[str, Any]:
        """Settings that were given explicitly."""
        return self.request.explicit

    @property
    def display_name(self) -> str:
        """Name under which the component was requested, ``module:Class`` for one that no package has entered."""
        return self.request.display_name

    def uses(self) -> frozenset[Need]:
        """Needs that the component meets, for settings of the request or of its own."""
        return frozenset()

    def needs(self) -> tuple[Need, ...]:
        """Needs of the component itself to have an effect."""
        return ()

    def values(self) -> dict[str, Any]:
        """Every setting with its value."""
        return {name: getattr(self, name) for name in self.settings()}

    @classmethod
    def narrowed(cls, component: Component, **changes: Any) -> Self:
        """A component of this class with the settings of one of a class that extends it, and these changes."""
        return cls(**{**{name: getattr(component, name) for name in cls.settings()}, **changes})

    def tree(self, *, whole: bool = False) -> Tree:
        """Explicit settings as plain values, the same for TOML and JSON; with `whole` every setting."""
        return tree_of(type(self), self.display_name, self.values(), whole=True) if whole else self.request.tree()

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


def _bare(value: Any) -> Any:
    """A value without the text in which a number of it was given."""
    if isinstance(value, tuple):
        return tuple(map(_bare, value))
    return float(value) if isinstance(value, WithUnit) else value


def _checking(component: type[Component], plain_init: Callable[..., None]) -> Callable[..., None]:
    """Constructor that takes numbers of NumPy and JAX as well, and refuses what is out of bounds."""

    @functools.wraps(plain_init)
    def init(self: Component, *args: Any, _request: Request[Any] | None = None, **kwargs: Any) -> None:
        if type(self) is not component:  # a class that extends this one checks all of its settings itself
            plain_init(self, *args, **kwargs)
            return
        fields = dataclasses.fields(typing.cast(Any, component))
        names = [field.name for field in fields if not field.kw_only]
        arguments = {**dict(zip(names, args, strict=False)), **kwargs}
        known = {field.name for field in fields if field.init}
        if len(args) > len(names) or len(arguments) < len(args) + len(kwargs) or not arguments.keys() <= known:
            plain_init(self, *args, **kwargs)  # Python says itself what is too much
        settings = component.settings()
        explicit = {
            name: _bare(_taken(component, name, value)) for name, value in arguments.items() if name in settings
        }
        defaults = {name: setting.default.noise_free for name, setting in settings.items()}
        unconnected = {field.name for field in fields if field.default is None and arguments.get(field.name) is None}
        wiring = {
            name: None if name in unconnected else _connected(component, name, value)
            for name, value in arguments.items()
            if name not in settings
        }
        vars(self)["request"] = Request(component, explicit) if _request is None else _request
        plain_init(self, **component.resolved({**defaults, **explicit, **wiring}))

    return init


def _taken(component: type[Component], name: str, value: Any) -> Any:
    """A value within its bounds, in the type of its setting."""
    setting = component.settings()[name]
    if setting.kind not in _SCALARS or setting.many:
        return setting.check(value)
    value = setting.read(value) if has_unit(setting, value) else value
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
