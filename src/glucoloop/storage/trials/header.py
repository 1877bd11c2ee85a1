"""``trial.json``: description of the trial of a folder, written before anything else."""

from __future__ import annotations

import functools
import importlib.metadata
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import glucoloop
from glucoloop import arithmetic
from glucoloop.cohorts.trial import FORMAT, Trial, fingerprint
from glucoloop.parts.code import outside_code
from glucoloop.refusal import Refusal
from glucoloop.storage import disk
from glucoloop.storage.files import kept_text
from glucoloop.storage.origin import Origin
from glucoloop.storage.strict_json import json_text

HEADER: Final = "trial.json"
_KIND: Final = "glucoloop-trial"
_TABLES: Final = "polars"


@dataclass(frozen=True)
class Header:
    """Description of the trial in a folder."""

    version: str
    """Version of glucoloop."""
    fingerprint: str
    people: int
    shards: int
    libraries: Mapping[str, str]
    """Versions of the libraries that compute and that write tables."""
    arithmetic: Mapping[str, str]
    """Arithmetic on which the bits of the results depend; see `glucoloop.arithmetic.identity`."""
    config: Mapping[str, Any]

    def text(self) -> str:
        """JSON from which the same header is read."""
        return json_text({"format": _KIND, "format_version": FORMAT, **vars(self)}) + "\n"


@functools.cache
def _version_of_tables() -> str:
    return importlib.metadata.version(_TABLES)


def header_of(trial: Trial) -> Header:
    """The header of a trial that begins now."""
    config = {key: value for key, value in trial.tree(whole=True).items() if value is not None}
    here = {**arithmetic.identity(), **outside_code(config)}
    libraries = {name: here[name] for name in arithmetic.LIBRARIES}
    return Header(
        version=glucoloop.__version__,
        fingerprint=fingerprint(trial),
        people=trial.people,
        shards=trial.shards,
        libraries={**libraries, _TABLES: _version_of_tables()},
        arithmetic={name: value for name, value in here.items() if name not in libraries},
        config=config,
    )


def read_header(folder: Path) -> Header:
    """The header of a folder.

    Raises
    ------
    ValueError
        If there is none, or glucoloop did not write it.
    """
    place = folder / HEADER
    if not folder.is_dir():
        raise Refusal(f"{folder} is not a folder; give the folder of a trial, as --out named it")
    if not disk.is_file(place):
        raise Refusal(f"{folder} holds no trial, for there is no {HEADER}; give a folder that glucoloop trial wrote")
    try:
        found = json.loads(kept_text(place, "the header of a trial"))
        kind, version = found.pop("format"), found.pop("format_version")
        of_format = kind == _KIND and version == FORMAT
        header = Header(**found) if of_format else None
        if header is not None:
            _check(header)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise Refusal(f"{place} is damaged; delete {folder} and run the trial again") from None
    if header is None:
        raise Refusal(f"{place} is of another format, {kind} {version}; read it with the glucoloop that wrote it")
    return header


def _check(header: Header) -> None:
    """Raise TypeError unless each part has its type."""
    if not all(isinstance(part, dict) for part in (header.libraries, header.arithmetic, header.config)):
        raise TypeError
    texts = (header.version, header.fingerprint, *header.libraries.values(), *header.arithmetic.values())
    if not all(isinstance(text, str) for text in texts):
        raise TypeError
    cases = header.config.get("controller", [])
    if not isinstance(cases, list) or not all(isinstance(case, dict) and "label" in case for case in cases):
        raise TypeError
    if not all(type(number) is int and number >= 1 for number in (header.people, header.shards)):
        raise TypeError


def origin_of(header: Header) -> Origin:
    """Origin of a trial, from its header."""
    return Origin(header.version, header.config, arithmetic_of(header))


def arithmetic_of(header: Header) -> dict[str, str]:
    """Arithmetic on which the bits of the results depend, as `glucoloop.arithmetic.identity` gives it."""
    computing = {name: version for name, version in header.libraries.items() if name != _TABLES}
    return {**computing, **header.arithmetic}


def other_tables(there: Header, here: Header, folder: Path) -> Iterator[str]:
    """Notes on tables that are written by another version of a library than the first ones."""
    before, now = (of.libraries.get(_TABLES) for of in (there, here))
    if before != now:
        yield f"{folder} was begun with {_TABLES} {before}, and this is {now}; tables hold the same, in other bytes."
