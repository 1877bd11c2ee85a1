"""Origin of the results in a folder: the configuration, the version and the arithmetic that they depend on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeGuard

import glucoloop
from glucoloop import arithmetic
from glucoloop.parts.code import outside_code
from glucoloop.refusal import Refusal
from glucoloop.storage.strict_json import json_text

ARITHMETIC: Final = "arithmetic.json"
"""Record of the arithmetic, where the first file of a folder does not hold it."""


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
    def here(config: Mapping[str, Any]) -> Origin:
        """Origin of work that begins now."""
        given = {key: value for key, value in config.items() if value is not None}
        return Origin(glucoloop.__version__, given, {**arithmetic.identity(), **outside_code(given)})

    def without(self, keys: frozenset[str]) -> Origin:
        """Origin without some keys of the configuration."""
        left = {key: value for key, value in self.config.items() if key not in keys}
        return Origin(self.version, left, self.arithmetic)


def refuse_another(there: Origin, here: Origin, folder: Path, what: str) -> None:
    """Raise ValueError, with the first difference, if a folder holds work of another version or configuration."""
    if there.version != here.version:
        raise Refusal(
            f"{folder} was begun by glucoloop {there.version}, and this is {here.version}; "
            f"go on with {there.version}, or choose another folder with --out"
        )
    found = next(differences(there.config, here.config), None)
    if found is not None:
        name, before, now = found
        raise Refusal(
            f"{folder} holds another {what}: {name} is {before} there and {now} here; choose another folder with "
            "--out, or add --overwrite to replace it"
        )


def other_arithmetic(there: Origin, here: Origin, folder: Path) -> str | None:
    """Difference between the arithmetic of a folder and that of this process, a sentence without its full stop.

    Raises
    ------
    ValueError
        If it is not known with which arithmetic the folder was computed.
    """
    if there.arithmetic is None or here.arithmetic is None:
        raise Refusal(
            f"{folder / ARITHMETIC} is damaged or gone, so it is not known how what is done was computed; "
            "choose another folder with --out, or add --overwrite to begin again"
        )
    found = arithmetic.difference(there.arithmetic, here.arithmetic)
    if found is None:
        return None
    name, before, now = found
    return f"{folder} was computed with {name} {before}, and here it is {now}"


def differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[tuple[str, object, object]]:
    """Name, value there and value here of each key of two configurations that differs; cases by their labels."""
    for key in dict.fromkeys([*here, *there]):
        before, now = there.get(key), here.get(key)
        if _text(before) == _text(now):
            continue
        if key == "controller" and _are_cases(before) and _are_cases(now):
            yield from _differing_cases(before, now)
        elif isinstance(before, Mapping) and isinstance(now, Mapping):
            yield from ((f"{key}.{name}", one, other) for name, one, other in differences(before, now))
        else:
            yield key, _shown(before), _shown(now)


def _differing_cases(there: list[dict[str, Any]], here: list[dict[str, Any]]) -> Iterator[tuple[str, object, object]]:
    labels = [", ".join(str(case["label"]) for case in cases) for cases in (there, here)]
    if labels[0] != labels[1]:
        yield "the list of cases", labels[0], labels[1]
        return
    for before, now in zip(there, here, strict=True):
        of_case = f" of case {now['label']!r}"
        yield from ((f"{name}{of_case}", one, other) for name, one, other in differences(before, now))


def _are_cases(value: object) -> TypeGuard[list[dict[str, Any]]]:
    return isinstance(value, list) and all(isinstance(case, dict) and "label" in case for case in value)


def _text(value: object) -> str:
    """Text of a value for comparison; TOML also has dates, which no configuration has."""
    try:
        return json_text(value)
    except TypeError:
        return str(value)


def _shown(value: object) -> object:
    return "not given" if value is None else value
