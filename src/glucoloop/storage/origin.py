"""Origin of the results in a folder: the configuration, the version and the arithmetic that they depend on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import glucoloop
from glucoloop import arithmetic
from glucoloop.component.code import outside_code
from glucoloop.refusal import Refusal
from glucoloop.storage.files import json_text, stored_json
from glucoloop.text import shown


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Record on which the bits of the results depend, written before anything else; a kind of folder may add to it."""

    format: str = "glucoloop-rows 1"
    version: str
    """Version of glucoloop."""
    arithmetic: dict[str, str]
    """Record of `glucoloop.arithmetic.identity`, with digests of the code of other packages."""
    config: dict[str, Any]
    """The configuration as flat keys."""

    @classmethod
    def current(cls, config: Mapping[str, Any], **further: Any) -> Self:
        """Origin of work that begins now."""
        given = {key: value for key, value in config.items() if value is not None}
        identity = {**arithmetic.identity(), **outside_code(given)}
        return cls(version=glucoloop.__version__, arithmetic=identity, config=given, **further)

    def text(self) -> str:
        """JSON from which the same origin is read."""
        return json_text(vars(self)) + "\n"

    @classmethod
    def read(cls, place: Path) -> Self:
        """Read the record of a folder; ValueError if glucoloop did not write it."""
        mend = f"delete {place.parent} and run the same command again"
        written = stored_json(place, mend, dict[str, Any]).get("format")
        if written != cls.format:
            raise Refusal(
                f"{place} is of another format, {shown(written)} and not {cls.format}; read it with the glucoloop that "
                "wrote it"
            )
        return stored_json(place, mend, cls)


def differences(earlier: Mapping[str, Any], current: Mapping[str, Any]) -> Iterator[tuple[str, object, object]]:
    """Name, earlier value and current value of each key of two configurations that differs; cases by their labels."""
    before, now = _flat(earlier), _flat(current)
    for name in dict.fromkeys([*now, *before]):
        one, other = before.get(name), now.get(name)
        if json_text(one, str) != json_text(other, str):  # TOML also has dates, which no configuration has
            yield name, "not given" if one is None else one, "not given" if other is None else other


def _flat(config: Mapping[str, Any]) -> dict[str, object]:
    """Values of a configuration by the names of the keys, also of those in tables and cases."""
    result: dict[str, object] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            result |= {f"{key}.{name}": item for name, item in _flat(value).items()}
        elif key == "controller" and _are_cases(value):
            result["the list of cases"] = ", ".join(str(case["label"]) for case in value)
            for case in value:
                result |= {f"{name} of case {case['label']!r}": item for name, item in _flat(case).items()}
        else:
            result[key] = value
    return result


def _are_cases(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(case, dict) and "label" in case for case in value)
