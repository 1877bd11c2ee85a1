"""Entry of a part with settings, from which options, help, keys of files and checks follow."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from glucoloop.registry.plugins import loaded
from glucoloop.registry.settings import Setting, Value, known_names, settings_of


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Description of a part that is available without making it.

    Raises
    ------
    ValueError
        For a place that is not written as ``module:function``, or a default that its setting does not allow.
    """

    kind: ClassVar[str]
    """Kind of the part in messages: ``"controller"``."""

    name: str
    summary: str
    record: type | str | None = None
    """Settings: a class made by `registry.settings.settings_record`, or ``module:Class``, or None without settings."""

    def __post_init__(self) -> None:
        for place in (*self.places, self.record):
            if isinstance(place, str) and not all(place.partition(":")):
                raise ValueError(f"{place!r} of the {self.kind} {self.name} is no place; write it like module:function")
        if not isinstance(self.record, type):
            return
        for setting in self.settings:
            for noisy in (False, True):
                try:
                    setting.check(setting.default.value(noisy=noisy))
                except ValueError as error:
                    raise ValueError(f"a default of the {self.kind} {self.name} is not allowed: {error}") from None

    @property
    def places(self) -> tuple[object, ...]:
        """Names of functions, each to be written as ``module:function``."""
        return ()

    @functools.cached_property
    def settings(self) -> tuple[Setting, ...]:
        """Settings, as the record declares them.

        Raises
        ------
        ValueError
            For a record that cannot be found, or does not declare its fields.
        """
        record = self._record
        return () if record is None else settings_of(record)

    @property
    def _record(self) -> type | None:
        if isinstance(self.record, str):
            record: type = loaded(self.record)
            return record
        return self.record

    def values(self, given: Mapping[str, Value]) -> Any:
        """Record of the given settings, and defaults for the others; None for a part without settings.

        Raises
        ------
        ValueError
            For a value out of its bounds.
        """
        record = self._record
        return None if record is None else record(**given)

    def setting(self, name: str) -> Setting:
        """A setting by name.

        Raises
        ------
        ValueError
            If there is no such setting.
        """
        known = {setting.name: setting for setting in self.settings}
        if name not in known:
            raise ValueError(f"the {self.kind} {self.name} has no setting {name!r}; {known_names(name, known)}")
        return known[name]
