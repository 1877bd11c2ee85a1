"""Packing of the page: one HTML file with its modules, styles, numbers and WebAssembly, which asks the network nothing.

The modules of the page import one another by relative paths, so that node runs them as they are. In the file they are
one program, compressed: each module is a function that returns what it exports. Workers begin with the same program,
since they cannot load modules from a file on a disk. The policy of the page forbids every connection.
"""

from __future__ import annotations

import base64
import gzip
import html
import re
from importlib.resources import files
from pathlib import Path
from typing import Final

import glucoloop

PAGE: Final = Path(str(files("glucoloop.lab"))) / "page"
MODULE: Final = PAGE / "lab.wasm"
DATA: Final = PAGE / "lab.json"
_FIRST: Final = (PAGE / "main.mjs", PAGE / "worker.mjs")
"""Modules with which the page and its workers begin."""
_IMPORT: Final = re.compile(r'^import (?P<names>\{(?:(?! as )[^}])*\}) from "(?P<path>\.\.?/[^"]+)";$', re.MULTILINE)
_EXPORT: Final = re.compile(r"^export (?=(?:async )?(?:function|class|const) (\w+))", re.MULTILINE)
_LEFT: Final = re.compile(r"^(?:import|export)\b.*$", re.MULTILINE)


def page() -> str:
    """The whole page as the text of an HTML file."""
    parts = {
        "VERSION": html.escape(glucoloop.__version__),
        "STYLE": _read("lab.css"),
        "START": _read("start.js"),
        "CODE": _packed(program().encode()),
        "MODULE": _packed(MODULE.read_bytes()),
        "DATA": _packed(DATA.read_bytes()),
    }
    template = _read("lab.html")
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda found: parts[found[1]], template)


def _read(name: str) -> str:
    return (PAGE / name).read_text(encoding="utf-8")


def program() -> str:
    """The modules as one script, in which ``need(name)`` gives what a module exports."""
    waiting, known = list(_FIRST), set(_FIRST)
    functions = []
    while waiting:
        path = waiting.pop(0)
        code = path.read_text(encoding="utf-8")
        for found in _IMPORT.finditer(code):
            other = (path.parent / found["path"]).resolve()
            if other not in known:
                known.add(other)
                waiting.append(other)
        functions.append(f'"{path.stem}": () => {{\n{_as_function(code, path)}\n}}')
    head = '"use strict";\nconst made = {};\nconst need = (name) => (made[name] ??= modules[name]());\n'
    return head + "const modules = {\n" + ",\n".join(functions) + "\n};\n"


def _as_function(code: str, path: Path) -> str:
    """Body of a function that does what a module does and returns what it exports."""
    exported = ", ".join(_EXPORT.findall(code))
    body = _EXPORT.sub(
        "", _IMPORT.sub(lambda match: f'const {match["names"]} = need("{Path(match["path"]).stem}");', code)
    )
    left = _LEFT.search(body)
    if left is not None:
        raise ValueError(
            f"{path.name} has {left[0]!r}, which the packer does not know; name what is imported or exported"
        )
    return f"{body}return {{ {exported} }};"


def _packed(content: bytes) -> str:
    """Content compressed, the same bytes at any time, as text."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
