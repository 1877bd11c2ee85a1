"""Candidates of a search for a robust tuning, which are kept one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import polars as pl

from glucoloop.config.key import declared
from glucoloop.refusal import Refusal
from glucoloop.storage.resumable import Work
from glucoloop.storage.rows import Rows
from glucoloop.studies.robust.keys import Robust
from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.options import HowFar
from glucoloop.studies.robust.search import Candidate, Search

SUMMARY: Final = "robust.json"
FINAL: Final = ("best.toml", "candidates.csv", "check.parquet", "front.pdf", "front.png", "front.svg", SUMMARY)
"""Written when all rounds are done."""
_MOST_CANDIDATES: Final = 1_000_000


def work_of(asked: Robust) -> Work:
    """Work of ``glucoloop robust``, which may continue with more rounds."""
    return Work(
        command="robust",
        what="search",
        keys=asked.keys(),
        given=asked.given,
        final=FINAL,
        summary=SUMMARY,
        may_change=frozenset(declared(HowFar)),
    )


def rows_of(search: Search, rounds: int) -> Rows[Candidate]:
    """Rows that are kept: each candidate with its round, its tuning and its objectives."""
    tuned = [of.name for of in search.space]
    columns = {name: objective.column for name, objective in OBJECTIVES.items()}

    def cells(of: Candidate) -> dict[str, Any]:
        numbers = {"candidate": of.number, "round": of.number // search.batch}
        return {**numbers, **of.tuning, **{column: of.scores[name] for name, column in columns.items()}}

    def row(cells: Mapping[str, Any], before: Sequence[Candidate]) -> Candidate:
        if cells["candidate"] != len(before):
            raise Refusal("the candidates are not in their order")
        scores = {name: cells[column] for name, column in columns.items()}
        return Candidate(
            number=cells["candidate"],
            tuning={name: cells[name] for name in tuned},
            scores={name: float("nan") if value is None else value for name, value in scores.items()},
        )

    return Rows(
        file="candidates.parquet",
        what="candidates",
        wanted=rounds * search.batch,
        most=_MOST_CANDIDATES,
        schema={
            **dict.fromkeys(("candidate", "round"), pl.Int64),
            **dict.fromkeys((*tuned, *columns.values()), pl.Float64),
        },
        cells=cells,
        row=row,
    )
