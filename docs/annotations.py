"""Sphinx extension: show the type of a setting, and leave out what `About` says of it, which `glucoloop list` shows."""

from typing import Any

from sphinx.application import Sphinx

_ANNOTATED = "Annotated["


def closing(text: str, start: int) -> int:
    """Index of the bracket that closes the one at `start`; -1 where none does."""
    depth = 0
    for index in range(start, len(text)):
        depth += (text[index] in "([{") - (text[index] in ")]}")
        if depth == 0:
            return index
    return -1


def bare(signature: str) -> str:
    """A signature with ``T`` in place of each ``Annotated[T, ...]``."""
    start = signature.find(_ANNOTATED)
    if start < 0:
        return signature
    opening = start + len(_ANNOTATED) - 1
    end, comma = closing(signature, opening), opening + 1
    if end < 0:
        return signature
    while signature[comma] != "," and comma < end:
        comma = closing(signature, comma) + 1 if signature[comma] in "([{" else comma + 1
    return signature[:start] + bare(signature[opening + 1 : comma] + signature[end + 1 :])


def process(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None] | None:
    if signature is None or _ANNOTATED not in signature:
        return None
    return bare(signature), returned


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("autodoc-process-signature", process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
