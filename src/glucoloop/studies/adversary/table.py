"""Table of the worst sensor errors of every controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from glucoloop.printable import glucose_text

if TYPE_CHECKING:
    from rich.table import Table

_HEADS: Final = (
    "Errors\n± %",
    "Worst errors:\nmin below 54",
    "lowest\nmg/dl",
    "peak\nmg/dl",
    "Random errors:\npeople < 54, %",
    "lowest\nmg/dl",
    "No errors:\nlowest",
    "peak\nmg/dl",
)


def adversary_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """One line for each controller and size of the errors.

    Parameters
    ----------
    rows : sequence of mapping
        As `adversary_row` makes them.

    Returns
    -------
    rich.table.Table
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("Controller")
    for head in _HEADS:
        table.add_column(head, justify="right")
    before = None
    for row in rows:
        called = f"{row['controller']}, guarded" if row["guarded"] else str(row["controller"])
        if before not in (None, called):
            table.add_section()
        table.add_row(
            called if called != before else "",
            f"{row['error_pct']:g}",
            f"{row['below_54_min']:.0f}",
            *(glucose_text(row[key]) for key in ("lowest_mg_dl", "peak_mg_dl")),
            f"{row['random_ever_below_54_pct']:.2f}",
            *(glucose_text(row[f"{key}_mg_dl"]) for key in _OTHERS),
        )
        before = called
    return table


_OTHERS: Final = ("random_lowest", "lowest_without_errors", "peak_without_errors")
