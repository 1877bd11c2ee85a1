"""Output of a command at its end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glucoloop.cli.screen import note

if TYPE_CHECKING:
    pass


def print_json(report: Mapping[str, Any], files: Mapping[str, str], notes: tuple[str, ...]) -> None:
    """Print the report on standard output, and files and notes on standard error."""
    from glucoloop.storage.strict_json import json_text, with_version

    print(json_text({**with_version(report), "files": files}))
    note(notes)


def where_written(out: Path | None, files: Mapping[str, str]) -> str:
    """Sentence on the place of the files, or on how to get them."""
    if out is None:
        return "Nothing was written; --out DIR keeps tables, figures and the configuration."
    return f"Wrote {', '.join(files)} to {out}."
