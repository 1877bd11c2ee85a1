"""Packing of the page: one HTML file with its modules, styles, numbers and WebAssembly, which asks the network nothing.

The modules of the page import one another by relative paths, so that node runs them as they are. In the file they are
compressed; ``start.js`` unpacks them into addresses ``data:`` of an import map. The policy of the page forbids every
connection.
"""

from __future__ import annotations

import base64
import functools
import gzip
import html
import json
import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Final

import glucoloop

PAGE: Final = Path(str(files("glucoloop.lab"))) / "page"
MODULE: Final = PAGE / "lab.wasm"
DATA: Final = PAGE / "lab.json"
_FIRST: Final = PAGE / "main.mjs"
_IMPORT: Final = re.compile(r'(?P<before>\b(?:from|import)\s*)"(?P<path>\.\.?/[^"]+)"')


def page() -> str:
    """The whole page as the text of an HTML file."""
    modules = {_name(path): code for path, code in sorted(_modules(_FIRST))}
    code = {"scripts": [_read("uPlot.iife.min.js")], "modules": modules, "first": _name(_FIRST)}
    parts = {
        "VERSION": html.escape(glucoloop.__version__),
        "STYLE": _read("uPlot.min.css") + _read("lab.css"),
        "START": _read("start.js"),
        "CODE": _packed(json.dumps(code).encode()),
        "MODULE": _packed(MODULE.read_bytes()),
        "DATA": _packed(DATA.read_bytes()),
    }
    template = _read("lab.html")
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda found: parts[found[1]], template)


def _read(name: str) -> str:
    return (PAGE / name).read_text(encoding="utf-8")


def _modules(path: Path) -> Iterator[tuple[Path, str]]:
    """A module and those that it imports, each once, with the names of the import map in place of paths."""
    waiting, known = [path], {path}
    while waiting:
        here = waiting.pop()
        code = here.read_text(encoding="utf-8")
        for found in _IMPORT.finditer(code):
            other = (here.parent / found["path"]).resolve()
            if other not in known:
                known.add(other)
                waiting.append(other)
        yield here, _IMPORT.sub(functools.partial(_renamed, here.parent), code)


def _renamed(folder: Path, found: re.Match[str]) -> str:
    """An import from a folder by the name of the import map."""
    return f'{found["before"]}"{_name((folder / found["path"]).resolve())}"'


def _name(path: Path) -> str:
    """Name of a module in the import map."""
    return f"lab/{path.name}"


def _packed(content: bytes) -> str:
    """Content compressed, the same bytes at any time, as text."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
