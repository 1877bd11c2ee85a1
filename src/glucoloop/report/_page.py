"""Common parts of all pages: one file with style and script, in light and dark mode, that needs no network."""

from __future__ import annotations

import base64
import functools
import hashlib
import html
import importlib.resources
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from string import Template
from typing import Any, Final
from urllib.parse import quote

import glucoloop
from glucoloop.printable import glucose_text
from glucoloop.situations.toml import toml_text, with_code
from glucoloop.units import MG_DL_PER_MMOL_L

_LAB: Final = "lab.html"
FOOTER: Final = "Research software, not a medical device."

_GLUCOSE: Final = re.compile(r"(\d+(?:\.\d+)?)((?:( to | – | and )(\d+(?:\.\d+)?))?) mg/dl(?![/²)])")


@dataclass(frozen=True)
class Repeat:
    """Command and configuration that repeat the results of a page."""

    command: str
    """Command without the name of the program: ``run --config run.toml``."""
    keys: Mapping[str, Any]
    """Configuration of the command."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Files beside the page, each with what it holds."""
    given: Mapping[str, Any] | None = None
    """Keys from which the configuration follows, if it was read from fewer."""

    @property
    def text(self) -> str:
        """Text of the configuration file."""
        return toml_text(self.keys, self.command, self.given)


def page(title: str, main: str, style: str = "", script: bool = False) -> str:
    """A self-contained HTML page.

    Parameters
    ----------
    title : str
        Title; characters special to HTML are escaped.
    main : str
        HTML below the title.
    style : str
        CSS in addition to that of all pages.
    script : bool
        Whether the page holds plots, which need the script.
    """
    code = f"\n{_asset('page.js')}" if script else ""
    digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    return _PAGE.substitute(
        title=html.escape(title),
        allowed=f"'sha256-{digest}'" if script else "'none'",
        style=_asset("page.css") + style,
        main=main,
        footer=FOOTER,
        version=glucoloop.__version__,
        script=f"<script>{code}</script>\n" if script else "",
    )


@functools.cache
def _asset(name: str) -> str:
    return importlib.resources.files("glucoloop.report").joinpath(name).read_text(encoding="utf-8")


def section(title: str, caption: str, body: str, kind: str = "") -> str:
    """A part of a page with its heading; title and caption are HTML."""
    told = f'<p class="caption">{caption}</p>\n' if caption else ""
    of_kind = f' class="{kind}"' if kind else ""
    return f"<section{of_kind}>\n<h2>{title}</h2>\n{told}{body}\n</section>"


def facts(told: Mapping[str, str]) -> str:
    """Settings by name, in columns."""
    entries = "".join(
        f"<div><dt>{html.escape(name)}</dt><dd>{in_both_units(html.escape(text))}</dd></div>"
        for name, text in told.items()
    )
    return f'<dl class="facts">{entries}</dl>'


def situation(told: Mapping[str, str], repeat: Repeat | None) -> str:
    """Section with everything that the results depend on, the command that repeats them, and the files beside."""
    parts = [facts({**told, "Version": f"glucoloop {glucoloop.__version__}"})]
    if repeat is not None:
        name = repeat.command.split()[-1]
        command = f"glucoloop {with_code(repeat.command, repeat.keys)} --out again"
        parts += [
            "<p>In the folder of this page, this command repeats it:</p>\n"
            f"<pre><code>{html.escape(command)}</code></pre>",
            f"<details><summary>The whole configuration, <code>{html.escape(name)}</code></summary>"
            f"<pre><code>{html.escape(repeat.text)}</code></pre></details>",
        ]
        if "controller" in repeat.keys or "case" in repeat.keys:
            opened = f"{_LAB}#configuration={quote(toml_text(repeat.keys, repeat.command), safe='')}"
            parts.append(
                "<p>To change it and watch what follows, write the laboratory beside this page, "
                f"<code>glucoloop lab --out {_LAB}</code>, and "
                f'<a href="{html.escape(opened)}">open it with this configuration</a>.</p>'
            )
        if repeat.files:
            links = ", ".join(
                f'<a href="{html.escape(file)}">{html.escape(file)}</a> ({html.escape(what)})'
                for file, what in repeat.files.items()
            )
            parts.append(f"<p>Exact data, in the same folder: {links}.</p>")
    return section("Situation", "", "\n".join(parts))


def scrolling(table: str, name: str) -> str:
    """A table that scrolls sideways where it does not fit, by keyboard too; `name` is escaped."""
    return f'<div class="scroll" tabindex="0" role="region" aria-label="{html.escape(name)}">{table}</div>'


def units(mmol: bool = False) -> str:
    """Choice of the unit of glucose, mg/dl at first or mmol/l."""
    choices = "".join(
        f'<label><input type="radio" name="unit" id="unit-{key}"{" checked" * checked}> {unit}</label>'
        for key, unit, checked in (("mg", "mg/dl", not mmol), ("mmol", "mmol/l", mmol))
    )
    return f'<fieldset class="units"><legend>Words and tables in</legend>{choices}</fieldset>'


def either(mg_dl: str, mmol_l: str) -> str:
    """HTML of a text in the unit of glucose that the reader chose."""
    return f'<span class="mg">{mg_dl}</span><span class="mmol">{mmol_l}</span>'


def glucose(mg_dl: float, digits: int = 1) -> str:
    """HTML of a glucose, with its unit."""
    if not mg_dl >= 0.0 or math.isinf(mg_dl):
        return glucose_text(mg_dl)
    return either(f"{mg_dl:.{digits}f} mg/dl", f"{mg_dl / MG_DL_PER_MMOL_L:.2f} mmol/l")


def in_both_units(told: str) -> str:
    """HTML in which every glucose in mg/dl can be shown in mmol/l."""

    def both(match: re.Match[str]) -> str:
        def mmol(text: str) -> str:
            return f"{float(text) / MG_DL_PER_MMOL_L:.1f}"

        second = f"{match[3]}{mmol(match[4])}" if match[4] else ""
        return either(match[0], f"{mmol(match[1])}{second} mmol/l")

    return _GLUCOSE.sub(both, told)


def cards(bodies: Mapping[str, str], columns: int, kind: str = "") -> str:
    """Parts beside each other, as many as fit; headings are HTML."""
    each = "\n".join(f'<div class="card"><h3>{head}</h3>\n{body}</div>' for head, body in bodies.items())
    return f'<div class="cards {kind}" style="--columns: {columns}">\n{each}\n</div>'


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, kind: str = "", values_from: int = 1) -> str:
    """HTML of a table whose cells are HTML; from a column on, cells are numbers."""

    def cell(place: int, text: str, tag: str) -> str:
        scope = ' scope="col"' if tag == "th" else ""
        kind = ' class="value"' if place >= values_from else ""
        return f"<{tag}{scope}{kind}>{text}</{tag}>"

    head = "".join(cell(place, text, "th") for place, text in enumerate(heads))
    lines = [
        f'<tr><th scope="row">{row[0]}</th>'
        + "".join(cell(place, text, "td") for place, text in enumerate(row[1:], start=1))
        + "</tr>"
        for row in rows
    ]
    return f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table>'


def count(people: int) -> str:
    """Text of a number of people, with its thousands separated."""
    return f"{people:,}".replace(",", "\u202f")


_PAGE: Final = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src $allowed">
<meta name="generator" content="glucoloop $version">
<title>$title</title>
<style>
$style</style>
</head>
<body>
<main>
<h1>$title</h1>
$main
</main>
<footer>$footer</footer>
$script</body>
</html>
""")
