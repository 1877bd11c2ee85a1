"""A campaign or a nonsense test carried out, in tables and sentences."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.parts.patients import PATIENTS, USUAL_PATIENT
from glucoloop.printable import how_many
from glucoloop.report.columns import Column, FittingTable, Line, decimals, terminal_table, whole
from glucoloop.report.descriptions import engine_notes
from glucoloop.situations.case import Case
from glucoloop.situations.run import ControlledSituation
from glucoloop.situations.warnings import boluses_into_a_vein
from glucoloop.storage.findings import Findings
from glucoloop.studies.verification import Verification, campaign, nonsense
from glucoloop.studies.verification.campaign import Campaign, met
from glucoloop.studies.verification.nonsense import NonsenseCheck
from glucoloop.studies.verification.result import Guarding

_LISTED: Final = 10


def notes(asked: Verification) -> tuple[str, ...]:
    """Sentence on boluses into a vein, where controllers were chosen; what is impossible is refused before it."""
    asked.definition()
    if asked.nonsense is not None or not asked.controllers:
        return ()
    chosen = tuple(Case(controller=CONTROLLERS.find(name).partial({})) for name in asked.controllers)
    return boluses_into_a_vein(ControlledSituation(patient=PATIENTS.find(asked.patient).partial({}), controller=chosen))


def amount(request: Verification) -> int:
    """Number of loops that will be closed."""
    asked = request.definition()
    if isinstance(asked, NonsenseCheck):
        return asked.loops * len(asked.controllers)
    return 2 * sum(asked.pairs().values())


def found(request: Verification, progress: Callable[[int], None]) -> Findings:
    """Close the loops, and count in how many each promise was broken."""
    asked = request.definition()
    began = time.monotonic()
    result: Any = (
        nonsense.run_nonsense(asked, progress)
        if isinstance(asked, NonsenseCheck)
        else campaign.run_campaign(asked, progress)
    )
    plain = {
        "seed": result.seed,
        "loops": sum(arm.loops for arm in result.arms),
        "samples": result.samples,
        "seconds": time.monotonic() - began,
        "interrupted": result.interrupted,
        "holds": result.holds,
        "violations": result.violations,
        "arms": [dataclasses.asdict(arm) for arm in result.arms],
    }
    if isinstance(asked, Campaign):
        for arm in plain["arms"]:
            for broken in arm["told"]:
                broken["repeat"] = _repeat(asked, arm["controller"], broken["person"])
        plain["guarding"] = [dataclasses.asdict(of) for of in result.guarding]
        if asked.person is not None:
            meets = {name: met(name, asked.seed, asked.person, asked.patient) for name in asked.controllers}
            plain["meets"] = {name: dataclasses.asdict(of) for name, of in meets.items()}
    return Findings(plain)


_ARM_COLUMNS: Final = (
    Column(name="engine", short="Engine", text=str, left=True),
    Column(name="loops", short="ControlledSituation", text=whole),
    Column(name="samples", short="Samples", text=whole),
    Column(name="all_broken", short="Broken", text=whole),
    Column(name="below_60_pct", short="Below 60, %", text=decimals(2), only=lambda row: "below_60_pct" in row),
    *(
        Column(name=name, short=short, text=text, only=lambda row: "better" in row)
        for name, short, text in (
            ("better", "Better", whole),
            ("worse", "Worse", whole),
            ("worst_pct", "Most, %", "{:+.1f}".format),
        )
    ),
    Column(name="worst_person", short="Person", text=whole, only=lambda row: row.get("worst_pct", 0.0) > 0.0),
)


def tables(asked: Verification, found: Findings) -> Iterator[FittingTable]:
    """Number of loops that broke each promise, and the loops of each controller."""
    arms, violations = found.plain["arms"], found.plain["violations"]
    if asked.nonsense is not None:
        columns = [Column(name=arm["controller"], short=arm["controller"], text=whole) for arm in arms]
        rows = [(promise, [{arm["controller"]: arm["broken"][promise] for arm in arms}]) for promise in violations]
        yield terminal_table("Promise", [("", rows)], columns)
        return
    column = Column(name="loops", short="ControlledSituation that broke it", text=whole)
    yield terminal_table("Promise", [("", [(promise, [{"loops": n}]) for promise, n in violations.items()])], [column])
    of_guard = {of["controller"]: of for of in found.plain["guarding"]}
    lines: list[Line] = []
    for arm in arms:
        row = {**arm, "all_broken": sum(arm["broken"].values()) + len(arm["not_repeated"])}
        of = of_guard.get(arm["controller"])
        if of is not None:
            row["below_60_pct"] = of["guarded_pct" if arm["guarded"] else "bare_pct"]
            if arm["guarded"]:
                row |= {name: of[name] for name in ("better", "worse", "worst_pct", "worst_person")}
        lines.append((_called(arm), [row]))
    yield terminal_table("Controller", [("", lines)], _ARM_COLUMNS)


def sentences(asked: Verification, found: Findings) -> Iterator[str]:
    """A line for each broken loop that is listed, with the command that repeats it, and the verdict."""
    plain = found.plain
    for name, of in plain.get("meets", {}).items():
        meals = " ".join(f"{carbs:.1f}g@{t:.1f}min" for t, carbs in of["meals"]) or "no meal"
        yield (
            f"{name}: {of['population']}, basal rate {of['basal_insulin_mU_min']:.2f} mU/min; {meals}; noise "
            f"{of['noise_variance']:.3g} (mg/dl)² within {of['noise_bound_mg_dl']:.3g}; {_faults(of)}"
        )
    for arm in plain["arms"]:
        yield from _broken(asked, arm)
    seconds = f"{plain['seconds']:.1f} s"
    if asked.nonsense is not None:
        yield f"{plain['samples']} samples of guarded controllers with nonsense as readings, {seconds}."
    else:
        repeated = sum(arm["repeated"] for arm in plain["arms"])
        more = f"; {repeated} of them closed twice" if repeated else ""
        yield f"{how_many(plain['loops'], 'loop')}, {plain['samples']} samples, {seconds}{more}."
        yield (
            "Below 60: mean time below 60 mg/dl in percent of the run. Better, worse: number of people who spend less "
            "or more time below 60 mg/dl with the guard than without it, by over "
            f"{Guarding.MARGIN_PCT:g} % of the run. Most, person: the largest such increase, and the number of that "
            "person."
        )
        yield from engine_notes({_called(arm): arm for arm in plain["arms"]})
    broken = [promise for promise, count in plain["violations"].items() if count]
    yield f"Broken: {'; '.join(broken)}." if broken else "Every promise was kept."


def _broken(asked: Verification, arm: Mapping[str, Any]) -> Iterator[str]:
    """Lines for the broken loops of a controller."""
    name, called = arm["controller"], _called(arm)
    if asked.nonsense is not None:
        for promise, loops in arm["told"].items():
            for loop in loops:
                yield f"{called}, loop {loop}: {promise}; {_repeat(asked, name, loop)}"
        return
    for of in arm["told"]:
        yield (
            f"{called}, person {of['person']}: {of['promise']}; broken at {of['samples']} samples, first at "
            f"{of['first_min']:g} min; {_faults(of)}; {of['repeat']}"
        )
    for person in arm["not_repeated"][:_LISTED]:
        yield f"{called}, person {person}: other bits; {_repeat(asked, name, person)}"


def _called(arm: Mapping[str, Any]) -> str:
    """Name of a controller with or without its guard, which all controllers of a nonsense test have."""
    return f"{arm['controller']}, guarded" if arm.get("guarded", True) else str(arm["controller"])


def _faults(of: Mapping[str, Any]) -> str:
    return " ".join(f"--fault {fault!r}" for fault in of["faults"]) or "no fault"


def _repeat(asked: Verification | Campaign | NonsenseCheck, controller: str, person: int) -> str:
    """Command that repeats the loops of a person, or a loop of a nonsense test."""
    if isinstance(asked, NonsenseCheck) or (isinstance(asked, Verification) and asked.nonsense is not None):
        kind = "--nonsense 1 "
    else:
        kind = "" if asked.patient == USUAL_PATIENT.name else f"--patient {asked.patient} "
    return f"glucoloop verify {kind}--seed {asked.seed} --controller {controller} --person {person}"
