"""A campaign or a nonsense test carried out, in tables and sentences."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.metrics.promises import OF_CONTROLLER, PROMISES
from glucoloop.patients.settings import PATIENTS
from glucoloop.reporting.columns import Column, FittingTable, Line, decimals, terminal_table, whole
from glucoloop.reporting.descriptions import engine_notes
from glucoloop.reporting.periods import moment_text
from glucoloop.situations.case import Case
from glucoloop.situations.run import ControlledSituation, intravenous_boluses
from glucoloop.storage.results import Results
from glucoloop.studies.verification import Verification
from glucoloop.studies.verification.campaign import (
    LISTED,
    MARGIN_PCT,
    circumstances_of,
    run_campaign,
)
from glucoloop.studies.verification.nonsense import run_nonsense
from glucoloop.text import how_many

SAME_BITS: Final = "the same bits again, in another order and other blocks"


def notes(config: Verification) -> tuple[str, ...]:
    """Sentence on boluses into a vein, where controllers were chosen."""
    if config.nonsense is not None or not config.controllers:
        return ()
    chosen = tuple(Case(controller=CONTROLLERS.find(name).partial({})) for name in config.controllers)
    return intravenous_boluses(ControlledSituation(patient=PATIENTS.parse(config.patient), controller=chosen))


def amount(config: Verification) -> int:
    """Number of loops that will be closed."""
    repeats = 2 if config.nonsense is None else len(config.guard_timings())
    return repeats * sum(config.people().values())


def results_of(config: Verification, progress: Callable[[int], None]) -> Results:
    """Close the loops, and count in how many each promise was broken.

    After an interrupt, of which `progress` tells, only controllers whose loops were all closed are among the findings.
    """
    began, interrupted = time.monotonic(), False
    arms: list[dict[str, Any]] = []
    guarding: list[dict[str, Any]] = []
    try:
        for part in run_campaign(config, progress) if config.nonsense is None else run_nonsense(config, progress):
            arms.append(part["arm"])
            guarding += [part["guarding"]] if "guarding" in part else []
    except KeyboardInterrupt:
        interrupted = True
    promises = PROMISES if config.nonsense is None else OF_CONTROLLER
    violations = {promise: sum(arm["broken"][promise] for arm in arms) for promise in promises}
    if config.nonsense is None:
        violations[SAME_BITS] = sum(len(arm["not_repeated"]) for arm in arms)
    plain = {
        "seed": config.seed,
        "loops": sum(arm["loops"] for arm in arms),
        "samples": sum(arm["samples"] for arm in arms),
        "seconds": time.monotonic() - began,
        "interrupted": interrupted,
        "holds": not any(violations.values()),
        "violations": violations,
        "arms": arms,
    }
    if config.nonsense is None:
        plain["guarding"] = guarding
        if config.person is not None:
            circumstances = {
                name: circumstances_of(name, config.seed, config.person, config.patient) for name in config.people()
            }
            plain["meets"] = circumstances
    return Results(plain)


_effect = functools.partial(Column, only=lambda row: "better" in row)
_ARM_COLUMNS: Final = (
    Column(name="engine", short="Engine", text=str, left=True),
    Column(name="loops", short="Loops", text=whole),
    Column(name="samples", short="Samples", text=whole),
    Column(name="all_broken", short="Broken", text=whole),
    Column(name="below_60_pct", short="Below 60, %", text=decimals(2), only=lambda row: "below_60_pct" in row),
    _effect(name="better", short="Better", text=whole),
    _effect(name="worse", short="Worse", text=whole),
    _effect(name="worst_pct", short="Most, %", text="{:+.1f}".format),
    Column(name="worst_person", short="Person", text=whole, only=lambda row: row.get("worst_pct", 0.0) > 0.0),
)


def tables(config: Verification, results: Results) -> Iterator[FittingTable]:
    """Number of loops that broke each promise, and the loops of each controller."""
    arms, violations = results.plain["arms"], results.plain["violations"]
    if config.nonsense is not None:
        broken: dict[str, Counter[str]] = {arm["controller"]: Counter() for arm in arms}
        for arm in arms:
            broken[arm["controller"]].update(arm["broken"])
        columns = [Column(name=name, short=name, text=whole) for name in broken]
        rows = [(promise, [{name: of[promise] for name, of in broken.items()}]) for promise in violations]
        yield terminal_table("Promise", [("", rows)], columns)
        return
    column = Column(name="loops", short="Loops that broke it", text=whole)
    yield terminal_table("Promise", [("", [(promise, [{"loops": n}]) for promise, n in violations.items()])], [column])
    guarding = {effect["controller"]: effect for effect in results.plain["guarding"]}
    lines: list[Line] = []
    for arm in arms:
        row = {**arm, "all_broken": sum(arm["broken"].values()) + len(arm["not_repeated"])}
        effect = guarding.get(arm["controller"])
        if effect is not None:
            row["below_60_pct"] = effect["guarded_pct" if arm["guarded"] else "bare_pct"]
            if arm["guarded"]:
                row |= {name: effect[name] for name in ("better", "worse", "worst_pct", "worst_person")}
        lines.append((_called(arm), [row]))
    yield terminal_table("Controller", [("", lines)], _ARM_COLUMNS)


def sentences(config: Verification, results: Results) -> Iterator[str]:
    """A line for each broken loop that is listed, with the command that repeats it, and the verdict."""
    plain = results.plain
    for name, person in plain.get("meets", {}).items():
        meals = " ".join(f"{carbs:.1f}g@{t:.1f}min" for t, carbs in person["meals"]) or "no meal"
        yield (
            f"{name}: {person['population']}, basal rate {person['basal_insulin_mU_min']:.2f} mU/min; {meals}; noise "
            f"{person['noise_variance']:.3g} (mg/dl)² within {person['noise_bound_mg_dl']:.3g}; {_faults(person)}"
        )
    for arm in plain["arms"]:
        yield from _broken(config, arm)
    seconds = f"{plain['seconds']:.1f} s"
    if config.nonsense is not None:
        yield f"{plain['samples']} samples of guarded controllers with nonsense as inputs, {seconds}."
    else:
        repeated = sum(arm["repeated"] for arm in plain["arms"])
        more = f"; {repeated} of them closed twice" if repeated else ""
        yield f"{how_many(plain['loops'], 'loop')}, {plain['samples']} samples, {seconds}{more}."
        yield (
            "Below 60: mean time below 60 mg/dl in percent of the run. Better, worse: number of people who spend less "
            f"or more time below 60 mg/dl with the guard than without it, by over {MARGIN_PCT:g} % of the run. Most, "
            "person: the largest such increase, and the number of that person."
        )
        yield from engine_notes({_called(arm): arm for arm in plain["arms"]})
    broken = [promise for promise, count in plain["violations"].items() if count]
    yield f"Broken: {'; '.join(broken)}." if broken else "Every promise was kept."


def _broken(config: Verification, arm: Mapping[str, Any]) -> Iterator[str]:
    """Lines for the broken loops of a controller."""
    name, called = arm["controller"], _called(arm)
    if config.nonsense is not None:
        for promise, loops in arm["told"].items():
            repeat = functools.partial(config.repeat, name, timing=(arm["sample_time_min"], arm["precision"]))
            yield from (f"{called}, loop {loop}: {promise}; {repeat(loop)}" for loop in loops)
        return
    for broken in arm["told"]:
        yield (
            f"{called}, person {broken['person']}: {broken['promise']}; broken at {broken['samples']} samples, first "
            f"at {moment_text(broken['first_min'])}; {_faults(broken)}; {broken['repeat']}"
        )
    for person in arm["not_repeated"][:LISTED]:
        yield f"{called}, person {person}: other bits; {config.repeat(name, person)}"


def _called(arm: Mapping[str, Any]) -> str:
    """Name of a controller with or without its guard, which all controllers of a nonsense test have."""
    return f"{arm['controller']}, guarded" if arm.get("guarded", True) else str(arm["controller"])


def _faults(person: Mapping[str, Any]) -> str:
    return " ".join(f"--fault {fault!r}" for fault in person["faults"]) or "no fault"
