"""Tables of the safety file, and the check that whatever it names exists.

    python docs/safety.py

It prints what is named and does not exist, and leaves with 1 then. ``generate.py`` takes the tables for ``safety/``.
"""

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

from glucoloop.cli import app
from glucoloop.firmware.safety import CAUSES, CHECKS, DELIVERY, WHERE, SafetyFile
from glucoloop.refusal import Refusal

ROOT = Path(__file__).resolve().parent.parent


def hazards(file: SafetyFile) -> str:
    """Hazards by cause, each with its measures, the pages that show it, and what is left."""
    parts = []
    for cause, title in CAUSES.items():
        parts.append(f"## {title}")
        for hazard in file.of_cause(cause):
            measures = ", ".join(f"[{name}](requirements.md#{name})" for name in hazard.measures) or "none"
            lines = [f"**{hazard.what}** ({DELIVERY[hazard.delivery]})", "", f"- Measures: {measures}."]
            lines += [f"- Measured: {', '.join(map(link, hazard.evidence))}."] if hazard.evidence else []
            parts.append("\n".join([*lines, f"- Left: {hazard.residual_risk}"]))
    return "\n\n".join(parts) + "\n"


def requirements(file: SafetyFile) -> str:
    """Requirements by the place where they hold, each with its tests, checks, pages and command."""
    parts = []
    for place, words in WHERE.items():
        parts += [f"## {place.capitalize() if place[0].islower() else place}", f"These hold for {words}."]
        for one in file.requirements.values():
            if one.of != place:
                continue
            against = "; ".join(hazard.what.rstrip(".") for hazard in file.lessened_by(one))
            lines = [f"### {one.name}", "", one.text, "", f"- Against: {against}."]
            lines += [f"- Test: `{test}`" for test in one.tests]
            lines += [f"- Check of an export: {CHECKS[check]}." for check in one.checks]
            lines += [f"- Measured: {', '.join(map(link, one.evidence))}."] if one.evidence else []
            lines += [f"- Again: `{one.command}`"] if one.command else []
            parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def link(page: str) -> str:
    """Link from a page of ``docs/safety`` to one of the documentation; a table links to the page that includes it."""
    name = page.removeprefix("docs/guide/")
    holding = [
        other for other in sorted((ROOT / "docs/guide").glob("*.md")) if f"```{{include}} {name}\n" in _text(other)
    ]
    target = holding[0].name if holding else name
    return f"[{target.removesuffix('.md')}](../guide/{target})"


def problems(file: SafetyFile, root: Path = ROOT) -> Iterator[str]:
    """Sentences on what the safety file names and does not exist, or leaves out."""
    for hazard in file.hazards.values():
        place = f"the hazard {hazard.name}"
        yield from _unknown(place, "cause", [hazard.cause], CAUSES)
        yield from _unknown(place, "delivery", [hazard.delivery], DELIVERY)
        yield from _unknown(place, "measure", hazard.measures, file.requirements)
        yield from _no_files(place, hazard.evidence, root)
        if not hazard.residual_risk:
            yield f"{place} does not say what is left"
    for requirement in file.requirements.values():
        place = f"the requirement {requirement.name}"
        yield from _unknown(place, "place", [requirement.of], WHERE)
        yield from _unknown(place, "check", requirement.checks, CHECKS)
        yield from _no_files(place, requirement.evidence, root)
        yield from (f"{place} names {test}, which is no test" for test in requirement.tests if not _is_test(test, root))
        if requirement.command and not _is_command(requirement.command, root):
            yield f"{place} names {requirement.command!r}, which is no command"
        if not requirement.tests:
            yield f"{place} has no test"
        if not file.lessened_by(requirement):
            yield f"{place} is a measure against no hazard"
    yield from (f"there is no hazard by the cause {cause}" for cause in CAUSES if not file.of_cause(cause))


def _unknown(place: str, kind: str, names, known) -> Iterator[str]:
    yield from (
        f"{place} has the {kind} {name!r}; the known ones are {', '.join(known)}" for name in names if name not in known
    )


def _no_files(place: str, names, root: Path) -> Iterator[str]:
    yield from (f"{place} names {name}, which is no file" for name in names if not (root / name).is_file())


def _is_test(name: str, root: Path) -> bool:
    """Whether there is a test function of that name in a file under tests/, named once."""
    path, _, function = name.partition("::")
    place = root / path
    if not (path.startswith("tests/") and function.startswith("test_") and place.is_file()):
        return False
    return len(re.findall(rf"^def {re.escape(function)}\(", _text(place), re.M)) == 1


def _is_command(line: str, root: Path) -> bool:
    """Whether a line calls a script of the repository, or a command of the program with options that it has."""
    program, what, *words = shlex.split(line)
    if program == "python":
        return (root / what).is_file()
    try:
        app.command_of(what).given(words)
    except Refusal:
        return False
    return program == "glucoloop"


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


if __name__ == "__main__":
    found = list(problems(SafetyFile.read()))
    print("\n".join(found) or "Everything that the safety file names exists.")
    sys.exit(1 if found else 0)
