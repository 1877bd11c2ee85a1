"""Configuration files: flat TOML whose keys are the options' own names with their units."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

import glucoloop

VERSION_KEY = "glucoloop"
"""Key under which a written file tells the version that wrote it."""


def read_toml(text: str, name: str) -> tuple[dict[str, Any], str | None]:
    """Keys of a configuration file, and the version that wrote it, if it tells.

    Raises
    ------
    ValueError
        For a text that is not TOML.
    """
    try:
        keys = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name} is not TOML: {str(error).rstrip('.')}") from None
    version = keys.pop(VERSION_KEY, None)
    return keys, None if version is None else str(version)


def beside(path: str, file: Path) -> str:
    """A path that stands in a configuration file: relative ones start at the file."""
    return str(file.parent / path)


def toml_text(keys: Mapping[str, Any], command: str) -> str:
    """Text of a configuration file with which a command repeats itself; keys without a value are left out."""
    given = {key: value for key, value in keys.items() if value is not None}
    body = tomli_w.dumps({VERSION_KEY: glucoloop.__version__, **given})
    return f"# Repeat with: glucoloop {command}\n{body}"
