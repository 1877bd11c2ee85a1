"""Notes on settings that were given and change nothing, since no part of the request uses them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from glucoloop.component.base import Component
from glucoloop.component.effects import BOLUSES, OF_CONTROLLERS, Need
from glucoloop.component.request import Request, completed, request_of
from glucoloop.component.setting import Setting
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.refusal import Refusal

_MAX_NAMED = 8
"""Most other controllers that a note names."""


def without_effect(
    request: Component,
    named: Callable[[Setting], str] = lambda setting: setting.name,
    uses: frozenset[Need] | None = None,
) -> tuple[str, ...]:
    """Notes on the settings of a complete request that were given, are not as by default, and have no effect.

    `named` is the name of a setting for the user, such as its option. `uses` takes the place of what the request uses,
    where something else acts in place of its controllers.
    """
    all_uses = request.uses() if uses is None else uses
    cases = () if uses is not None or "controller" in request.refused else getattr(request, "cases", ())
    controllers = list(dict.fromkeys(request_of(case).value("controller").display_name for case in cases))
    notes = (
        f"{name} has {need.effect}: {reason(need, controllers)}." for name, need in _unused(request, all_uses, named)
    )
    return tuple(dict.fromkeys(notes))


def _unused(
    component: Component, uses: frozenset[Need], named: Callable[[Setting], str] | None = None
) -> Iterator[tuple[str, Need]]:
    """Names of explicit settings without effect, or of components without effect among them, with what each lacks."""
    for name, value in component.explicit.items():
        setting = type(component).settings()[name]
        lacking = _first_lacking(setting.about.needs, uses)
        if lacking is not None and value != setting.default.noise_free:
            yield named(setting) if named is not None else f"{name} of the {_called(component)}", lacking
            continue
        for inner in _components(value, getattr(component, "cases", ()) if name == "controller" else ()):
            lacking = _first_lacking(inner.needs(), uses)
            if lacking is not None:
                yield f"The {_called(inner)}", lacking
            else:
                yield from _unused(inner, uses | inner.uses())


def _components(value: Any, cases: Iterable[Any]) -> Iterator[Component]:
    """Components of an explicit setting, or the cases of them where there are some, complete.

    A request that the defaults of its class do not complete is left out.
    """
    for item in cases or (value if isinstance(value, tuple | list) else (value,)):
        if isinstance(item, Component):
            yield item
        elif isinstance(item, Request):
            with contextlib.suppress(Refusal):
                yield completed(item)


def _first_lacking(needs: tuple[Need, ...], uses: frozenset[Need]) -> Need | None:
    return next((need for need in needs if need not in uses), None)


def _called(component: Component) -> str:
    return f"{component.kind} {component.display_name}".rstrip()


def reason(need: Need, controllers: list[str]) -> str:
    """Clause on why a need is not met, with the controllers that do not meet it."""
    if need not in OF_CONTROLLERS or not controllers:
        return need.reason
    several = len(controllers) > 1
    who = f"the controller{'s' if several else ''} {_listed(controllers)} {'do' if several else 'does'} not"
    what = f"give {need.noun}" if need is BOLUSES else f"use {need.noun}"
    others = [name for name, component in CONTROLLERS.items() if need in component().uses()]
    known = f"; {_listed(others)} do" if 0 < len(others) <= _MAX_NAMED else "; the others do" if others else ""
    return f"{who} {what}{known}"


def _listed(names: list[Any]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
