"""Safety file: hazards of a controller that is carried on, measures against each, how they were shown, what is left.

The hazards and requirements are in ``hazards.toml``. The documentation shows all of them, and an exported controller
gets the part that concerns it. It is no assessment of safety, and nothing here is a medical device.
"""

from __future__ import annotations

import importlib.resources
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from glucoloop import __version__
from glucoloop.firmware.checks import BOUNDS, CHANGE, MISRA
from glucoloop.firmware.chips import template
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.folder import OUTCOMES

_EVERY, _GUARD, _C = "every controller", "the guard", "the exported C"
WHERE: Final = {
    _EVERY: "any controller of the catalogue, bare or guarded, in Python and in C",
    _GUARD: "a controller in a guard with the default settings, in Python and in C",
    _C: "the C that `glucoloop export` writes",
    "the link": "the firmware and the protocol of `glucoloop hil`",
    "real time": "the functions for a loop in real time, in Python",
    "the program": "the program with which a controller is designed and simulated",
}
"""Place where a requirement holds, in words."""
CAUSES: Final = {
    "sensor": "Sensor",
    "pump": "Pump",
    "line": "Line of infusion and of messages",
    "clock": "Clock",
    "memory": "Memory",
    "software": "Software",
    "use": "Use",
}
DELIVERY: Final = {"over": "over-delivery", "under": "under-delivery", "both": "over- or under-delivery"}
CHECKS: Final = {
    "bounds": BOUNDS,
    "change": CHANGE,
    "misra": MISRA,
    "emulated": "C on an emulated chip",
    "samples": "samples equal to the bit, on this computer",
}
"""Checks of an export; the last two stand for all that compare samples on a chip, or here."""


@dataclass(frozen=True, kw_only=True)
class _Requirement:
    """Measure against hazards, with the tests and checks that fail where it does not hold."""

    name: str
    of: str
    text: str
    tests: tuple[str, ...]
    checks: tuple[str, ...] = ()
    evidence: tuple[str, ...] = ()
    """Pages with what was measured."""
    command: str = ""
    """Command that measures it again."""


@dataclass(frozen=True, kw_only=True)
class _Hazard:
    """Cause of too much or too little insulin, the measures against it, and what is left."""

    name: str
    cause: str
    delivery: str
    what: str
    measures: tuple[str, ...]
    """Names of the requirements that act against it."""
    residual_risk: str
    boluses: bool = False
    """Whether it concerns only a controller that gives boluses."""
    bare: bool = False
    """Whether it concerns only a controller without a guard."""
    evidence: tuple[str, ...] = ()
    """Pages with what was measured of it."""

    def concerns(self, *, guarded: bool, boluses: bool) -> bool:
        """Whether it concerns a controller, with a guard or without, that gives boluses or none."""
        return (boluses or not self.boluses) and not (guarded and self.bare)


@dataclass(frozen=True)
class SafetyFile:
    """All hazards and requirements, by name."""

    hazards: Mapping[str, _Hazard]
    requirements: Mapping[str, _Requirement]

    @classmethod
    def read(cls) -> SafetyFile:
        """Read the safety file of this version."""
        data = (importlib.resources.files("glucoloop.firmware") / "hazards.toml").read_text(encoding="utf-8")
        tables = tomllib.loads(data)
        hazards = [_Hazard(**_tuples(table)) for table in tables["hazard"]]
        requirements = [_Requirement(**_tuples(table)) for table in tables["requirement"]]
        return cls(_by_name(hazards), _by_name(requirements))

    def of_cause(self, cause: str) -> list[_Hazard]:
        """Hazards of a cause."""
        return [hazard for hazard in self.hazards.values() if hazard.cause == cause]

    def lessened_by(self, requirement: _Requirement) -> list[_Hazard]:
        """Hazards against which a requirement is a measure."""
        return [hazard for hazard in self.hazards.values() if requirement.name in hazard.measures]


def _tuples(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}


def _by_name(entries: Sequence[Any]) -> dict[str, Any]:
    named = {entry.name: entry for entry in entries}
    if len(named) < len(entries):
        raise ValueError("two hazards or two requirements have one name")
    return named


def safety_report(exported: Exported, name: str, checks: Sequence[Mapping[str, Any]], *, guarded: bool) -> str:
    """Part of the safety file that concerns an exported controller, with the outcome of the checks of its folder."""
    file, boluses = SafetyFile.read(), exported.gives_boluses
    here = {_EVERY, _C, *([_GUARD] if guarded else [])}
    concern = [hazard for hazard in file.hazards.values() if hazard.concerns(guarded=guarded, boluses=boluses)]
    needed = {name for hazard in concern for name in hazard.measures}
    requirements = [requirement for requirement in file.requirements.values() if requirement.name in needed]
    inside = {requirement.name: requirement for requirement in requirements if requirement.of in here}
    outside = [requirement for requirement in requirements if requirement.of not in here]
    parts = []
    for cause, title in CAUSES.items():
        texts = [_hazard_text(hazard, inside) for hazard in concern if hazard.cause == cause]
        parts += [f"### {title}", *texts] if texts else []
    return template("SAFETY.md").format(
        name=name,
        design=exported.source.design,
        form=exported.source.form,
        precision=exported.precision,
        version=__version__,
        guard="It has its guard." if guarded else "It has no guard, so the measures of the guard are not here.",
        boluses="It gives boluses." if boluses else "It gives no boluses, so hazards of boluses are left out.",
        glucagon=" It gives glucagon too, whose hazards are not in this file." if exported.gives_glucagon else "",
        hazards="\n\n".join(parts),
        unmet="\n".join(f"- {hazard.what}" for hazard in concern if not inside.keys() & {*hazard.measures}) or "- none",
        requirements="\n".join(_requirement_text(requirement, checks) for requirement in inside.values()),
        outside="\n".join(f"- `{each.name}` ({WHERE[each.of]}): {each.text}" for each in outside) or "- nothing",
    )


def _hazard_text(hazard: _Hazard, inside: Collection[str]) -> str:
    here = [f"`{name}`" for name in hazard.measures if name in inside]
    others = [f"`{name}`" for name in hazard.measures if name not in inside]
    lines = [f"**{hazard.what}** ({DELIVERY[hazard.delivery]})", ""]
    lines.append(f"- Measures here: {', '.join(here)}." if here else "- There is no measure against it in this folder.")
    lines += [f"- Measures outside this folder: {', '.join(others)}."] if others else []
    return "\n".join([*lines, f"- Left: {hazard.residual_risk}"])


def _kind_of(check: str) -> str:
    """Name among `CHECKS` of a check of an export."""
    named = {text: name for name, text in CHECKS.items()}
    return named.get(check) or ("emulated" if check.startswith("C on an emulated") else "samples")


def _requirement_text(requirement: _Requirement, checks: Sequence[Mapping[str, Any]]) -> str:
    lines = [f"**{requirement.name}**. {requirement.text}", ""]
    for kind in requirement.checks:
        those = [check for check in checks if _kind_of(check["check"]) == kind]
        lines += [f"- For this folder, {OUTCOMES[check['holds']]}: {check['check']}" for check in those]
        lines += [] if those else [f"- For this folder, {OUTCOMES[None]}: {CHECKS[kind]}"]
    lines += [f"- Test of glucoloop: `{test}`" for test in requirement.tests]
    return "\n".join([*lines, ""])
