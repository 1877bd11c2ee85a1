"""A part: a frozen class whose annotated fields are its settings, and which knows what was given to it.

A part is declared once, beside its science::

    class Lag(SensorPart, name="lag"):
        \"\"\"Glucose behind a first-order lag, as under the skin.\"\"\"

        lag_min: Annotated[float, About("Time constant of the lag.", above=0.0, at_most=120.0)] = 10.0

The grammar of the command line, files, help, checks and documentation follow from the declaration.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, Self, TypeVar, dataclass_transform

from glucoloop.parts.code import loaded
from glucoloop.parts.grammar import NAME, NONE, GivenValue, Tree, part_text, place, plain
from glucoloop.parts.setting import AMONG_SETTINGS, Default, Setting, described, known_names, usual, with_article
from glucoloop.plausible import Quantity
from glucoloop.refusal import Refusal

_PLAIN: Final = (int, float, str, bool, type(None))
P = TypeVar("P", bound="Part")
_RESERVED: Final = (NAME, "label", "given", "kind", "usual", NONE)


@dataclass_transform(frozen_default=True, field_specifiers=(usual,))
class Part:
    """Something that a user names, with settings. Making one checks them.

    A class is a part under the name that it is given: ``class Lag(SensorPart, name="lag")``. A class without a name
    is a common declaration of settings.

    Raises
    ------
    Refusal
        For a value out of its bounds, or at odds with another; ``ArgumentTypeError`` for one of another type.
    """

    kind: ClassVar[str] = "part"
    name: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    may_have: ClassVar[tuple[str, ...]] = ()
    """Reserved names that settings of this class may have all the same."""
    any_number: ClassVar[Quantity | None] = None
    """Plausible range of numbers whose settings declare none."""
    refused: ClassVar[tuple[str, ...]] = ()
    """Settings of a class that this one extends which cannot be given here."""

    if typing.TYPE_CHECKING:

        def __init_subclass__(cls, *, name: str = "") -> None: ...

    else:

        def __init_subclass__(cls, name: str = "", **more: Any) -> None:
            super().__init_subclass__(**more)
            if name:
                cls.name = name
            _inherit_annotations(cls)
            cls.summary = (vars(cls).get("__doc__") or "").partition("\n")[0].rstrip(".")
            dataclasses.dataclass(frozen=True)(cls)
            for field in dataclasses.fields(cls):
                if field.name in _RESERVED and field.name not in cls.may_have:
                    raise TypeError(
                        f"a setting of {cls.__name__} is called {field.name!r}, as of every part; rename it"
                    )
            cls.__init__ = _checking(cls, cls.__init__)

    def __post_init__(self) -> None:
        """Refuse settings that are at odds with one another."""

    @classmethod
    def settings(cls) -> Mapping[str, Setting]:
        """Settings of the part by name, as its fields declare them.

        Raises
        ------
        TypeError
            For a field without a description or without a default.
        """
        found: dict[str, Setting] | None = vars(cls).get("_settings")
        if found is None:
            found = _declared(cls)
            type.__setattr__(cls, "_settings", found)
        return found

    @classmethod
    def setting(cls, name: str) -> Setting:
        """A setting by name.

        Raises
        ------
        Refusal
            If there is no such setting.
        """
        found = cls.settings().get(name)
        if found is None:
            whose = f"the {cls.kind} {cls.name}" if cls.name else with_article(cls.kind)
            known = [of for of in cls.settings() if of not in cls.refused]
            raise Refusal(f"{whose} has no setting {name!r}; {known_names(name, known, where=AMONG_SETTINGS)}")
        return found

    @classmethod
    def partial(cls, given: Mapping[str, Any], where: str = "", asked: str = "") -> Self:
        """The part with some settings given and the others to be completed; settings are not compared before.

        Parameters
        ----------
        given : mapping
        where : str
            Option or file in which the part stood, for messages.
        asked : str
            Name by which it was asked for, ``module:Class``; by default its own.

        Raises
        ------
        Refusal
            For an unknown setting, or a value of another type or out of its bounds.
        """
        called = where or None
        made = object.__new__(cls)
        values = {name: cls.setting(name).check(value, called) for name, value in given.items()}
        for name, setting in cls.settings().items():
            object.__setattr__(made, name, values.get(name, setting.default.noise_free))
        return made._noted(values, where, asked)

    def _noted(self, given: Mapping[str, Any], where: str, name: str) -> Self:
        for key, value in (("_given", given), ("_where", where), ("_called", name)):
            object.__setattr__(self, key, value)
        return self

    @property
    def given(self) -> Mapping[str, Any]:
        """The settings that were given."""
        found: Mapping[str, Any] = self.__dict__.get("_given", {})
        return found

    @property
    def where(self) -> str:
        """Option or file in which the part stood; empty for one that was made in Python."""
        return str(self.__dict__.get("_where", ""))

    @property
    def called(self) -> str:
        """Name by which the part was asked for, ``module:Class`` for one that no package has entered."""
        return self.__dict__.get("_called") or self.name

    def completed(self, usual: Mapping[str, Default] | None = None, *, noisy: bool = False) -> Self:
        """The part with a value for every setting: for those that were not given, the usual one or the default.

        Raises
        ------
        Refusal
            For settings that are at odds with one another.
        """
        known = usual or {}
        values = {
            name: self.given.get(name, known.get(name, setting.default).value(noisy=noisy))
            for name, setting in self.settings().items()
        }
        try:
            whole = type(self)(**values)
        except Refusal as error:
            raise Refusal(f"{self.where}: {error}" if self.where else str(error)) from None
        return whole._noted(self.given, self.where, self.called)

    def replaced(self, **given: Any) -> Self:
        """The same part with some settings given anew."""
        return type(self).partial({**self.given, **given}, self.where, self.called)

    def values(self) -> dict[str, Any]:
        """Every setting with its value."""
        return {name: getattr(self, name) for name in self.settings()}

    def tree(self, *, whole: bool = False) -> Tree:
        """Given settings as plain values, the same for TOML and JSON; with `whole` every setting."""
        named = {NAME: self.called} if self.called else {}
        return {
            **named,
            **{
                name: NONE if value is None and not whole and self.setting(name).is_part else _plain(value, whole)
                for name, value in (self.values() if whole else self.given).items()
                if name not in self.refused
            },
        }

    @property
    def text(self) -> str:
        """Text from which the same part is read, with every setting."""
        return part_text(self.tree(whole=True))


def _inherit_annotations(part: type[Part]) -> None:
    """A default that a class gives without a description is one of the setting that it inherits."""
    inherited = [base for base in part.__mro__[1:] if dataclasses.is_dataclass(base)]
    if not inherited:
        return
    known = {field.name for field in dataclasses.fields(typing.cast(Any, inherited[0]))}
    changed = [name for name in vars(part) if name in known]
    if changed:
        hints, own = (typing.get_type_hints(of, include_extras=True) for of in (inherited[0], part))
        undescribed = [name for name in changed if not hasattr(own.get(name), "__metadata__")]
        part.__annotations__ = {**inspect.get_annotations(part), **{name: hints[name] for name in undescribed}}


def _plain(value: Any, whole: bool) -> Any:
    if isinstance(value, Part):
        return value.tree(whole=whole)
    return [_plain(item, whole) for item in value] if isinstance(value, tuple | list) else value


def _declared(part: type[Part]) -> dict[str, Setting]:
    hints = typing.get_type_hints(part, include_extras=True)
    found = {}
    for field in dataclasses.fields(typing.cast(Any, part)):
        if field.default is dataclasses.MISSING:
            raise TypeError(f"the setting {field.name} of {part.__name__} has no default; give it one")
        found[field.name] = described(
            field.name, hints[field.name], Default(field.default, field.metadata.get("noisy"))
        )
    return found


def _checking(part: type[Part], plain_init: Callable[..., None]) -> Callable[..., None]:
    """Constructor that takes numbers of NumPy and JAX as well, and refuses what is out of bounds."""

    @functools.wraps(plain_init)
    def init(self: Part, *args: Any, **kwargs: Any) -> None:
        if type(self) is not part:  # a class that extends this one checks all of its settings itself
            plain_init(self, *args, **kwargs)
            return
        names = list(part.settings())
        given = {**dict(zip(names, args, strict=False)), **kwargs}
        if len(args) > len(names) or len(given) < len(args) + len(kwargs) or not given.keys() <= set(names):
            plain_init(self, *args, **kwargs)  # Python says itself what is too much
        values = {name: _taken(part, name, value) for name, value in given.items()}
        plain_init(self, **values)
        self._noted(values, "", "")

    return init


def _taken(part: type[Part], name: str, value: Any) -> Any:
    """A value within its bounds, in the type of its setting."""
    setting = part.settings()[name]
    if type(value) not in _PLAIN and setting.kind in (int, float, str, bool) and not setting.many:
        from glucoloop.arguments import converted, is_traced  # which imports JAX

        value = converted(name, value, setting.kind, part.__name__)
        if is_traced(value):
            return value
    elif (
        setting.kind in (int, float, str, bool)
        and not setting.choices
        and not setting.many
        and not ((value is None and setting.optional) or _of_kind(value, setting.kind))
    ):
        from glucoloop.arguments import converted

        converted(name, value, setting.kind, part.__name__)  # raises
    return setting.check(value)


def _of_kind(value: object, kind: type) -> bool:
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, int | float if kind is float else kind)


def read(part: type[P], tree: Mapping[str, Any], *, ask: bool = False, where: str | None = None) -> P:
    """A part from a tree of given values, of which some may be texts; parts in it are read by their catalogues.

    Parameters
    ----------
    part : type
    tree : mapping
    ask : bool
        Whether values that are possible and implausible are asked about.
    where : str, optional
        Option or file in which the part stands; by default that of its first value.

    Raises
    ------
    Refusal
        For an unknown part or setting, or a value that is not possible.
    """
    values: dict[str, Any] = {}
    for key, leaf in tree.items():
        if key == NAME:
            continue
        at = place(leaf)
        if key in part.refused:
            what = at if at.startswith("--") else f"{at}: {key}" if at else key
            raise Refusal(f"{what} is no part of {with_article(part.kind)}; leave it out")
        try:
            setting = part.setting(key)
        except Refusal as error:
            raise Refusal(f"{at}: {error}" if at else str(error)) from None
        if setting.is_part:
            values[key] = _parts(setting, leaf, ask)
            continue
        value, called = _value(setting, leaf), ": ".join(filter(None, (at, part.name if NAME in tree else "")))
        if _alone(leaf):
            setting, called = setting.renamed(at), ""
        values[key] = setting.check(value, called)
        if ask:
            told = f"{called}: {setting.name}" if called else setting.name
            setting.ask(values[key], told, part.any_number)
    return part.partial(values, place(tree) if where is None else where, plain(tree.get(NAME, "")))


def _alone(leaf: Any) -> bool:
    first = leaf[0] if isinstance(leaf, list) and leaf else leaf
    return isinstance(first, GivenValue) and first.alone


def _value(setting: Setting, leaf: Any) -> Any:
    """The value of a leaf, read from its text where it has no type yet."""
    if isinstance(leaf, list):
        return tuple(_value(setting, item) for item in leaf)
    value = plain(leaf)
    if not isinstance(value, str):
        return value
    typed = isinstance(leaf, GivenValue) and leaf.text
    with_unit = setting.unit == "min" and value.rstrip()[-1:].isalpha()  # a file may write "10h" too
    return setting.read(value) if typed or with_unit else value


def _parts(setting: Setting, leaf: Any, ask: bool) -> Any:
    catalogue = setting.kind.catalogue
    if setting.optional and plain(leaf) in (None, NONE):
        return None
    if not setting.many and isinstance(leaf, list):
        raise Refusal(f"{place(leaf)}: {setting.name} is a list; give one, a table with a {NAME}")
    if not setting.many:
        return catalogue.read(leaf, ask=ask)
    return tuple(catalogue.read(item, ask=ask) for item in (leaf if isinstance(leaf, list) else [leaf]))


class MadePart(Part):
    """A part of which a function makes something.

    It is called with all settings by name, and with what else is known if it has a parameter of that name. A class that
    overrides `made` needs no such function.
    """

    make: ClassVar[str] = ""
    """The function, as ``module:function``; a class will do."""

    def made(self, **known: Any) -> Any:
        """Object that the part stands for; making it imports JAX.

        Raises
        ------
        Refusal
            If it is not possible.
        """
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
