"""A stress test as a table for the terminal; piped, it is plain text."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from glucoloop.printable import NOT_AVAILABLE
from glucoloop.studies.stress._cells import short_mg_dl, short_pct
from glucoloop.studies.stress._grid import GUARDS, Grid, grid_of
from glucoloop.studies.stress.stress import MOST_MORE_PCT, StressResult, StressRow

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.table import Table

Tell = Callable[[StressRow], str]


def _terse_pct(value: float) -> str:
    """Text of a percentage, with a decimal only for small values."""
    short = short_pct(value)
    return f"{min(value, 99.0):.0f}" if 9.95 <= value < 100.0 else short


# Both without and with the guard.
_PAIRS: Final[dict[str, Tell]] = {
    "<60\nmean": lambda row: _terse_pct(row.below_60_mean_pct),
    "<60\nworst": lambda row: _terse_pct(row.below_60_worst_pct),
    "<54\nworst": lambda row: _terse_pct(row.below_54_worst_pct),
    "least\nmg/dl": lambda row: short_mg_dl(row.lowest_mg_dl),
    "low\nevents": lambda row: str(row.low_events) if row.people else NOT_AVAILABLE,
    "\nsat.": lambda row: _terse_pct(row.saturated_pct),
}
# Of the guard alone.
_GUARD: Final[dict[str, Tell]] = {
    "fall\nback": lambda row: _terse_pct(row.fallback_pct),
    "\nsusp.": lambda row: _terse_pct(row.suspended_pct),
}
_ANY_WIDTH: Final = 10_000
_WORSE: Final = "worse\noff"


@dataclass(frozen=True)
class FittingTable:
    """A table that leaves out whole columns where there is no room, since a cut number would be another number."""

    table: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich.measure import Measurement
        from rich.text import Text

        wide = options.update(width=_ANY_WIDTH)
        shown = copy.copy(self.table)
        while len(shown.columns) > 1 and Measurement.get(console, wide, shown).minimum > options.max_width:
            shown.columns = shown.columns[:-1]
        left_out = len(self.table.columns) - len(shown.columns)
        yield shown
        if left_out:
            columns = "column is" if left_out == 1 else "columns are"
            yield Text(f"For want of room, {left_out} {columns} left out on the right.")


def stress_table(result: StressResult) -> FittingTable:
    """A stress test, controller by controller: a row for each fault, numbers without and with the guard side by side.

    Columns: people who were worse off; time below 60 mg/dl, over all people and of the one who was longest below; the
    longest below 54 mg/dl; the lowest glucose; the events below 70 mg/dl of all people; samples at which the dose was
    cut to the pump's limits, at which the guard fell back to the basal rate, and at which it suspended.

    Parameters
    ----------
    result : StressResult

    Returns
    -------
    FittingTable
        Table for rich to print, at most 110 characters wide for the standard faults; a narrower terminal shows as many
        columns as it has room for, and says so.

    Raises
    ------
    ValueError
        If there are no rows, or they do not make a grid.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    grid = grid_of(result)
    table = Table(
        box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption=Text(_caption(grid)), caption_justify="left"
    )
    longest_word = max(len(word) for name in grid.names.values() for word in name.split())
    table.add_column("Fault", vertical="bottom", overflow="fold", min_width=longest_word + 1)
    heads = [_WORSE, *_PAIRS, *(_GUARD if True in grid.guards else ())]
    columns = _columns(grid)
    for head in heads:
        width = max(map(len, columns[head].values()))
        table.add_column(Text(head), justify="right", vertical="bottom", overflow="fold", min_width=width)
    for index, controller in enumerate(grid.controllers):
        if index:
            table.add_section()
        # Text, since square brackets in a label would be taken for markup
        table.add_row(Text(controller, "bold"))
        for fault in grid.faults:
            rows = grid.pair(controller, fault)
            style = "" if rows[-1].stands else "bold"
            cells = (Text(columns[head][controller, fault], style if head == _WORSE else "") for head in heads)
            table.add_row(Text(f" {grid.names[fault]}"), *cells)
    return FittingTable(table)


def _columns(grid: Grid) -> dict[str, dict[tuple[str, str], str]]:
    """Text of each cell, by column; the two numbers of a pair stand below each other from row to row."""
    columns: dict[str, dict[tuple[str, str], str]] = {}
    for head, tell in {**_PAIRS, _WORSE: _people_worse}.items():
        pairs = {
            (controller, fault): [tell(row) for row in grid.pair(controller, fault)]
            for controller in grid.controllers
            for fault in grid.faults
        }
        width = max(len(told[-1]) for told in pairs.values())
        columns[head] = {cell: _beside(told, width) for cell, told in pairs.items()}
    for head, tell in _GUARD.items():
        columns[head] = {
            (controller, fault): tell(grid.row(controller, True, fault)) if True in grid.guards else ""
            for controller in grid.controllers
            for fault in grid.faults
        }
    return columns


def _beside(told: Sequence[str], width: int) -> str:
    return "|".join([*told[:-1], f"{told[-1]:>{width}}"])


def _people_worse(row: StressRow) -> str:
    return str(len(row.worse)) if row.people else NOT_AVAILABLE


def _caption(grid: Grid) -> str:
    if len(grid.guards) > 1:
        which = "In each pair a|b, a is without the guard and b with it."
    else:
        which = f"All numbers are {GUARDS[grid.guards[0]]}."
    return (
        f"{which} Worse off: people who spent over {MOST_MORE_PCT:g} % more of the time below 60 mg/dl than without "
        "the fault. <60, <54: percentage of the time below 60 or 54 mg/dl, as the mean over the people and for the "
        "person with the longest time (worst). Least: lowest glucose. Low events: periods of 15 min or longer below "
        "70 mg/dl, summed over all people. Saturated (dose at the pump's limits), fallback (the guard gave the basal "
        "rate), suspended (the guard stopped insulin): percentage of the samples."
    )
