"""A campaign or a nonsense test carried out, in tables and sentences."""

from __future__ import annotations

import functools
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import polars as pl

from glucoloop.metrics.promises import OF_CONTROLLER, PROMISES
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, FittingTable, Line, decimals, terminal_table, whole
from glucoloop.reporting.descriptions import engine_notes
from glucoloop.reporting.labelled_traces import moment_text
from glucoloop.schema.values import checked, json_value
from glucoloop.situations.case import cases_of
from glucoloop.situations.run import ControlledSituation, intravenous_boluses
from glucoloop.storage.results import Results
from glucoloop.storage.rows import Rows
from glucoloop.studies.verification import VERIFY, Verification
from glucoloop.studies.verification.campaign import (
    LISTED,
    MARGIN_PCT,
    circumstances_of,
    run_campaign,
)
from glucoloop.studies.verification.nonsense import run_nonsense
from glucoloop.text import how_many

SAME_BITS: Final = "the same bits again, in another order and other blocks"
_MAX_PARTS: Final = 10_000
_LONGEST_TEXT: Final = 20_000_000
"""Largest size of the results of a part as a text: each broken loop of which is listed by number."""


@dataclass(frozen=True, kw_only=True)
class _Arm:
    """Form of the results of one controller with a guard or without."""

    controller: str
    guarded: bool
    engine: str
    not_native: str | None
    loops: int
    samples: int
    broken: dict[str, int]
    repeated: int
    not_repeated: list[int]
    examples: list[dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class _Guarding:
    """Form of the effect of the guard on the time below 60 mg/dl."""

    controller: str
    pairs: int
    bare_pct: float
    guarded_pct: float
    better: int
    worse: int
    worst_pct: float
    worst_person: int


@dataclass(frozen=True, kw_only=True)
class _NonsenseArm:
    """Form of the results of one guarded controller that was given nonsense."""

    controller: str
    sample_time_min: float
    precision: str
    loops: int
    samples: int
    broken: dict[str, int]
    examples: dict[str, list[int]]


def notes(config: Verification) -> tuple[str, ...]:
    """Sentence on intravenous boluses, where controllers were chosen."""
    if config.nonsense is not None or not config.controllers:
        return ()
    chosen = cases_of(*config.controllers)
    return intravenous_boluses(ControlledSituation(patient=PATIENTS.choose(config.patient), controller=chosen))


@dataclass(frozen=True)
class _Part:
    """Loops of one controller, with a guard or without, or at one sample time and precision of a nonsense test."""

    result: dict[str, Any]
    """The ``arm``, and of a guarded one ``guarding``, as `run_campaign` and `run_nonsense` yield them."""
    seconds: float


def _arms_of(config: Verification) -> list[dict[str, Any]]:
    """Names of the parts in their order: the controller, and the guard or the timing."""
    timings = [
        {"sample_time_min": sample_time, "precision": precision} for sample_time, precision in config.guard_timings()
    ]
    each = [{"guarded": False}, {"guarded": True}] if config.nonsense is None else timings
    return [{"controller": name, "loops": number, **one} for name, number in config.people().items() for one in each]


def rows(config: Verification) -> Rows[_Part]:
    """Rows that are kept: the loops of each controller with a guard, and of each without."""
    arms, form = _arms_of(config), _Arm if config.nonsense is None else _NonsenseArm

    def row(cells: Mapping[str, Any], before: Sequence[_Part]) -> _Part:
        if len(before) == len(arms):
            raise Refusal("it has more rows than the verification")
        result = checked(dict[str, dict[str, Any]], json_value(cells["result"].encode()))
        arm, expected = result.get("arm", {}), arms[len(before)]
        checked(form, arm)
        if expected.get("guarded"):
            checked(_Guarding, result.get("guarding"))
        if any(arm[name] != value for name, value in expected.items()):
            raise Refusal("these are not the next loops of the verification")
        return _Part(result, cells["seconds"])

    return Rows(
        file=VERIFY.results,
        what="parts",
        wanted=len(arms),
        most=_MAX_PARTS,
        schema={"result": pl.String, "seconds": pl.Float64},
        cells=lambda part: {"result": json.dumps(part.result, allow_nan=False), "seconds": part.seconds},
        row=row,
        longest_text=_LONGEST_TEXT,
        unit="loops",
        work=lambda number: arms[number]["loops"],
        counted_within=True,
    )


def search(config: Verification) -> _Campaign:
    """The loops of the campaign, or of the nonsense test."""
    return _Campaign(config)


class _Campaign:
    """The parts of a verification, one after the other."""

    def __init__(self, config: Verification) -> None:
        self._config = config

    def missing(self, parts: Sequence[_Part], progress: Callable[[int], None]) -> Iterator[_Part]:
        """Close the loops of the parts that follow; `progress` is called with each number of loops that are done."""
        config, began = self._config, time.monotonic()
        run = run_campaign if config.nonsense is None else run_nonsense
        for result in run(config, progress, len(parts)):
            yield _Part(result, time.monotonic() - began)
            began = time.monotonic()

    def results_of(self, parts: Sequence[_Part]) -> Results:
        """Count in how many loops each promise was broken; of an interrupted one, in those of the first parts."""
        config = self._config
        arms = [part.result["arm"] for part in parts]
        promises = PROMISES if config.nonsense is None else OF_CONTROLLER
        violations = {promise: sum(arm["broken"][promise] for arm in arms) for promise in promises}
        if config.nonsense is None:
            violations[SAME_BITS] = sum(len(arm["not_repeated"]) for arm in arms)
        plain = {
            "seed": config.seed,
            "loops": sum(arm["loops"] for arm in arms),
            "samples": sum(arm["samples"] for arm in arms),
            "seconds": sum(part.seconds for part in parts),
            "interrupted": len(parts) < len(_arms_of(config)),
            "holds": not any(violations.values()),
            "violations": violations,
            "arms": arms,
        }
        if config.nonsense is None:
            plain["guarding"] = [part.result["guarding"] for part in parts if "guarding" in part.result]
            if config.person is not None:
                plain["meets"] = {
                    name: circumstances_of(name, config.seed, config.person, config.patient) for name in config.people()
                }
        return Results(plain)


def files_of(config: Verification, results: Results) -> dict[str, bytes]:
    """Further files: none, for there is no page and no figure."""
    del config, results
    return {}


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
        for promise, loops in arm["examples"].items():
            repeat = functools.partial(config.repeat, name, timing=(arm["sample_time_min"], arm["precision"]))
            yield from (f"{called}, loop {loop}: {promise}; {repeat(loop)}" for loop in loops)
        return
    for broken in arm["examples"]:
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
