"""Conclusions of a stress test in sentences; every number is computed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from glucoloop.printable import how_many
from glucoloop.studies.stress._cells import short_mg_dl, short_pct
from glucoloop.studies.stress._grid import Grid
from glucoloop.studies.stress.stress import MOST_MORE_PCT, MOST_NAMED, NO_FAULT, StressResult, StressRow

_MOST_LISTED: Final = 5


def verdict(grid: Grid) -> list[str]:
    """Conclusions about cells that pass and cells that fail, in short paragraphs."""
    if not grid.faults[1:]:
        return ["No fault was tried.", *_without_a_fault(grid)]
    return [*_standing(grid), *_failing(grid), *_harm_of_the_guard(grid), *_without_a_fault(grid)]


def left_out(result: StressResult) -> list[str]:
    """Sentences on people who are in no row, or not in all."""
    told, able = [], max(row.people for row in result.rows) if result.able is None else result.able
    if result.infeasible:
        told.append(
            f"Of {people_told(result.infeasible + able)} {result.infeasible} "
            f"{'has' if result.infeasible == 1 else 'have'} no basal rate for the setpoint and took no part."
        )
    lost = [row for row in result.rows if row.people < able]
    if lost:
        most = min(lost, key=lambda row: row.people)
        told.append(
            f"In {len(lost)} of {len(result.rows)} combinations the glucose of some people, {able - most.people} of "
            f"{people_told(able)} at most ({most.tried.label}), did not stay a finite number, with or without the "
            "fault; they are in no number there."
        )
    return told


def people_told(people: int) -> str:
    """Text of a number of people."""
    return f"{people} {'person' if people == 1 else 'people'}"


def worse_told(row: StressRow) -> str:
    """Text of the number of people who were worse off, and of the largest difference."""
    most = short_pct(row.worst_more_pct)
    return f"{len(row.worse)} of {people_told(row.people)} worse off, by at most {most} % of the time"


def numbers_told(row: StressRow) -> str:
    """List of the people who were worse off, shortened if it is long."""
    told = ", ".join(map(str, row.worse[:MOST_NAMED]))
    beyond = len(row.worse) - MOST_NAMED
    return f"{told} and {beyond} more" if beyond > 0 else told


def failing(grid: Grid, guarded: bool) -> list[StressRow]:
    """Cells in which a person was worse off, the worst first."""
    return sorted((row for row in grid.under_faults(guarded) if not row.stands), key=lambda row: -row.worst_more_pct)


def _known(grid: Grid, guarded: bool) -> list[StressRow]:
    return [row for row in grid.under_faults(guarded) if row.people]


def _standing(grid: Grid) -> list[str]:
    told: list[str] = []
    for guarded in reversed(grid.guards):
        known = _known(grid, guarded)
        stand = sum(row.stands for row in known)
        if len(told) == 1:
            told.append(f"Without the guard, {stand} of {len(known)} passed.")
            continue
        which = "With" if guarded else "Without"
        told.append(
            f"{which} the guard, {stand} of {len(known)} combinations of a controller and a fault passed: with the "
            f"fault, nobody spent more than {MOST_MORE_PCT:g} % more of the time below 60 mg/dl than without it."
        )
    unknown = len(grid.under_faults(grid.guards[0])) - len(_known(grid, grid.guards[0]))
    if unknown:
        told.append(f"In {how_many(unknown, 'further combination')} nobody could take part.")
    return [" ".join(told)]


def _failing(grid: Grid) -> list[str]:
    guarded = grid.guards[-1]
    rows = failing(grid, guarded)
    which = "with" if guarded else "without"
    if not rows:
        return []
    listed = [f"{_cell(grid, row)} ({worse_told(row)})" for row in rows[:_MOST_LISTED]]
    more = len(rows) - _MOST_LISTED
    return [
        f"Combinations that failed {which} the guard: {'; '.join(listed)}{f'; and {more} more' if more > 0 else ''}."
    ]


def _harm_of_the_guard(grid: Grid) -> list[str]:
    """Sentences on harm by the guard; the absence of harm is stated too, since the test looks for it."""
    if len(grid.guards) < 2:
        return []
    pairs = [grid.pair(controller, fault) for controller in grid.controllers for fault in grid.faults]
    pairs = [pair for pair in pairs if all(row.people for row in pair)]
    if not pairs:
        return []
    longer = [(row.below_60_mean_pct - bare.below_60_mean_pct, row) for bare, row in pairs]
    longer = [(difference, row) for difference, row in longer if difference > 0.0]
    if not longer:
        return ["In no combination, with or without a fault, did the guard lengthen the mean time below 60 mg/dl."]
    most, row = max(longer, key=lambda each: each[0])
    return [
        f"In {len(longer)} of {len(pairs)} combinations, those without a fault included, the mean time below 60 mg/dl "
        f"was longer with the guard than without it: by at most {short_pct(most)} % of the time, in {_cell(grid, row)}."
    ]


def _without_a_fault(grid: Grid) -> list[str]:
    """Sentences on the effect of the guard without a fault."""
    told = []
    for controller in grid.controllers:
        rows = grid.pair(controller, NO_FAULT)
        below = _both([short_pct(row.below_60_worst_pct) + " %" for row in rows])
        highest = _both([short_mg_dl(row.highest_mg_dl) for row in rows])
        told.append(f"{controller}: {below} and {highest}")
    how = " (without → with the guard)" if len(grid.guards) > 1 else ""
    sentences = [
        f"Without a fault, the longest time that a person spends below 60 mg/dl, and the highest glucose in "
        f"mg/dl{how}, are {'; '.join(told)}."
    ]
    if True in grid.guards:
        acts = (
            f"{short_pct(_acted_pct(grid.row(controller, True, NO_FAULT)))} % with {controller}"
            for controller in grid.controllers
        )
        sentences.append(f"Without a fault, the guard acted at this percentage of the samples: {'; '.join(acts)}.")
    return [" ".join(sentences)]


def _acted_pct(row: StressRow) -> float:
    """Percentage of samples at which the guard acted on the reading or the dose; each sample has one status."""
    return row.rejected_pct + row.fallback_pct + row.suspended_pct + row.dose_limited_pct


def _both(values: Sequence[str]) -> str:
    return values[0] if len(set(values)) == 1 else " → ".join(values)


def _cell(grid: Grid, row: StressRow) -> str:
    fault = grid.told(row.tried)
    return f"{row.tried.controller} {'with' if row.tried.fault == NO_FAULT else 'under'} {fault}"
