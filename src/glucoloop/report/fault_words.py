"""Descriptions of faults: a short unique name, the settings, and the times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from glucoloop.parts.faults import DURATION, FAULTS, LATEST, PER_DAY, START, FaultPart
from glucoloop.parts.setting import Value

# The longest first: what a name ends in.
_UNITS: Final = {
    "mg_dl_h": "mg/dl/h",
    "mg_dl_U": "mg/dl/U",
    "g_U": "g/U",
    "mU_min": "mU/min",
    "mg_dl": "mg/dl",
    "min": "min",
}
# What changes nothing, if it is not 0.
_NEUTRAL: Final = {"gain": 1.0}
_TIMES: Final = (START, LATEST, DURATION, PER_DAY)


def short_names(faults: Sequence[str]) -> dict[str, str]:
    """Short name of each fault: its kind, and the settings that distinguish it from others of its kind.

    Settings that are the same for all faults of a kind are left out, and so are settings without effect. Two faults
    never have the same name: if necessary it is the full text of the fault.
    """
    parsed = {fault: FAULTS.choose(fault) for fault in faults}
    names = {fault: _short_name(of, [f for f in parsed.values() if f.name == of.name]) for fault, of in parsed.items()}
    taken = list(names.values())
    return {fault: fault if taken.count(name) > 1 else name for fault, name in names.items()}


def _short_name(fault: FaultPart, kind: Sequence[FaultPart]) -> str:
    keys = [key for key in fault.settings() if len({_comparable(of.values().get(key)) for of in kind}) > 1]
    # what it is comes before when it is
    own = [key for key in keys if key not in _TIMES]
    chosen = own if _tell_apart(own, kind) else _tell_apart_with_time(own, kind) or keys
    values = {key: fault.values()[key] for key in chosen if key in fault.values()}
    matter = {key: value for key, value in values.items() if isinstance(value, bool) or value != _NEUTRAL.get(key, 0.0)}
    told = ", ".join(setting_in_words(key, value) for key, value in (matter or values).items())
    return f"{fault.name} {told}" if told else fault.name


def _tell_apart(keys: Sequence[str], kind: Sequence[FaultPart]) -> bool:
    return len({tuple(_comparable(of.values().get(key)) for key in keys) for of in kind}) == len(kind)


def _tell_apart_with_time(own: Sequence[str], kind: Sequence[FaultPart]) -> list[str]:
    """Names with one time added, if that makes them unique; the duration is preferred to the start."""
    for key in (DURATION, PER_DAY, START, LATEST):
        if _tell_apart([*own, key], kind):
            return [*own, key]
    return []


def _comparable(value: Value | None) -> str:
    # as text, since what is not a number is not equal to itself
    return repr(value)


def setting_in_words(key: str, value: Value) -> str:
    """A setting with its unit: ``size 60 mg/dl``, ``not noticed``."""
    name, unit = _name_and_unit(key)
    if isinstance(value, bool):
        return name if value else f"not {name}"
    number = value if isinstance(value, str) else f"{value:g}"
    told = {DURATION: "", PER_DAY: "", START: "from", LATEST: "up to"}.get(key, name)
    return " ".join(part for part in (told, number, "a day" if key == PER_DAY else unit) if part)


def _name_and_unit(key: str) -> tuple[str, str]:
    for end, unit in _UNITS.items():
        if key == end or key.endswith(f"_{end}"):
            return key.removesuffix(end).rstrip("_").replace("_", " "), unit
    return key.replace("_", " "), ""


def settings_in_words(fault: FaultPart) -> str:
    """Settings of a fault apart from its times; empty if it has none."""
    return ", ".join(setting_in_words(key, value) for key, value in fault.values().items() if key not in _TIMES)


def when_in_words(fault: FaultPart) -> str:
    """Times of a fault, in a phrase."""
    when = fault.values()
    if not fault.timed:
        return "at random, at any time" if fault.comes_and_goes else "always"
    if PER_DAY in when:
        lasting = f"for {_number(when, DURATION)} min" if DURATION in when else "for one sample"
        return f"at random, {_number(when, PER_DAY)} times a day, {lasting}"
    if not any(key in when for key in _TIMES):
        return "always"
    start = _number(when, START) if START in when else "0"
    latest = _number(when, LATEST) if LATEST in when else start
    begins = f"from {start} min" if latest == start else f"from a moment between {start} and {latest} min"
    return f"{begins}, for {_number(when, DURATION)} min" if DURATION in when else f"{begins} to the end"


def window_of(fault: FaultPart, end_min: float) -> tuple[float, float] | None:
    """Time within which a fault is present, by its settings; None if it comes at random at any time."""
    when = fault.values()
    if not fault.timed or PER_DAY in when:
        return None
    start = float(when.get(START, 0.0))
    latest = float(when.get(LATEST, start))
    stop = min(end_min, latest + float(when.get(DURATION, end_min)))
    return (start, stop) if start < end_min else None


def _number(when: Mapping[str, Value], key: str) -> str:
    value = float(when[key])
    return f"{value:g}" if math.isfinite(value) else str(value)
