"""Reading of a file that another person may have written."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.storage import disk

LARGEST_TEXT_BYTES: Final = 200_000_000


def read_text(path: Path, what: str) -> str:
    """Text of a file that the user named, which may also be a link or a pipe.

    A ValueError tells that it cannot be read as `what`, ``"a model"``: it is empty, far too large, or not text.
    """
    if "\0" in str(path):
        raise Refusal(f"the path {str(path)!r} holds a NUL character, which no file has in its name; leave it out")
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise Refusal(f"{path} is a folder, not {what}; name a file in it")
        if size > LARGEST_TEXT_BYTES:
            raise Refusal(f"{path} is too large for {what}: {size} bytes, at most {LARGEST_TEXT_BYTES} will do")
        with path.open("rb") as file:
            # A device or a pipe tells no size beforehand.
            data = file.read(LARGEST_TEXT_BYTES + 1)
    except OSError as error:
        raise _unread(path, what, error) from None
    return _text(data, path, what)


def kept_text(path: Path, what: str) -> str:
    """Text of a file in a folder that this program keeps: like `read_text`, but of a regular file only."""
    try:
        data = disk.read_bytes(path, LARGEST_TEXT_BYTES)
    except OSError as error:
        raise _unread(path, what, error) from None
    return _text(data, path, what)


def _unread(path: Path, what: str, error: OSError) -> Refusal:
    ways = " or ".join(filter(None, (disk.mend(error), f"give the path of {what}")))
    return Refusal(f"{path} cannot be read as {what}: {error.strerror}; {ways}")


def _text(data: bytes, path: Path, what: str) -> str:
    if len(data) > LARGEST_TEXT_BYTES:
        raise Refusal(f"{path} is too large for {what}: at most {LARGEST_TEXT_BYTES} bytes will do")
    if not data.strip():
        raise Refusal(f"{path} is empty; give the path of {what}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise Refusal(f"{path} is not text; give the path of {what}") from None
    if "\0" in text:
        raise Refusal(f"{path} is not text; give the path of {what}")
    return text
