"""Reading of a file that another person may have written, and JSON that every parser accepts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import glucoloop
from glucoloop.refusal import Refusal
from glucoloop.schema.values import checked, json_value
from glucoloop.storage import disk
from glucoloop.user_file import read_regular

F = TypeVar("F")

_LARGEST_TEXT_BYTES: Final = 200_000_000


def read_text(path: Path, what: str) -> str:
    """Text of a file that the user named, which may also be a link to it.

    A ValueError tells that it cannot be read as `what`, ``"a model"``: it is empty, far too large, or not text.
    """
    try:
        data = read_regular(path, _LARGEST_TEXT_BYTES)
    except Refusal as error:
        raise Refusal(f"{path} cannot be read as {what}: {error}") from None
    except OSError as error:
        mend = disk.mend(error, f"give the path of {what}")
        raise Refusal(f"{path} cannot be read as {what}: {error.strerror}; {mend}") from None
    if len(data) > _LARGEST_TEXT_BYTES:
        raise Refusal(f"{path} is too large for {what}: at most {_LARGEST_TEXT_BYTES} bytes will do")
    if not data.strip():
        raise Refusal(f"{path} is empty; give the path of {what}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise Refusal(f"{path} is not text; give the path of {what}")
    return text


def stored_json(path: Path, mend: str, form: type[F]) -> F:
    """JSON object of a form in a regular file of this program; a Refusal, which ends in `mend`, tells of damage.

    The form is a dataclass, see `schema.values`, or ``dict[str, Any]`` for any object.
    """
    data = disk.read_bytes(path, _LARGEST_TEXT_BYTES)
    try:
        return checked(form, json_value(data))
    except Refusal as error:
        raise Refusal(f"{path} is damaged: {error}; {mend}") from None


def json_text(value: object, other: Callable[[Any], object] | None = None) -> str:
    """Indented JSON of plain values, and of others as `other` makes them plain; a number that is not finite is null."""
    return json.dumps(_finite(value), indent=2, allow_nan=False, ensure_ascii=False, default=other)


def with_version(report: Mapping[str, Any]) -> dict[str, Any]:
    """A report with the version that made it, first."""
    return {"version": glucoloop.__version__, **report}


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
