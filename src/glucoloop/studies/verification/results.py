"""Results of verification, of a campaign or of nonsense: tables and sentences, and the same as JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.printable import how_many
from glucoloop.studies.verification.campaign import Campaign, met
from glucoloop.studies.verification.nonsense import NonsenseResult
from glucoloop.studies.verification.result import Arm, Broken, CampaignResult, Guarding

if TYPE_CHECKING:
    from rich.table import Table


def campaign_told(campaign: Campaign, result: CampaignResult, seconds: float) -> Iterator[str | Table]:
    """Tables, and a line for each broken loop."""
    if campaign.person is not None:
        yield from _meets(campaign, campaign.person)
    promises = _table("Promise", "Loops that broke it")
    for promise, count in result.violations.items():
        promises.add_row(promise, str(count))
    yield promises
    yield _controllers(result)
    yield from broken_lines(result)
    more = f"; {result.repeated} of them closed twice" if result.repeated else ""
    yield f"{how_many(result.loops, 'loop')}, {result.samples} samples, {seconds:.1f} s{more}."
    yield (
        "Below 60: mean time below 60 mg/dl. Better, worse: number of people who spend less or more time below 60 "
        f"mg/dl with the guard than without it, by over {Guarding.MARGIN_PCT:g} % of the run. Most, person: the "
        "largest such difference, and the number of that person."
    )
    yield _verdict(result.violations)


def nonsense_told(result: NonsenseResult, seconds: float) -> Iterator[str | Table]:
    """A table, and a line for each broken loop."""
    table = _table("Promise", *(arm.controller for arm in result.arms))
    for promise in result.violations:
        table.add_row(promise, *(str(arm.broken[promise]) for arm in result.arms))
    yield table
    for arm in result.arms:
        for promise, loops in arm.told.items():
            for loop in loops:
                yield (
                    f"{arm.controller}, guarded, loop {loop}: {promise}; "
                    f"glucoloop verify --nonsense 1 --seed {result.seed} --controller {arm.controller} --person {loop}"
                )
    yield f"{result.samples} samples of guarded controllers with nonsense as readings, {seconds:.1f} s."
    yield _verdict(result.violations)


def campaign_report(campaign: Campaign, result: CampaignResult, seconds: float) -> dict[str, Any]:
    """The same as one JSON object."""
    arms = [dataclasses.asdict(arm) for arm in result.arms]
    for arm, told in zip(arms, result.arms, strict=True):
        arm["told"] = [{**of, "repeat": repeat(result, told.controller, of["person"])} for of in arm["told"]]
    of_person = {}
    if campaign.person is not None:
        person = campaign.person
        of_person = {
            name: dataclasses.asdict(met(name, campaign.seed, person, campaign.patient))
            for name in campaign.controllers
        }
    return {
        "seed": result.seed,
        "loops": result.loops,
        "samples": result.samples,
        "seconds": seconds,
        "interrupted": result.interrupted,
        "violations": result.violations,
        "arms": arms,
        "guarding": [dataclasses.asdict(of) for of in result.guarding],
        **({"meets": of_person} if of_person else {}),
    }


def nonsense_report(result: NonsenseResult, seconds: float) -> dict[str, Any]:
    """Plain values for JSON."""
    return {
        "seed": result.seed,
        "samples": result.samples,
        "seconds": seconds,
        "interrupted": result.interrupted,
        "violations": result.violations,
        "arms": [dataclasses.asdict(arm) for arm in result.arms],
    }


def repeat(result: CampaignResult, controller: str, person: int) -> str:
    """Command that repeats the loops of a person."""
    patient = "" if result.patient == USUAL_PATIENT.name else f"--patient {result.patient} "
    return f"glucoloop verify {patient}--seed {result.seed} --controller {controller} --person {person}"


def broken_lines(result: CampaignResult) -> Iterator[str]:
    """Line for each listed broken loop: the promise that broke, and the command that repeats it."""
    for arm in result.arms:
        for broken in arm.told:
            yield _line(result, arm, broken)
        for person in arm.not_repeated[:10]:
            yield f"{_called(arm)}, person {person}: other bits; {repeat(result, arm.controller, person)}"


def _line(result: CampaignResult, arm: Arm, broken: Broken) -> str:
    faults = " ".join(f"--fault {fault!r}" for fault in broken.faults) or "no fault"
    return (
        f"{_called(arm)}, person {broken.person}: {broken.promise}; broken at {broken.samples} samples, first at "
        f"{broken.first_min:g} min; {faults}; {repeat(result, arm.controller, broken.person)}"
    )


def _called(arm: Arm) -> str:
    return f"{arm.controller}, guarded" if arm.guarded else arm.controller


def _meets(campaign: Campaign, person: int) -> Iterator[str]:
    for name in campaign.controllers:
        of = met(name, campaign.seed, person, campaign.patient)
        meals = " ".join(f"{carbs:.1f}g@{t:.1f}min" for t, carbs in of.meals) or "no meal"
        faults = " ".join(f"--fault {fault!r}" for fault in of.faults) or "no fault"
        yield (
            f"{name}: {of.population}, basal rate {of.basal_insulin_mU_min:.2f} mU/min; {meals}; noise "
            f"{of.noise_variance:.3g} (mg/dl)² within {of.noise_bound_mg_dl:.3g}; {faults}"
        )


def _controllers(result: CampaignResult) -> Table:
    numbers = ("Loops", "Samples", "Broken", "Below 60, %", "Better", "Worse", "Most, %", "Person")
    table = _table("Controller", "Engine", *numbers)
    of_guard: dict[str, Guarding] = {of.controller: of for of in result.guarding}
    for arm in result.arms:
        broken = sum(arm.broken.values()) + len(arm.not_repeated)
        row = [_called(arm), arm.engine, str(arm.loops), str(arm.samples), str(broken)]
        of = of_guard.get(arm.controller)
        if of is not None and arm.guarded:
            row += [f"{of.guarded_pct:.2f}", str(of.better), str(of.worse), f"{of.worst_pct:+.1f}"]
            row.append(str(of.worst_person) if of.worst_pct > 0.0 else "")
        elif of is not None:
            row.append(f"{of.bare_pct:.2f}")
        table.add_row(*row)
    return table


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for column in columns:
        text = column in ("Promise", "Controller", "Engine")
        table.add_column(column, justify="left" if text else "right", no_wrap=not text)
    return table


def _verdict(violations: Mapping[str, int]) -> str:
    broken = [promise for promise, count in violations.items() if count]
    return f"Broken: {'; '.join(broken)}." if broken else "Every promise was kept."
