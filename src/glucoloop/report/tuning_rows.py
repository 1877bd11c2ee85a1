"""The tunings of a surface as rows of text, the best first, for the terminal or a page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from glucoloop.tuning.surface import TuningRank, TuningSurface


@dataclass(frozen=True)
class TuningRow:
    """One tuning as a row of text."""

    point: int
    """Index of the tuning into the surface's arrays."""
    apart: bool
    """Whether rows between this one and the one above are left out."""
    cells: tuple[str, ...]
    """Text of each column that `heads` names."""


def heads(surface: TuningSurface) -> list[tuple[str, str]]:
    """Columns and their units; the last holds remarks and has no name."""
    parameters = ["m", "p", "Γ_y", "Γ_u", *(["φ_r"] if _filtered(surface) else [])]
    results = [("SSE", "(mg/dl)²"), ("Undershoot", "mg/dl"), ("Settling, 2 %", "min"), ("Travel", "mU/min")]
    return [("Rank", ""), *((name, "") for name in parameters), *results, ("", "")]


def tuning_rows(surface: TuningSurface, printed: TuningRank, top: int) -> Iterator[TuningRow]:
    """The best tunings in order, and the printed one at its place.

    Parameters
    ----------
    surface : TuningSurface
    printed : TuningRank
        The paper's tuning, as `TuningSurface.rank_of` finds it.
    top : int
        Number of tunings that are shown, in addition to the printed one.
    """
    order = surface.order().tolist()
    here = order.index(surface.index(printed.tuning))
    for point in order[:top]:
        yield TuningRow(point, False, _cells(surface, point, printed))
    if here >= top:
        yield TuningRow(order[here], True, _cells(surface, order[here], printed))


def remarks(surface: TuningSurface, point: int) -> Iterator[str]:
    """Reasons why a tuning is not acceptable."""
    if not surface.feasible[point]:
        yield "breaks a constraint"
    if surface.oscillates[point]:
        yield "oscillates"


def _filtered(surface: TuningSurface) -> bool:
    return "reference_filter" in surface.columns()


def _cells(surface: TuningSurface, point: int, printed: TuningRank) -> tuple[str, ...]:
    tuning = surface.tunings[point]
    rank = surface.rank_of(tuning).rank
    parameters = [tuning.move_horizon, tuning.prediction_horizon, tuning.output_weight, tuning.move_weight]
    return (
        "-" if rank is None else str(rank),
        *(f"{value:g}" for value in parameters),
        *([f"{getattr(tuning, 'reference_filter', 0.0):g}"] if _filtered(surface) else []),
        f"{surface.sse[point]:.1f}",
        f"{surface.undershoot_mg_dl[point]:.1f}",
        f"{surface.settling_2pct_min[point]:.0f}{'' if surface.settled_2pct[point] else '+'}",
        f"{surface.insulin_total_variation_mU_min[point]:.0f}",
        ", ".join([*([printed.called] if tuning == printed.tuning else []), *remarks(surface, point)]),
    )
