"""``trial.json``: description of the trial of a folder, written before anything else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final

import polars as pl
from pydantic import BaseModel, ConfigDict, Field

import glucoloop
from glucoloop import arithmetic
from glucoloop.cohorts.trial import FORMAT, Trial, fingerprint
from glucoloop.refusal import Refusal
from glucoloop.storage import disk
from glucoloop.storage.files import kept_text
from glucoloop.storage.origin import Origin
from glucoloop.storage.strict_json import json_text

HEADER: Final = "trial.json"
_KIND: Final = "glucoloop-trial"
TABLES: Final = "polars"
"""Library that writes tables, and computes nothing."""


class Header(BaseModel):
    """Description of the trial in a folder."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    format: str = _KIND
    format_version: int = FORMAT
    version: str
    """Version of glucoloop."""
    fingerprint: str
    people: Annotated[int, Field(ge=1)]
    shards: Annotated[int, Field(ge=1)]
    libraries: dict[str, str]
    """Versions of the libraries that compute and that write tables."""
    arithmetic: dict[str, str]
    """Further arithmetic on which the bits of the results depend; see `glucoloop.arithmetic.identity`."""
    config: dict[str, Any]

    def text(self) -> str:
        """JSON from which the same header is read."""
        return json_text(dict(self)) + "\n"

    @property
    def computed_with(self) -> dict[str, str]:
        """Arithmetic on which the bits of the results depend, as `glucoloop.arithmetic.identity` gives it."""
        computing = {name: version for name, version in self.libraries.items() if name != TABLES}
        return {**computing, **self.arithmetic}

    @property
    def origin(self) -> Origin:
        """Origin of the results."""
        return Origin(self.version, self.config, self.computed_with)


def header_of(trial: Trial) -> Header:
    """The header of a trial that begins now."""
    origin = Origin.current(trial.tree(whole=True))
    identity = origin.arithmetic or {}
    libraries = {name: identity[name] for name in arithmetic.LIBRARIES}
    return Header(
        version=glucoloop.__version__,
        fingerprint=fingerprint(trial),
        people=trial.people,
        shards=trial.shards,
        libraries={**libraries, TABLES: pl.__version__},
        arithmetic={name: value for name, value in identity.items() if name not in libraries},
        config=dict(origin.config),
    )


def read_header(folder: Path) -> Header:
    """The header of a folder; ValueError if there is none, or glucoloop did not write it."""
    place = folder / HEADER
    if not folder.is_dir():
        raise Refusal(f"{folder} is not a folder; give the folder of a trial, as --out named it")
    if not disk.is_file(place):
        raise Refusal(f"{folder} holds no trial, for there is no {HEADER}; give a folder that glucoloop trial wrote")
    try:
        found = json.loads(kept_text(place, "the header of a trial"))
        kind, version = found["format"], found["format_version"]
        header = Header.model_validate(found) if (kind, version) == (_KIND, FORMAT) else None
    except (ValueError, TypeError, KeyError, RecursionError):
        raise Refusal(f"{place} is damaged; delete {folder} and run the trial again") from None
    if header is None:
        raise Refusal(f"{place} is of another format, {kind} {version}; read it with the glucoloop that wrote it")
    return header
