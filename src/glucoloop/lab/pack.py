"""Packing of the page: one HTML file with its modules, styles, numbers and WebAssembly, which asks the network nothing.

The modules are one program, compressed. Workers begin with the same program, since they cannot load modules from a file
on a disk. The policy of the page forbids every connection, every script but this program and what unpacks it, and
every style but its own style sheet.
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
from glucoloop.pages import colours, exports, policy_source, program
from glucoloop.refusal import Refusal

PAGE: Final = Path(str(files("glucoloop.lab"))) / "page"
MODULE: Final = PAGE / "lab.wasm"
DATA: Final = PAGE / "lab.json"
_FIRST: Final = (PAGE / "main.mjs", PAGE / "worker.mjs")
"""Modules with which the page and its workers begin."""
_BEGIN: Final = 'need(globalThis.document ? "main" : "worker").start();'
_LANGUAGE: Final = PAGE / "language.mjs"
_OF_HTML: Final = bytes.maketrans(b"<{", b",.")
"""Two digits of Base85 that end a script of HTML or are of a template, and those in their place."""


def page(people: tuple[str, str] | None = None, language: str | None = None) -> str:
    """The whole page as the text of an HTML file; with a family of patients and a population, with these people.

    `language` is the code of a module in the place of ``language.mjs``; Refusal for one that has another form.
    """
    data = DATA.read_bytes()
    if people is not None:
        from glucoloop.lab.people import with_people

        data = json.dumps(with_people(json.loads(data), *people), separators=(",", ":")).encode()
    start, code = _read("start.js"), f"{{{_program(language)}{_BEGIN}}}\n"
    style = colours() + _read("lab.css")
    parts = {
        "VERSION": html.escape(glucoloop.__version__),
        "SCRIPTS": f"{policy_source(start)} {policy_source(code)}",
        "STYLES": policy_source(style),
        "STYLE": style,
        "START": start,
        "CODE": _packed(code.encode()),
        "MODULE": _packed(MODULE.read_bytes()),
        "DATA": _packed(data),
    }
    template = _read("lab.html")
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda result: parts[result[1]], template)


def _program(language: str | None) -> str:
    if language is None:
        return program(_FIRST)
    missing = sorted({"language", "own", "sentences"} - set(exports(language)))
    if missing:
        raise Refusal(
            f"the file of the language exports no {' and no '.join(map(repr, missing))}; begin each with a line like "
            "'export const language = \"de\";'"
        )
    try:
        return program(_FIRST, {_LANGUAGE: language})
    except ValueError as error:
        raise Refusal(f"the file of the language does not fit the page: {error}") from None


def _read(name: str) -> str:
    return (PAGE / name).read_text(encoding="utf-8")


def _packed(content: bytes) -> str:
    """Content compressed, the same bytes at any time, as text: Base85 is a sixteenth shorter than Base64."""
    return base64.b85encode(gzip.compress(content, 9, mtime=0)).translate(_OF_HTML).decode()
