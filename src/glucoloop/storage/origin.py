"""Origin of the results in a folder: the configuration, the version and the arithmetic that they depend on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import glucoloop
from glucoloop import arithmetic
from glucoloop.parts.code import outside_code
from glucoloop.storage.strict_json import json_text


@dataclass(frozen=True)
class Origin:
    """Configuration, version and arithmetic on which the bits of the results depend."""

    version: str | None
    """Version of glucoloop."""
    config: Mapping[str, Any]
    """The configuration as flat keys."""
    arithmetic: Mapping[str, str] | None
    """Record of `glucoloop.arithmetic.identity`; None if it is gone or damaged."""

    @staticmethod
    def current(config: Mapping[str, Any]) -> Origin:
        """Origin of work that begins now."""
        given = {key: value for key, value in config.items() if value is not None}
        return Origin(glucoloop.__version__, given, {**arithmetic.identity(), **outside_code(given)})


def differences(earlier: Mapping[str, Any], current: Mapping[str, Any]) -> Iterator[tuple[str, object, object]]:
    """Name, earlier value and current value of each key of two configurations that differs; cases by their labels."""
    before, now = _flat(earlier), _flat(current)
    for name in dict.fromkeys([*now, *before]):
        one, other = before.get(name), now.get(name)
        if _text(one) != _text(other):
            yield name, _shown(one), _shown(other)


def _flat(config: Mapping[str, Any]) -> dict[str, object]:
    """Values of a configuration by the names of the keys, also of those in tables and cases."""
    found: dict[str, object] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            found |= {f"{key}.{name}": item for name, item in _flat(value).items()}
        elif key == "controller" and _are_cases(value):
            found["the list of cases"] = ", ".join(str(case["label"]) for case in value)
            for case in value:
                found |= {f"{name} of case {case['label']!r}": item for name, item in _flat(case).items()}
        else:
            found[key] = value
    return found


def _are_cases(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(case, dict) and "label" in case for case in value)


def _text(value: object) -> str:
    """Text of a value for comparison; TOML also has dates, which no configuration has."""
    try:
        return json_text(value)
    except TypeError:
        return str(value)


def _shown(value: object) -> object:
    return "not given" if value is None else value
