"""Packing of the page: one HTML file with its modules, styles, numbers and WebAssembly, which asks the network nothing.

The modules are one program, compressed. Workers begin with the same program, since they cannot load modules from a file
on a disk. The policy of the page forbids every connection.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Final

import glucoloop
from glucoloop.pages.script import colours, program

PAGE: Final = Path(str(files("glucoloop.lab"))) / "page"
MODULE: Final = PAGE / "lab.wasm"
DATA: Final = PAGE / "lab.json"
_FIRST: Final = (PAGE / "main.mjs", PAGE / "worker.mjs")
"""Modules with which the page and its workers begin."""


def page(people: tuple[str, str] | None = None) -> str:
    """The whole page as the text of an HTML file; with a family of patients and a population, with these people."""
    data = DATA.read_bytes()
    if people is not None:
        from glucoloop.lab.own_people import with_people

        data = json.dumps(with_people(json.loads(data), *people), separators=(",", ":")).encode()
    parts = {
        "VERSION": html.escape(glucoloop.__version__),
        "STYLE": colours() + _read("lab.css"),
        "START": _read("start.js"),
        "CODE": _packed(program(_FIRST).encode()),
        "MODULE": _packed(MODULE.read_bytes()),
        "DATA": _packed(data),
    }
    template = _read("lab.html")
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda found: parts[found[1]], template)


def _read(name: str) -> str:
    return (PAGE / name).read_text(encoding="utf-8")


def _packed(content: bytes) -> str:
    """Content compressed, the same bytes at any time, as text."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
