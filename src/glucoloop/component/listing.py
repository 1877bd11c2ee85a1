"""Descriptions of every component with its settings, from declarations alone, and publications by name."""

from __future__ import annotations

import functools
import itertools
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import catalogues
from glucoloop.component.code import loaded
from glucoloop.component.grammar import component_text
from glucoloop.component.request import Request
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.component.setting import Setting, known_names, value_text
from glucoloop.refusal import Refusal

_KINDS: Final = {
    "journal": "article",
    "booktitle": "inproceedings",
    "school": "phdthesis",
    "publisher": "book",
    "version": "software",
}
"""Kind of an entry in BibTeX by what its publication stands in."""
_OTHERS: Final = "others"
_SUFFIXES: Final = ("Jr", "II", "III")
_FOR_TEX: Final = str.maketrans({"&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_", "∞": r"$\infty$"})


@dataclass(frozen=True)
class Reference:
    """A publication: its key, its authors, and its other fields by their names in BibTeX."""

    key: str
    authors: tuple[str, ...]
    fields: Mapping[str, str]

    @property
    def text(self) -> str:
        """The reference in one line, for people."""
        if not self.key:
            return self.fields["note"]
        named = [author.strip("{}") for author in self.authors if author != _OTHERS]
        authors = f"{named[0]} et al." if _OTHERS in self.authors else ", ".join(named)
        fields = self.fields
        place = next((fields[name] for name in _KINDS if name in fields and name != "version"), "")
        volume = fields.get("volume", "") + (f"({fields['number']})" if "number" in fields else "")
        version = f"version {fields['version']}" if "version" in fields else ""
        pieces = (
            authors,
            f'"{fields["title"]}"',
            f"{place} {volume}".strip(),
            version,
            fields.get("pages", ""),
            fields["year"],
            f"doi:{fields['doi']}" if "doi" in fields else "",
            fields.get("url", ""),
        )
        return ", ".join(filter(None, pieces))

    def bibtex(self, key: str = "") -> str:
        """The entry for BibTeX, under its key or another one."""
        kind = next((kind for name, kind in _KINDS.items() if name in self.fields), "misc")
        authors = " and ".join(map(_for_sorting, self.authors))
        fields = {"author": authors, **self.fields} if authors else self.fields
        lines = [f"  {name} = {{{_for_tex(name, value)}}}" for name, value in fields.items()]
        return "\n".join((f"@{kind}{{{key or self.key},", ",\n".join(lines), "}"))


def _for_sorting(author: str) -> str:
    """An author with the family name first, as BibTeX has to be told it where it has several words."""
    words = author.split()
    given = list(itertools.takewhile(lambda word: word.endswith("."), words))
    if author.startswith("{") or not given:
        return author
    family = words[len(given) :]
    after = [word for word in family if word in _SUFFIXES]
    return ", ".join(" ".join(names) for names in (family[: len(family) - len(after)], after, given) if names)


def _for_tex(name: str, value: str) -> str:
    if name in ("doi", "url"):
        return value
    written = value.translate(_FOR_TEX)
    if name == "title":  # in which a style would change capitals
        return f"{{{written}}}"
    return written.replace("-", "--") if name == "pages" else written


@functools.cache
def known_references() -> Mapping[str, Reference]:
    """The publications of this package by key."""
    tables = tomllib.loads(files(__package__).joinpath("references.toml").read_text(encoding="utf-8"))
    return {
        key: Reference(
            key,
            tuple(table["authors"]),
            {name: str(value) for name, value in table.items() if name != "authors"},
        )
        for key, table in tables.items()
    }


def cited_components(component: Component | Request[Any]) -> Iterator[type[Component]]:
    """Classes of a component that has a name and of those that it holds, from the outermost inwards."""
    kind = component.component if isinstance(component, Request) else type(component)
    if kind.name:
        yield kind
    for name in kind.settings():
        value = component.value(name) if isinstance(component, Request) else getattr(component, name)
        for inner in value if isinstance(value, tuple) else (value,):
            if isinstance(inner, Component | Request):
                yield from cited_components(inner)


def reference(source: str) -> Reference:
    """The publication that a component names: by its key, or a whole reference as text."""
    return known_references().get(source) or Reference("", (), {"note": source})


_NAME_WIDTH: Final = 18
_MAX_COMPONENTS: Final = 6
"""Largest number of components of a list that are named."""


