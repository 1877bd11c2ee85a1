"""Descriptions of every part with its settings, from the declarations alone."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, Final

from glucoloop.parts.catalogue import catalogues
from glucoloop.parts.code import loaded
from glucoloop.parts.controllers import ControllerPart
from glucoloop.parts.guard import OF_ROUTE, GuardSettings
from glucoloop.parts.patients import NOMINAL, PatientPart
from glucoloop.parts.routes import ROUTES, SUBCUTANEOUS
from glucoloop.parts.setting import Setting, in_words, known_names, value_text
from glucoloop.refusal import Refusal

PATIENT: Final = "patient"
_NAME_WIDTH: Final = 18
_SKIN: Final = "under the skin"


def listed(asked: str | None, requests: Mapping[str, str]) -> list[dict[str, Any]]:
    """Descriptions of all parts, of those of a kind, or of one by its name, as plain values.

    Parameters
    ----------
    asked : str, optional
    requests : mapping
        Places ``module:Class`` of what else can be listed by name, such as the settings of a whole run.

    Raises
    ------
    Refusal
        For a name that is neither a kind nor a part, or code that cannot be imported.
    """
    kinds = catalogues()
    if asked is None:
        return [described(of.find(name)) for of in kinds.values() for name in of.names()]
    kind = asked.removesuffix("s")
    if kind in kinds:
        return [described(kinds[kind].find(name)) for name in kinds[kind].names()]
    if asked in requests:
        return [described(loaded(requests[asked]))]
    found = [described(of.find(asked)) for of in kinds.values() if asked in of.names()]
    if not found:
        names = [name for of in kinds.values() for name in of.names()]
        told = known_names(asked, names, where=f"the kinds are: {', '.join((*kinds, *requests))}")
        raise Refusal(f"there is no part and no kind of parts {asked!r}; {told}")
    return found


def described(part: Any) -> dict[str, Any]:
    """A part as plain values."""
    settings = [_setting(part, setting) for setting in part.settings().values() if setting.name not in part.refused]
    own = _of_patient(part) if issubclass(part, PatientPart) else {}
    return {"kind": part.kind, "name": part.name, "summary": part.summary, **own, "settings": settings}


def _setting(part: Any, setting: Setting) -> dict[str, Any]:
    kind: Any = setting.kind
    possible = (in_words(setting.choices) if setting.choices else "") or {bool: "true or false", str: "a text"}.get(
        kind
    )
    if setting.is_part:
        return {
            "name": setting.name,
            "summary": setting.summary,
            "possible": f"{'parts' if setting.many else 'a part'} of the kind {kind.kind}",
            "unit": "",
            "usual": {},
        }
    usual: dict[str, Any] = {"": setting.default.noise_free}
    if setting.default.noisy is not None:
        usual["with noise"] = setting.default.noisy
    if issubclass(part, ControllerPart):
        own = ROUTES[SUBCUTANEOUS].tunings.get(part.name, {})
        usual |= {_SKIN: own[setting.name].noise_free} if setting.name in own else {}
    if issubclass(part, GuardSettings) and setting.name in OF_ROUTE[SUBCUTANEOUS]:
        usual[_SKIN] = OF_ROUTE[SUBCUTANEOUS][setting.name]
    return {
        "name": setting.name,
        "summary": setting.summary,
        "possible": possible or (setting.about.possible(kind, setting.unit) if kind in (int, float) else "a text"),
        "unit": setting.unit,
        "usual": usual,
    }


def _of_patient(entry: type[PatientPart]) -> dict[str, Any]:
    """Points, populations, pump and identification of a patient."""
    return {
        "insulin_route": entry.insulin_route,
        "operating_points": {point.name: point.summary for point in entry.operating_points},
        "populations": {NOMINAL: "the nominal patient, whoever is drawn", **entry.populations},
        "usual": {
            name: getattr(entry, name)
            for name in (
                "max_change_mU_min",
                "min_insulin_mU_min",
                "max_insulin_mU_min",
                "pulse_mU_min",
                "memory_min",
                "laguerre_pole",
                "laguerre_functions",
            )
        },
    }


def listing(parts: list[dict[str, Any]], width: int = 100) -> str:
    """Descriptions as text: a line for each of several parts, or everything about one."""
    if len(parts) == 1:
        return "\n".join(_whole(parts[0], width))
    lines: list[str] = []
    kind = ""
    for part in parts:
        if part["kind"] != kind:
            kind = part["kind"]
            lines += ["", f"{kind.capitalize()}s"] if lines else [f"{kind.capitalize()}s"]
        lines += _wrapped(f"  {part['name']:<{_NAME_WIDTH}} {part['summary']}", " " * (_NAME_WIDTH + 3), width)
    return "\n".join(lines)


def _whole(part: dict[str, Any], width: int) -> Iterator[str]:
    yield from _wrapped(f"{part['kind']} {part['name']}".strip() + f": {part['summary']}", "  ", width)
    for key, what in (("operating_points", "Operating point"), ("populations", "Population")):
        for name, summary in part.get(key, {}).items():
            yield from _wrapped(f"  {what} {name}: {summary}", "    ", width)
    if part["kind"] == PATIENT:
        usual = part["usual"]
        yield f"  Route of insulin: {part['insulin_route']}"
        yield from _wrapped(
            f"  Usual pump: {usual['min_insulin_mU_min']:g} to {usual['max_insulin_mU_min']:g} mU/min, changed by at "
            f"most {usual['max_change_mU_min']:g} mU/min from one sample to the next",
            "    ",
            width,
        )
        yield from _wrapped(
            f"  Usual identification: pulses of {usual['pulse_mU_min']:g} mU/min, a memory of "
            f"{usual['memory_min']:g} min, {usual['laguerre_functions']} Laguerre functions with a pole of "
            f"{usual['laguerre_pole']:g} at 5-min samples",
            "    ",
            width,
        )
    for setting in part.get("settings", ()):
        usual = ", ".join(f"{where} {_text(value)}".strip() for where, value in setting["usual"].items())
        told = f"  {setting['name']}{f' = {usual}' if usual else ''}   ({setting['possible']})"
        yield from _wrapped(told, " " * 6, width)
        yield from _wrapped(f"      {setting['summary']}", " " * 6, width)


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(value_text, value)) or "none"
    return "not given" if value is None else f'"{value}"' if value == "" else value_text(value)


def _wrapped(text: str, indent: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent=indent, break_on_hyphens=False, drop_whitespace=True)
