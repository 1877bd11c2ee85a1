"""``trial.json``: which trial a folder holds, written before anything else."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import glucoloop
from glucoloop.config.cases import CASES_KEY
from glucoloop.config.trial import trial_keys
from glucoloop.storage.files import read_text
from glucoloop.storage.strict_json import json_text
from glucoloop.trials.trial import FORMAT, Trial, fingerprint

HEADER: Final = "trial.json"
_KIND: Final = "glucoloop-trial"
_LIBRARIES: Final = ("jax", "jaxlib", "numpy", "polars")


@dataclass(frozen=True)
class Header:
    """What a folder says of its trial."""

    version: str
    """Of glucoloop."""
    fingerprint: str
    people: int
    shards: int
    libraries: Mapping[str, str]
    config: Mapping[str, Any]

    def text(self) -> str:
        """JSON from which the same header is read."""
        return json_text({"format": _KIND, "format_version": FORMAT, **vars(self)}) + "\n"


def header_of(trial: Trial) -> Header:
    """The header of a trial that begins now."""
    return Header(
        version=glucoloop.__version__,
        fingerprint=fingerprint(trial),
        people=trial.people,
        shards=trial.shards,
        libraries={name: importlib.metadata.version(name) for name in _LIBRARIES},
        config={key: value for key, value in trial_keys(trial).items() if value is not None},
    )


def read_header(folder: Path) -> Header:
    """The header of a folder.

    Raises
    ------
    ValueError
        If there is none, or it is not what glucoloop writes.
    """
    place = folder / HEADER
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; give the folder of a trial, as --out named it")
    if not place.exists():
        raise ValueError(f"{folder} holds no trial, for there is no {HEADER}; give a folder that glucoloop trial wrote")
    try:
        found = json.loads(read_text(place, "the header of a trial"))
        kind, version = found.pop("format"), found.pop("format_version")
        header = Header(**found)
        _check(header)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ValueError(f"{place} is damaged; delete {folder} and run the trial again") from None
    if kind != _KIND or version != FORMAT:
        raise ValueError(f"{place} is of another format, {kind} {version}; read it with the glucoloop that wrote it")
    return header


def _check(header: Header) -> None:
    """Raise TypeError unless each part is of its kind."""
    if not all(isinstance(text, str) for text in (header.version, header.fingerprint, *header.libraries.values())):
        raise TypeError
    if not all(isinstance(part, dict) for part in (header.libraries, header.config)):
        raise TypeError
    cases = header.config.get(CASES_KEY, [])
    if not isinstance(cases, list) or not all(isinstance(case, dict) and "label" in case for case in cases):
        raise TypeError
    if not all(type(number) is int and number >= 1 for number in (header.people, header.shards)):
        raise TypeError


def difference(there: Header, here: Header, folder: Path) -> str | None:
    """Why a trial cannot go on in a folder, in a sentence that names the first difference; None if it can."""
    if there.version != here.version:
        return (
            f"{folder} was begun by glucoloop {there.version}, and this is {here.version}; "
            f"go on with {there.version}, or choose another folder with --out"
        )
    if there.fingerprint == here.fingerprint:
        return None
    name, before, now = _first_difference(there.config, here.config)
    return (
        f"{folder} holds another trial: {name} is {before} there and {now} here; choose another folder with --out, "
        "or add --overwrite to replace it"
    )


def other_libraries(there: Header, here: Header, folder: Path) -> Iterator[str]:
    """What to know where a trial goes on with other libraries than it began with."""
    for name, version in here.libraries.items():
        before = there.libraries.get(name)
        if before != version:
            yield f"{folder} was begun with {name} {before}, and this is {version}; last digits may differ."


def _first_difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> tuple[str, object, object]:
    for key in dict.fromkeys([*here, *there]):
        before, now = there.get(key), here.get(key)
        if json_text(before) == json_text(now):
            continue
        if key == CASES_KEY:
            return _first_case(before or [], now or [])
        if isinstance(before, Mapping) and isinstance(now, Mapping):
            part, before, now = _first_difference(before, now)
            return f"{key}.{part}", before, now
        return key, _shown(before), _shown(now)
    return "the configuration", "another", "as given"


def _first_case(there: list[dict[str, Any]], here: list[dict[str, Any]]) -> tuple[str, object, object]:
    labels = [[case["label"] for case in cases] for cases in (there, here)]
    if labels[0] != labels[1]:
        return "the list of cases", ", ".join(labels[0]), ", ".join(labels[1])
    for before, now in zip(there, here, strict=True):
        if before != now:
            part, of_before, of_now = _first_difference(before, now)
            return f"{part} of case {now['label']!r}", of_before, of_now
    raise AssertionError("the cases do not differ")


def _shown(value: object) -> object:
    return "not given" if value is None else value
