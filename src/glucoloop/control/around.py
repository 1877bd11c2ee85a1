"""Controllers around another one: they pass on what it declares, and components of them the profile of a person."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import TYPE_CHECKING, Any, Self

from glucoloop.component.effects import Need
from glucoloop.component.pytree_component import DATA, HOST, STATIC, PytreeComponent, wired
from glucoloop.control.protocol import (
    Controller,
    computed_settings,
    draws,
    gives_boluses,
    gives_glucagon,
    uses_of,
)
from glucoloop.therapy import Profile, given_profile


class AroundAnother:
    """Declarations that a controller around another one, its ``inner``, passes on."""

    if TYPE_CHECKING:

        @property
        def inner(self) -> Controller:
            """The other controller."""

    @property
    def gives_boluses(self) -> bool:
        """Whether the inner controller gives boluses."""
        return gives_boluses(self.inner)

    @property
    def gives_glucagon(self) -> bool:
        """Whether the inner controller gives glucagon."""
        return gives_glucagon(self.inner)

    @property
    def draws(self) -> bool:
        """Whether the inner controller draws random numbers."""
        return draws(self.inner)

    @property
    def needs_time_of_day(self) -> bool:
        """Whether the inner controller goes by the time of day."""
        return bool(getattr(self.inner, "needs_time_of_day", False))

    def settled(self) -> dict[str, Any]:
        """Settings of the inner controller that were settled when it was designed."""
        return dict(computed_settings(self.inner))


class ControllerAround(AroundAnother, PytreeComponent):
    """A controller around another one, its ``inner``."""

    _: KW_ONLY
    inner: Controller = wired(DATA, default=None)
    profile: Profile | None = wired(HOST, default=None)
    sample_time_min: float = wired(STATIC, default=5.0)

    @property
    def used(self) -> frozenset[Need]:
        """Needs that the inner controller meets, and this one."""
        return uses_of(self.inner) | self.uses()

    def with_profile(self, profile: Profile) -> Self:
        """The same of a person with the given profile, which the inner controller gets too if it takes it."""
        return self.made(inner=given_profile(self.inner, profile), profile=profile)  # type: ignore[no-any-return]
