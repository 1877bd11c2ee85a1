"""Parts that all pages share: an engine that draws over time, colours, and the packing of modules into one script.

A page is one file and loads nothing. Modules import one another by relative paths, so that node runs them as they are.
In a page each is a function that returns what it exports.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import re
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Final

PAGES: Final = Path(str(files("glucoloop.pages")))
_IMPORT: Final = re.compile(r'^import (?P<names>\{(?:(?! as )[^}])*\}) from "(?P<path>\.\.?/[^"]+)";$', re.MULTILINE)
_EXPORT: Final = re.compile(r"^export (?=(?:async )?(?:function|class|const) (\w+))", re.MULTILINE)
_COMMENT: Final = re.compile(r"^ *(?:/\*\*(?:(?!\*/).)*\*/|//[^\n]*)\n", re.MULTILINE | re.DOTALL)
"""A comment that has its lines for itself; a page does without."""
_LEFT: Final = re.compile(r"^(?:import|export)\b.*$", re.MULTILINE)


def exports(code: str) -> list[str]:
    """Names that a module exports."""
    return _EXPORT.findall(code)


def program(first: Iterable[Path], others: Mapping[Path, str] | None = None) -> str:
    """The first modules and all that they import as one script, in which ``need(name)`` gives what a module exports.

    `others` has the code of modules in the place of that of their files.
    """
    waiting = list(first)
    known = set(waiting)
    functions = []
    while waiting:
        path = waiting.pop(0)
        code = (others or {}).get(path) or path.read_text(encoding="utf-8")
        for result in _IMPORT.finditer(code):
            other = (path.parent / result["path"]).resolve()
            if other not in known:
                known.add(other)
                waiting.append(other)
        functions.append(f'"{path.stem}": () => {{\n{_as_function(code, path)}\n}}')
    head = '"use strict";\nconst made = {};\nconst need = (name) => (made[name] ??= modules[name]());\n'
    return head + "const modules = {\n" + ",\n".join(functions) + "\n};\n"


def _as_function(code: str, path: Path) -> str:
    """Body of a function that does what a module does and returns what it exports."""
    exported = ", ".join(exports(code))
    body = _EXPORT.sub(
        "", _IMPORT.sub(lambda match: f'const {match["names"]} = need("{Path(match["path"]).stem}");', code)
    )
    left = _LEFT.search(body)
    if left is not None:
        raise ValueError(
            f"{path.name} has {left[0]!r}, which the packer does not know; name what is imported or exported"
        )
    return f"{_COMMENT.sub('', body)}return {{ {exported} }};"


def policy_source(text: str) -> str:
    """Source by which a content security policy takes a script or a style sheet of the page, and no other: its hash."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@functools.cache
def page_script() -> str:
    """The script of the pages of results."""
    return f'{program([PAGES / "page.mjs"])}need("page").start();\n'


@functools.cache
def colours() -> str:
    """The style sheet with the colours of all pages."""
    return (PAGES / "colours.css").read_text(encoding="utf-8")
