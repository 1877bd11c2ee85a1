"""A table of bounds for the terminal; piped, it is plain text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from glucoloop.bounds import HedgedDoses, OptimalDoses

if TYPE_CHECKING:
    from rich.table import Table

_COLUMNS: Final = ("Largest deviation", "Undershoot", "Peak", "Settles", "Known after")


def bound_table(plans: Mapping[str, OptimalDoses], hedged: Mapping[str, HedgedDoses] | None = None) -> Table:
    """Table of the best possible results by the knowledge of the meals; mg/dl and min.

    Parameters
    ----------
    plans : mapping of str to OptimalDoses
        Plans by the knowledge of the meals. A plan that did not converge is marked.
    hedged : mapping of str to HedgedDoses, optional
        Hedged doses by the fact that is known late. Their largest deviation is that of the worse world, the other
        numbers are those of the true meal.

    Returns
    -------
    rich.table.Table
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("Information", no_wrap=True)
    for column, unit in zip(_COLUMNS, ("mg/dl", "mg/dl", "mg/dl", "min", "min"), strict=True):
        table.add_column(f"{column}\n{unit}", justify="right")

    def add(label: str, plan: OptimalDoses, deviation_mg_dl: float, settles: str, known: str) -> None:
        told = label if plan.converged else f"{label} (not converged)"
        numbers = [f"{value:z.2f}" for value in (deviation_mg_dl, plan.undershoot_mg_dl, plan.peak_mg_dl)]
        table.add_row(Text(told), *numbers, settles, known)

    for label, plan in plans.items():
        settles = f"{plan.settling_min:.0f}{'' if plan.settled else '+'}"
        known = "" if math.isinf(plan.known_after_min) else f"{plan.known_after_min:g}"
        add(label, plan, plan.deviation_mg_dl, settles, known)
    for label, of in (hedged or {}).items():
        # They are not followed to the end of the run.
        add(
            label,
            of.meal,
            of.deviation_mg_dl,
            "",
            f"{of.told_after_min:g}" if math.isfinite(of.told_after_min) else "never",
        )
    return table
