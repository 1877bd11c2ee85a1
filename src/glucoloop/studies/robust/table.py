"""Tables of the tunings of a search, and of the chosen one compared with others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.search import AS_IT_WAS, CHOSEN, Candidate, Checked, Judgement, Search

if TYPE_CHECKING:
    from rich.table import Table

_HEADS: Final = {
    "undershoot-median": "Undershoot\nmedian",
    "undershoot-p95": "Undershoot\n95 %",
    "peak-median": "Peak\nmedian",
    "peak-p95": "Peak\n95 %",
    "people-undershoot-p95": "People's under-\nshoot, 95 %",
    "people-peak-p95": "People's\npeak, 95 %",
    "people-below-60": "People\n< 60",
    "total-variation": "Travel\nmU/min",
}
"""Headings of the columns; glucose is in mg/dl."""


def robust_table(
    search: Search,
    candidates: Sequence[Candidate],
    verdict: Judgement,
    references: Mapping[str, Mapping[str, float]],
    *,
    top: int = 10,
) -> Table:
    """The front, sorted by its first objective, with the initial tuning and the reference controllers.

    Parameters
    ----------
    search : Search
    candidates : sequence of Candidate
    verdict : Judgement
    references : mapping
        Scores of the reference controllers, by label.
    top : int
        Number of tunings of the front that are shown, evenly spread; the chosen one is always among them.

    Returns
    -------
    rich.table.Table
    """
    table = _table("", "Candidate", *(tuned.name for tuned in search.space))
    first = search.objectives[0]
    front = sorted(np.flatnonzero(verdict.front).tolist(), key=lambda place: candidates[place].scores[first])
    for place in _thinned(front, top, verdict.chosen):
        mark = CHOSEN if place == verdict.chosen else ""
        _add(table, mark, search, candidates[place])
    if candidates and dict(candidates[0].tuning) == search.start and verdict.chosen != 0:
        table.add_section()
        _add(table, AS_IT_WAS, search, candidates[0])
    if references:
        table.add_section()
    for label, scores in references.items():
        table.add_row(label, "", *([""] * len(search.space)), *_told(scores))
    return table


def check_table(checked: Sequence[Checked]) -> Table:
    """Results of controllers on subjects that the search never saw.

    Returns
    -------
    rich.table.Table
    """
    table = _table("Never seen before")
    for of in checked:
        table.add_row(of.label, *_told(of.scores))
    return table


def _table(*heads: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in heads:
        table.add_column(head.replace("_", "\n"), justify="left" if head in ("", heads[0]) else "right")
    for name in OBJECTIVES:
        table.add_column(_HEADS[name], justify="right")
    return table


def _add(table: Table, mark: str, search: Search, candidate: Candidate) -> None:
    tuning = [f"{candidate.tuning[of.name]:.4g}" for of in search.space]
    table.add_row(mark, str(candidate.number), *tuning, *_told(candidate.scores))


def _told(scores: Mapping[str, float]) -> list[str]:
    digits = {"people-below-60": 0, "total-variation": 0}
    return [f"{scores[name]:.{digits.get(name, 1)}f}" if np.isfinite(scores[name]) else "-" for name in OBJECTIVES]


def _thinned(front: Sequence[int], top: int, chosen: int) -> list[int]:
    """Indices of some tunings of the front, its ends and the chosen one among them."""
    if len(front) <= top:
        return list(front) if chosen in front else [*front, chosen]
    kept = {front[place] for place in np.unique(np.linspace(0, len(front) - 1, max(top - 1, 1)).round().astype(int))}
    return [place for place in front if place in kept or place == chosen]
