"""Pages from templates: Jinja escapes every value, and refuses a name that is not defined.

A study's template extends ``templates/base.html``, which has the sections that all pages share; macros for tables,
maps and facts are in ``templates/parts.html``, and the one style sheet is ``page.css``.
"""

from __future__ import annotations

import functools
import importlib.resources
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from markupsafe import Markup

import glucoloop
from glucoloop.component.code import loaded
from glucoloop.display_units import OTHERS, headings_in_both, in_both_units, in_shown_units, other_number, shown_unit
from glucoloop.pages import colours, page_script, policy_source
from glucoloop.reporting.columns import headings
from glucoloop.situations.toml import toml_text, with_code
from glucoloop.text import glucose_text, percent

if TYPE_CHECKING:
    import jinja2

_FOOTER: Final = "Research software, not a medical device."
_SHARED: Final = Path(str(importlib.resources.files("glucoloop.reporting"))) / "templates"
_DESCRIPTIONS: Final = "glucoloop.reporting.descriptions"
"""Module of words on faults, which imports JAX; pages without them do without it."""
_COLOURS: Final = 6
"""Number of colours of runs in ``pages/colours.css``."""


@dataclass(frozen=True)
class Repeat:
    """Command and configuration that repeat the results of a page."""

    command: str
    """Command without the name of the program: ``run --config run.toml``."""
    keys: Mapping[str, Any]
    """Configuration of the command."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Files beside the page, each with what it holds."""
    explicit: Mapping[str, Any] | None = None
    """Keys from which the configuration follows, if it was read from fewer."""

    @property
    def text(self) -> str:
        """Text of the configuration file."""
        return toml_text(self.keys, self.command, self.explicit)


def render(
    template: Path,
    title: str,
    *,
    sentences: Iterable[str] = (),
    facts: Mapping[str, str] | None = None,
    repeat: Repeat | None = None,
    script: bool = False,
    **values: Any,
) -> str:
    """A self-contained page from a template that extends ``base.html``, which is given `values`.

    `sentences` are the results in words, `facts` everything that they depend on, by name, and `repeat` what repeats
    them; a page with plots needs the `script`.
    """
    code = Markup(page_script() if script else "")
    values |= {"title": title, "sentences": list(sentences), "facts": facts or {}, "repeat": repeat, "script": code}
    source = Markup(policy_source(f"\n{code}") if script else "'none'")
    page = _environment(template.parent).get_template(template.name)
    style = _style()
    return page.render(style=style, style_source=Markup(policy_source(f"\n{style}")), script_source=source, **values)


@functools.cache
def _environment(folder: Path) -> jinja2.Environment:
    import jinja2  # where a page is written

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, _SHARED]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"version": glucoloop.__version__, "footer": _FOOTER, "other_units": OTHERS}
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    environment.filters |= {
        "colour": lambda index: f"colour-{index % _COLOURS}",
        "glucose_text": glucose_text,
        "headings_in_both": headings_in_both,
        "in_both_units": in_both_units,
        "in_shown_units": in_shown_units,
        "headings": headings,
        "mmol_text": lambda mg_dl: other_number(glucose_text(mg_dl), mg_dl, "mg/dl"),
        "percent": percent,
        "quoted": lambda text: quote(text, safe=""),
        "settings_in_words": lambda fault: loaded(f"{_DESCRIPTIONS}:settings_in_words")(fault),
        "shown_unit": shown_unit,
        "thousands": lambda count: f"{count:,}".replace(",", "\u202f"),
        "toml": toml_text,
        "when_in_words": lambda fault, start_min: loaded(f"{_DESCRIPTIONS}:when_in_words")(fault, start_min),
        "with_code": with_code,
    }
    return environment


@functools.cache
def _style() -> Markup:
    return Markup(colours() + _SHARED.with_name("page.css").read_text(encoding="utf-8"))
