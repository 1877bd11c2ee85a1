"""Performance of estimators of unknown meals as a table for the terminal; piped, it is plain text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from glucoloop.printable import NOT_AVAILABLE, how_many
from glucoloop.studies.detection.result import TOLD_AFTER_MIN, DetectionResult

if TYPE_CHECKING:
    from rich.table import Table

_SPREAD: Final = ("p10", "median", "p90")


def detection_table(result: DetectionResult) -> Table:
    """One column for each estimator: meals found and missed, delay, error of the size, and false alarms.

    Three numbers in a cell are the 10 % quantile, the median and the 90 % quantile over meals.

    Parameters
    ----------
    result : DetectionResult

    Returns
    -------
    rich.table.Table
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    told = {of.estimator: of.summary() for of in result.estimators}
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for name in told:
        table.add_column(Text(name), justify="right")
    table.add_column("Unit")

    def row(name: str, unit: str, *keys: str, digits: int = 1, signed: bool = False) -> None:
        table.add_row(name, *(_cell(of, keys, digits, signed) for of in told.values()), unit)

    row("Meals", "", "meals", digits=0)
    row("Missed", "%", "missed_pct")
    row("Began while above the threshold", "%", "already_pct")
    row("Delay of detection", "min", *(f"delay_{q}_min" for q in _SPREAD), digits=0)
    for size in range(len(next(iter(told.values()))["by_size"])):
        of_size = {name: of["by_size"][size] for name, of in told.items()}
        some = next(iter(of_size.values()))
        cells = (_cell(of, tuple(f"delay_{q}_min" for q in _SPREAD), 0, False) for of in of_size.values())
        table.add_row(f"  {_size(some)}, {how_many(some['meals'], 'meal')}", *cells, "min")
    table.add_section()
    for after in TOLD_AFTER_MIN:
        keys = tuple(f"size_error_at_{after:.0f}_min_{q}_g" for q in _SPREAD)
        row(f"Error of the size, {after:.0f} min after the beginning", "g", *keys, signed=True)
    row("  60 min after the end", "g", *(f"size_error_after_end_{q}_g" for q in _SPREAD), signed=True)
    table.add_section()
    row("False alarms on fasting days", "per day", "false_alarms_fasting_per_day", digits=2)
    row("  between meals", "per day", "false_alarms_between_per_day", digits=2)
    return table


def _size(of: Mapping[str, Any]) -> str:
    if of["to_g"] is None:
        return f"{of['from_g']:g} g and more"
    return f"up to {of['to_g']:g} g" if not of["from_g"] else f"{of['from_g']:g} to {of['to_g']:g} g"


def _cell(of: Mapping[str, Any], keys: tuple[str, ...], digits: int, signed: bool) -> str:
    """Text of a cell with several numbers side by side."""
    values = [of[key] for key in keys]
    if any(value is None for value in values):
        return NOT_AVAILABLE
    return "  ".join(f"{round(value, digits) + 0.0:{'+' if signed else ''}.{digits}f}" for value in values)
