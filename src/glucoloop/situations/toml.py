"""Configuration files: TOML with a table for each component with settings, and a table of all that was used."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import tomli_w

import glucoloop
from glucoloop.component.code import names_code
from glucoloop.refusal import Refusal
from glucoloop.user_file import read_regular

VERSION_KEY = "glucoloop"
"""Key of the version of glucoloop that wrote the file."""
USED_KEY: Final = "used"
"""Table of all values that were used, the computed ones among them; a configuration is read without it."""
LARGEST_CHARACTERS: Final = 1_000_000
_MAX_DOTS: Final = 3000
"""Largest number of dots in a line; the parser's memory for a dotted key grows with the square of its length."""
_DEEPEST: Final = 10
LARGEST_INTEGER: Final = 2**63 - 1
"""Largest integer of TOML; a larger one may exist neither as float nor as text."""


class ConfigurationFile(NamedTuple):
    """A configuration file."""

    keys: dict[str, Any]
    """Keys that were given, from which it is read."""
    version: str | None
    """Version of glucoloop that wrote it, if the file says so."""
    used: dict[str, Any] | None
    """All values that were used when it was written, if the file holds them."""


def read_toml(text: str, name: str) -> ConfigurationFile:
    """Configuration from the text of a file; one that is not TOML, too long or too deeply nested is refused."""
    too_large = f"{name} holds a whole number beyond {LARGEST_INTEGER}, which TOML does not have; give a smaller one"
    too_deep = f"{name} is nested too deeply for a configuration"
    if len(text) > LARGEST_CHARACTERS:
        raise Refusal(
            f"{name} is too large for a configuration: {len(text)} characters, at most {LARGEST_CHARACTERS} will do"
        )
    if any(line.count(".") > _MAX_DOTS for line in text.splitlines()):
        raise Refusal(f"{name} has a line with more than {_MAX_DOTS} dots; break it into several")
    try:
        keys = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise Refusal(f"{name} is not TOML: {str(error).rstrip('.')}") from None
    except RecursionError:
        raise Refusal(too_deep) from None
    except ValueError:  # Python refuses a number of thousands of digits
        raise Refusal(too_large) from None
    if _deeper_than(keys, _DEEPEST):
        raise Refusal(too_deep)
    if _holds_too_large(keys):
        raise Refusal(too_large)
    version = keys.pop(VERSION_KEY, None)
    used = keys.pop(USED_KEY, None)
    if not isinstance(used, dict | None):
        raise Refusal(f"{USED_KEY} is {used!r} in {name}; it is the table of what was used, leave it out")
    return ConfigurationFile(keys, None if version is None else str(version), used)


def read_file(path: str) -> ConfigurationFile:
    """Configuration from a file; what cannot be read is refused."""
    return read_toml(text_of_file(path, "TOML"), path)


def text_of_file(path: str, what: str) -> str:
    """Text of a file of a kind, and no more than makes it too large; what cannot be read is refused."""
    try:
        # No more than the largest size of a configuration, so that a larger file is refused and never read whole.
        data = read_regular(Path(path), 4 * LARGEST_CHARACTERS)
        cut = len(data) > 4 * LARGEST_CHARACTERS
        text = data.decode("utf-8-sig", errors="ignore" if cut else "strict")[: LARGEST_CHARACTERS + 1]
    except Refusal as error:
        raise Refusal(f"{path} is not {what}: {error}") from None
    except OSError as error:
        raise Refusal(
            f"{path} cannot be read: {error.strerror or error}; give the path of a file in {what} that can be read"
        ) from None
    except UnicodeDecodeError:
        raise Refusal(f"{path} is not {what}: it is not text in UTF-8") from None
    return text if what == "CSV" else text.replace("\r\n", "\n").replace("\r", "\n")


def _deeper_than(value: object, levels: int) -> bool:
    """Whether tables and lists are nested more deeply than a number of levels.

    It is not recursive, so that any depth is measured; files of other people may nest without limit.
    """
    there = [value]
    for _ in range(levels + 1):
        there = [
            inner
            for outer in there
            if isinstance(outer, Mapping | list | tuple)
            for inner in (outer.values() if isinstance(outer, Mapping) else outer)
        ]
    return bool(there)


def _holds_too_large(value: object) -> bool:
    if isinstance(value, Mapping | list):
        return any(map(_holds_too_large, value.values() if isinstance(value, Mapping) else value))
    return isinstance(value, int) and not -LARGEST_INTEGER <= value <= LARGEST_INTEGER


def toml_text(keys: Mapping[str, Any], command: str, explicit: Mapping[str, Any] | None = None) -> str:
    """Text of a configuration file with which a command, without the program's name, repeats itself.

    `keys` holds the values that were used, and `explicit` the keys from which they follow: where it is there, the file
    is read from them, and has `keys` in a table of its own. Keys without a value are left out.
    """
    table = {VERSION_KEY: glucoloop.__version__, **_with_values(keys if explicit is None else explicit)}
    used = {} if explicit is None else {USED_KEY: _with_values(keys)}
    return f"# Repeat with: glucoloop {with_code(command, keys)}\n{tomli_w.dumps({**table, **used})}"


def _with_values(value: Any) -> Any:
    """A tree without the keys that have no value, for which TOML has no sign."""
    if isinstance(value, Mapping):
        return {key: _with_values(inner) for key, inner in value.items() if inner is not None}
    return [_with_values(inner) for inner in value] if isinstance(value, list | tuple) else value


def with_code(command: str, keys: Mapping[str, Any]) -> str:
    """A command that reads these keys from a file, with the permission to import code if they name any."""
    return f"{command} --allow-code" if names_code(keys) else command
