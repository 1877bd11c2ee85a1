"""A component that is its own science: settings, what it is connected to, and methods, in one class that JAX can trace.

A sensor with noise of its own is one class::

    class Noisy(SensorComponent, name="noisy"):
        \"\"\"Readings with normal noise.\"\"\"

        sd_mg_dl: Annotated[float, About("Standard deviation of the noise.", at_least=0.0)] = 3.0

        def init(self, glucose_mg_dl, key):
            return self.inner.init(glucose_mg_dl, key)

        def read(self, state, glucose_mg_dl, key):
            own, key = jax.random.split(key)
            state, reading = self.inner.read(state, glucose_mg_dl, key)
            noise = self.sd_mg_dl * jax.random.normal(own, glucose_mg_dl.shape)
            return state, dataclasses.replace(reading, glucose_mg_dl=reading.glucose_mg_dl + noise)

An object has three kinds of attributes: settings, which are annotated with `About`; fields that `wired` declares, like
``inner``; and numbers that follow from both, which `derived` computes once, on the host and in float64. `Role` says
what each of them is in a compiled program.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Mapping
from enum import Enum
from typing import Any, ClassVar, Final, NamedTuple, Self, TypeVar

from glucoloop._pytree import register
from glucoloop.component.base import WIRING, Component
from glucoloop.component.request import Request
from glucoloop.refusal import Refusal

T = TypeVar("T")


class Role(Enum):
    """Role of an attribute in a compiled program."""

    DATA = "data"
    """Numbers that change without compiling again, in which people may differ: the default of a `float`."""
    STATIC = "static"
    """Part of the program: the default of other settings."""
    HOST = "host"
    """Known on the host alone, where something is derived from it. Within a program there is `ABSENT` in its place."""


DATA: Final = Role.DATA
STATIC: Final = Role.STATIC
HOST: Final = Role.HOST


class _Absent:
    def __repr__(self) -> str:
        return "<known on the host alone>"


ABSENT: Final = _Absent()
"""Value of an attribute of the role `HOST` within a program."""


def wired(role: Role, **kwargs: Any) -> Any:
    """A field that is no setting: what an object is connected to, or a fact of the loop around it."""
    return dataclasses.field(kw_only=True, metadata={WIRING: True, "role": role}, **kwargs)


class derived(functools.cached_property[T]):  # noqa: N801
    """Decorator of a method whose value is computed once, on the host, and is data of the program."""

    role: ClassVar[Role] = DATA


class derived_static(derived[T]):  # noqa: N801
    """The same for a value that is part of the program."""

    role: ClassVar[Role] = STATIC


class _Attributes(NamedTuple):
    """Names of the attributes of a class by their roles."""

    data: tuple[str, ...]
    static: tuple[str, ...]
    host: tuple[str, ...]


def same_parts(value: Any, other: Any) -> bool:
    """Whether two values have the same parts, which may be arrays."""
    import jax
    import numpy as np

    parts, others = jax.tree.leaves(value), jax.tree.leaves(other)
    return len(parts) == len(others) and all(map(np.array_equal, parts, others))


class PytreeComponent(Component):
    """A component with its science as methods. An object of it is complete when it is made, and never changes."""

    role_of_settings: ClassVar[Role | None] = None
    """Role of the settings that declare none, such as `HOST` where all are used up by a design; None: by their type."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        register(cls, lambda: cls._attributes()[:2], cls._rebuilt)

    @classmethod
    def _attributes(cls) -> _Attributes:
        names: _Attributes | None = vars(cls).get("_names")
        if names is None:
            roles: dict[str, Role] = {}
            hints = typing.get_type_hints(cls, include_extras=True)
            for field in dataclasses.fields(typing.cast(Any, cls)):
                declared = (mark for mark in getattr(hints[field.name], "__metadata__", ()) if isinstance(mark, Role))
                roles[field.name] = next(declared, field.metadata.get("role") or cls._role_of_setting(field.name))
            roles |= {name: getattr(cls, name).role for name in cls.derived_names()}
            names = _Attributes(*(tuple(name for name in roles if roles[name] is role) for role in Role))
            type.__setattr__(cls, "_names", names)
        return names

    @classmethod
    def _role_of_setting(cls, name: str) -> Role:
        return cls.role_of_settings or (DATA if cls.settings()[name].kind is float else STATIC)

    @classmethod
    @functools.cache
    def derived_names(cls) -> tuple[str, ...]:
        """Names of the derived attributes."""
        members = {name: member for base in reversed(cls.__mro__) for name, member in vars(base).items()}
        return tuple(name for name, member in members.items() if isinstance(member, derived))

    @classmethod
    def _rebuilt(cls, values: Mapping[str, Any]) -> Self:
        return cls._of({"request": Request(cls), **dict.fromkeys(cls._attributes().host, ABSENT), **values})

    @classmethod
    def _of(cls, attributes: Mapping[str, Any]) -> Self:
        """An object with these attributes, which the constructor would refuse where JAX has put something else."""
        whole = object.__new__(cls)
        vars(whole).update(attributes)
        return whole

    def replaced(self, **values: Any) -> Self:
        """The same with other values, which are not checked: they may be arrays of people.

        What is derived follows, unless it is among the values; within a program it stays as it is.
        """
        old = vars(self)
        if not any(value is ABSENT for value in old.values()):
            old = {name: value for name, value in old.items() if name not in self.derived_names()}
        return self._of({**old, **values})

    def made(self, **surroundings: Any) -> Any:
        """The same connected to its surroundings: of these it takes those that it has fields for."""
        fields = {field.name for field in dataclasses.fields(typing.cast(Any, self)) if WIRING in field.metadata}
        whole = self.replaced(**{name: value for name, value in surroundings.items() if name in fields})
        whole.__post_init__()
        for name in self.derived_names():
            getattr(whole, name)  # refuses what cannot be
        return whole

    def as_request(self) -> Request[Self]:
        """The request from which the same component is made; Refusal where it holds what no setting says."""
        lost = self._beyond_settings()
        if lost:
            remedy = "give a chain as a list, the innermost first" if "inner" in lost else "give its settings alone"
            raise Refusal(
                f"the {self.kind} {self.display_name} holds what its settings do not say ({', '.join(lost)}), which a "
                f"configuration cannot have: there it would be made anew of its settings; {remedy}, or use "
                "gl.simulate, which takes it as it is"
            )
        return super().as_request()

    def _beyond_settings(self) -> tuple[str, ...]:
        """Names of what it is connected to, where that is not what an object of its settings has."""
        fields = [field for field in dataclasses.fields(typing.cast(Any, self)) if WIRING in field.metadata]
        names = [field.name for field in fields if getattr(self, field.name) is not field.default]
        if not names:
            return ()
        try:
            plain = type(self)(**self.values())
        except TypeError:  # it has a field without a default, as a sensor for a site has
            return ()
        return tuple(name for name in names if not same_parts(getattr(self, name), getattr(plain, name)))

    def is_designed(self) -> bool:
        """Whether all that methods need besides the settings is there; a field that may be None is not needed."""
        fields = (field for field in dataclasses.fields(typing.cast(Any, self)) if WIRING in field.metadata)
        return all(getattr(self, field.name) is not None or "None" in str(field.type) for field in fields)

    @classmethod
    def takes(cls, name: str) -> bool:
        """Whether an object can be connected to what has this name."""
        return any(
            field.name == name and WIRING in field.metadata for field in dataclasses.fields(typing.cast(Any, cls))
        )
