"""A stress test as a grid: faults in rows, controllers in columns, without and with a guard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.report.fault_words import short_names
from glucoloop.studies.stress.stress import NO_FAULT, StressResult, StressRow, Tried

NO_FAULT_TOLD: Final = "no fault"
GUARDS: Final = {False: "without the guard", True: "with the guard"}


@dataclass(frozen=True)
class Grid:
    """The cells of a stress test in their places."""

    controllers: tuple[str, ...]
    faults: tuple[str, ...]
    """Full texts of the faults; the empty one is first."""
    guards: tuple[bool, ...]
    """Whether a guard is used, for each variant that was tried."""
    names: dict[str, str]
    """Short name of each fault."""
    rows: dict[Tried, StressRow]

    def row(self, controller: str, guarded: bool, fault: str) -> StressRow:
        """Result of a cell."""
        return self.rows[Tried(controller=controller, guarded=guarded, fault=fault)]

    def pair(self, controller: str, fault: str) -> list[StressRow]:
        """A controller under a fault, without and with the guard, as far as they were tried."""
        return [self.row(controller, guarded, fault) for guarded in self.guards]

    def under_faults(self, guarded: bool) -> list[StressRow]:
        """All cells with a fault."""
        return [self.row(controller, guarded, fault) for controller in self.controllers for fault in self.faults[1:]]

    def told(self, tried: Tried) -> str:
        """Short name of a cell's fault."""
        return self.names[tried.fault]


def grid_of(result: StressResult) -> Grid:
    """The cells in their places, in the order of the rows.

    Raises
    ------
    ValueError
        If there is no row, one is there twice, or one is missing.
    """
    rows = {row.tried: row for row in result.rows}
    if not rows:
        raise Refusal("the stress test has no rows to show; give at least one")
    if len(rows) < len(result.rows):
        twice = next(row.tried for row in result.rows if sum(other.tried == row.tried for other in result.rows) > 1)
        raise Refusal(f"the stress test has two rows of {twice.label!r}; leave one out")
    controllers = tuple(dict.fromkeys(tried.controller for tried in rows))
    faults = (NO_FAULT, *dict.fromkeys(tried.fault for tried in rows if tried.fault != NO_FAULT))
    guards = tuple(sorted({tried.guarded for tried in rows}))
    for controller in controllers:
        for guarded in guards:
            for fault in faults:
                tried = Tried(controller=controller, guarded=guarded, fault=fault)
                if tried not in rows:
                    raise Refusal(f"the stress test has no row of {tried.label!r}; give one for every cell")
    names = {NO_FAULT: NO_FAULT_TOLD} | short_names(faults[1:])
    return Grid(controllers=controllers, faults=faults, guards=guards, names=names, rows=rows)


def people_of(result: StressResult) -> int:
    """Number of people who took part, the same under every controller apart from lost people."""
    return max(row.people for row in result.rows)
