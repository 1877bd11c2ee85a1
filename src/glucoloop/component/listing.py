"""Descriptions of every part with its settings, from the declarations alone."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import catalogues
from glucoloop.component.code import loaded
from glucoloop.component.grammar import part_text
from glucoloop.component.references import reference
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.component.setting import Setting, choices_text, known_names, value_text
from glucoloop.refusal import Refusal

_NAME_WIDTH: Final = 18
_MAX_PARTS: Final = 6
"""Largest number of parts of a list that are named."""


def listed(name_: str | None, requests: Mapping[str, str]) -> list[dict[str, Any]]:
    """Descriptions of all parts, of those of a kind, or of one by its name, as plain values.

    `requests` holds places ``module:Class`` of what else can be listed by name, such as the settings of a whole run.
    """
    if name_ is not None and name_ in requests:
        return [described(loaded(requests[name_]))]
    kinds = catalogues()
    names = [(kind, name) for kind, parts in kinds.items() for name in parts.names()]
    if name_ is not None:
        every = [name for _, name in names]
        of_kind = [(kind, name) for kind, name in names if kind == name_.removesuffix("s")]
        names = of_kind or [(kind, name) for kind, name in names if name == name_]
        if not names:
            known = known_names(name_, every, where=f"the kinds are: {', '.join((*kinds, *requests))}")
            raise Refusal(f"there is no part and no kind of parts {name_!r}; {known}")
    return [described(kinds[kind].find(name)) for kind, name in names]


def described(part: type[Component]) -> dict[str, Any]:
    """A part as plain values."""
    settings = (setting for setting in part.settings().values() if setting.name not in part.refused)
    return {
        "kind": part.kind,
        "name": part.name,
        "summary": part.summary,
        **part.facts(),
        "settings": [_setting(part, setting) for setting in settings],
        "sources": [reference(source).text for source in part.sources],
    }


def _setting(part: type[Component], setting: Setting) -> dict[str, Any]:
    usual: dict[str, Any] = {"": setting.default.noise_free}
    if setting.is_part:
        parts = setting.default.noise_free
        parts = [parts] if isinstance(parts, Component) else parts or ()
        named = [part_text(part.tree()) for part in parts]
        more = f"; and {len(named) - _MAX_PARTS} more" if len(named) > _MAX_PARTS else ""
        usual = {"": "; ".join(named[:_MAX_PARTS]) + more} if named else {}
        possible = f"{'parts' if setting.many else 'a part'} of the kind {setting.kind.kind}"
    elif setting.choices:
        possible = choices_text(setting.choices)
    elif setting.kind in (int, float):
        possible = setting.possible
    else:
        possible = "true or false" if setting.kind is bool else "a text"
    if setting.default.noisy is not None:
        usual["with noise"] = setting.default.noisy
    subcutaneous = part.defaults_of_route(SUBCUTANEOUS)
    if setting.name in subcutaneous:
        usual["under the skin"] = subcutaneous[setting.name]
    return {
        "name": setting.name,
        "summary": setting.summary,
        "possible": possible,
        "unit": "" if setting.is_part else setting.unit,
        "usual": usual,
    }


def listing(parts: list[dict[str, Any]], width: int = 100) -> str:
    """Descriptions as text: a line for each of several parts, or everything about one."""
    if len(parts) == 1:
        return "\n".join(line for text, indent in _whole(parts[0]) for line in _wrapped(text, indent, width))
    lines: list[str] = []
    kind = ""
    for part in parts:
        if part["kind"] != kind:
            kind = part["kind"]
            lines += ["", f"{kind.capitalize()}s"] if lines else [f"{kind.capitalize()}s"]
        lines += _wrapped(f"  {part['name']:<{_NAME_WIDTH}} {part['summary']}", _NAME_WIDTH + 3, width)
    return "\n".join(lines)


def _whole(part: dict[str, Any]) -> Iterator[tuple[str, int]]:
    """Paragraphs on a part, and the indent of their further lines."""
    yield f"{part['kind']} {part['name']}".strip() + f": {part['summary']}", 2
    for key, what in (("operating_points", "Operating point"), ("populations", "Population")):
        for name, summary in part.get(key, {}).items():
            yield f"  {what} {name}: {summary}", 4
    if "insulin_route" in part:
        yield f"  Route of insulin: {part['insulin_route']}", 4
        yield f"  Usual: {', '.join(f'{name} {value:g}' for name, value in part['usual'].items())}", 4
    for setting in part["settings"]:
        usual = ", ".join(f"{where} {_text(value)}".strip() for where, value in setting["usual"].items())
        yield f"  {setting['name']}{f' = {usual}' if usual else ''}   ({setting['possible']})", 6
        yield f"      {setting['summary']}", 6
    for source in part["sources"]:
        yield f"  Source: {source}", 4


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(value_text, value)) or "none"
    return "not given" if value is None else f'"{value}"' if value == "" else value_text(value)


def _wrapped(text: str, indent: int, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent=" " * indent, break_on_hyphens=False)
