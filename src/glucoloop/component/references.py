"""Publications that components name, as text and as BibTeX."""

from __future__ import annotations

import functools
import itertools
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

from glucoloop.component.base import Component
from glucoloop.component.request import Request

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