def listed(name_: str | None, requests: Mapping[str, str]) -> list[dict[str, Any]]:
    """Descriptions of all components, of those of a kind, or of one by its name, as plain values.

    `requests` holds places ``module:Class`` of what else can be listed by name, such as the settings of a whole run.
    """
    if name_ is not None and name_ in requests:
        return [described(loaded(requests[name_]))]
    kinds = catalogues()
    names = [(kind, name) for kind, components in kinds.items() for name in components.names()]
    if name_ is not None:
        every = [name for _, name in names]
        of_kind = [(kind, name) for kind, name in names if kind == name_.removesuffix("s")]
        names = of_kind or [(kind, name) for kind, name in names if name == name_]
        if not names:
            known = known_names(name_, every, where=f"the kinds are: {', '.join((*kinds, *requests))}")
            raise Refusal(f"there is no component and no kind of components {name_!r}; {known}")
    return [described(kinds[kind].find(name)) for kind, name in names]


def described(component: type[Component]) -> dict[str, Any]:
    """A component as plain values."""
    settings = (setting for setting in component.settings().values() if setting.name not in component.refused)
    return {
        "kind": component.kind,
        "name": component.name,
        "summary": component.summary,
        **component.facts(),
        "settings": [_setting(component, setting) for setting in settings],
        "sources": [reference(source).text for source in component.sources],
    }


def _setting(component: type[Component], setting: Setting) -> dict[str, Any]:
    defaults: dict[str, Any] = {"": setting.default.noise_free}
    if setting.is_component:
        components = setting.default.noise_free
        components = [components] if isinstance(components, Request | Component) else components or ()
        named = [component_text(component.tree()) for component in components]
        more = f"; and {len(named) - _MAX_COMPONENTS} more" if len(named) > _MAX_COMPONENTS else ""
        defaults = {"": "; ".join(named[:_MAX_COMPONENTS]) + more} if named else {}
    if setting.default.noisy is not None:
        defaults["with noise"] = setting.default.noisy
    subcutaneous = component.defaults_of_route(SUBCUTANEOUS)
    if setting.name in subcutaneous:
        defaults["under the skin"] = subcutaneous[setting.name]
    return {
        "name": setting.name,
        "summary": setting.summary,
        "possible": setting.possible,
        "unit": "" if setting.is_component else setting.unit,
        "default": defaults,
    }


def listing(components: list[dict[str, Any]], width: int = 100) -> str:
    """Descriptions as text: a line for each of several components, or everything about one, or those of one name."""
    if len({component["name"] for component in components}) == 1:
        wholes = (
            "\n".join(line for text, indent in _whole(component) for line in _wrapped(text, indent, width))
            for component in components
        )
        return "\n\n".join(wholes)
    lines: list[str] = []
    kind = ""
    for component in components:
        if component["kind"] != kind:
            kind = component["kind"]
            lines += ["", f"{kind.capitalize()}s"] if lines else [f"{kind.capitalize()}s"]
        lines += _wrapped(f"  {component['name']:<{_NAME_WIDTH}} {component['summary']}", _NAME_WIDTH + 3, width)
    return "\n".join(lines)


def _whole(component: dict[str, Any]) -> Iterator[tuple[str, int]]:
    """Paragraphs on a component, and the indent of their further lines."""
    yield f"{component['kind']} {component['name']}".strip() + f": {component['summary']}", 2
    for key, what in (("operating_points", "Operating point"), ("populations", "Population")):
        for name, summary in component.get(key, {}).items():
            yield f"  {what} {name}: {summary}", 4
    if "insulin_route" in component:
        yield f"  Route of insulin: {component['insulin_route']}", 4
        yield f"  By default: {', '.join(f'{name} {value:g}' for name, value in component['default'].items())}", 4
    for setting in component["settings"]:
        defaults = ", ".join(f"{where} {_text(value)}".strip() for where, value in setting["default"].items())
        yield f"  {setting['name']}{f' = {defaults}' if defaults else ''}   ({setting['possible']})", 6
        yield f"      {setting['summary']}", 6
    for source in component["sources"]:
        yield f"  Source: {source}", 4


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(value_text, value)) or "none"
    return "not given" if value is None else f'"{value}"' if value == "" else value_text(value)


def _wrapped(text: str, indent: int, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent=" " * indent, break_on_hyphens=False)
