"""Packing of the page: one HTML file with its modules, styles, numbers and WebAssembly, which asks the network nothing.

The modules of the page import one another by relative paths, so that node runs them as they are. In the file they
become addresses ``data:`` of an import map, and the policy of the page forbids every connection.
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
    modules = dict(_modules(_FIRST))
    imports = {_name(path): _data("text/javascript", code.encode()) for path, code in modules.items()}
    parts = {
        "VERSION": html.escape(glucoloop.__version__),
        "STYLE": (PAGE / "uPlot.min.css").read_text(encoding="utf-8") + (PAGE / "lab.css").read_text(encoding="utf-8"),
        "UPLOT": (PAGE / "uPlot.iife.min.js").read_text(encoding="utf-8"),
        "IMPORTS": json.dumps({"imports": imports}),
        "FIRST": _name(_FIRST),
        "MODULE": _packed(MODULE.read_bytes()),
        "DATA": _packed(DATA.read_bytes()),
    }
    template = (PAGE / "lab.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda found: parts[found[1]], template)


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


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _packed(content: bytes) -> str:
    """Content compressed, the same bytes at any time, as text."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
