"""Descriptions of every component with its settings, from the declarations alone."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import catalogues
from glucoloop.component.code import loaded
from glucoloop.component.grammar import component_text
from glucoloop.component.references import reference
from glucoloop.component.request import Request
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.component.setting import Setting, known_names, value_text
from glucoloop.refusal import Refusal

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
