"""Output of a whole stress test: rows, reasons, table files, figure and page."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import polars as pl

from glucoloop.cohorts.engine import prepare
from glucoloop.report.facts import controllers_facts, engine_facts, trial_facts
from glucoloop.report.print_figure import figure_files
from glucoloop.storage.resumable import Work
from glucoloop.storage.strict_json import json_text, with_version
from glucoloop.storage.tables import csv, parquet
from glucoloop.storage.trials.folder import TrialFolder
from glucoloop.studies.stress._words import left_out
from glucoloop.studies.stress.figure import plot_stress
from glucoloop.studies.stress.keys import StressTest
from glucoloop.studies.stress.page import stress_page
from glucoloop.studies.stress.reasons import reason_of
from glucoloop.studies.stress.stress import Reason, StressResult, StressRow, Tried, stress_rows

SUMMARY: Final = "summary.json"
FINAL: Final = ("stress.csv", "stress.parquet", SUMMARY, "stress.html", "figure.pdf", "figure.png", "figure.svg")
"""Files that are written when all shards are done."""


def work_of(asked: StressTest) -> Work:
    """Work of ``glucoloop stress``, which is kept in the folder of a trial."""
    return Work(command="stress", what="trial", keys=asked.keys(), given=asked.given, final=FINAL, summary=SUMMARY)


def result_of(asked: StressTest, folder: TrialFolder) -> StressResult:
    """Results of a test whose shards are done."""
    rows = stress_rows(asked.stress, folder.people())
    prepared = prepare(asked.stress.trial)
    reasons = [reason_of(prepared, row) for row in rows if row.tried.guarded and not row.stands]
    facts = {**controllers_facts(asked.base.cases), **trial_facts(asked.base), **engine_facts(prepared.engines)}
    return _result(asked, folder, rows, reasons, facts)


def told_before(asked: StressTest, folder: TrialFolder) -> StressResult:
    """Results of a finished test, with its reasons read from its files."""
    rows = stress_rows(asked.stress, folder.people())
    reasons = [
        Reason(
            tried=Tried(controller=of["controller"], guarded=True, fault=of["fault"]),
            person=of["person"],
            more_pct=of["more_pct"],
            text=of["text"],
        )
        for of in folder.summary()["reasons"]
    ]
    return _result(asked, folder, rows, reasons, folder.summary()["facts"])


def _result(
    asked: StressTest,
    folder: TrialFolder,
    rows: Sequence[StressRow],
    reasons: Sequence[Reason],
    facts: Mapping[str, str],
) -> StressResult:
    # who has a basal rate does not depend on the cell
    able = sum(int(next(iter(shard.values())).feasible.sum()) for shard in folder.people())
    return StressResult(
        rows=tuple(rows),
        reasons=tuple(reasons),
        facts=facts,
        repeat="stress --config stress.toml",
        keys=asked.keys(),
        given=asked.given,
        able=able,
        infeasible=asked.base.people - able,
    )


def files_of(result: StressResult) -> dict[str, bytes]:
    """The files about the whole test, by name."""
    table = pl.DataFrame([_flat(row) for row in result.rows])
    return {
        "stress.csv": csv(table),
        "stress.parquet": parquet(table),
        SUMMARY: (json_text(with_version(summary_of(result))) + "\n").encode(),
        "stress.html": stress_page(result).encode(),
        **figure_files("figure", plot_stress(result)),
    }


def summary_of(result: StressResult) -> dict[str, Any]:
    """Plain values for JSON."""
    return {
        "facts": dict(result.facts),
        **({} if result.able is None else {"people": result.able + result.infeasible, "able": result.able}),
        "rows": [{**_flat(row), "worse": list(row.worse)} for row in result.rows],
        "reasons": [
            {
                "controller": reason.tried.controller,
                "fault": reason.tried.fault,
                "person": reason.person,
                "more_pct": reason.more_pct,
                "text": reason.text,
            }
            for reason in result.reasons
        ],
        "repeat": f"glucoloop {result.repeat} --out again",
    }


def _flat(row: StressRow) -> Mapping[str, Any]:
    """A row as plain columns."""
    own = {field.name: getattr(row, field.name) for field in dataclasses.fields(row) if field.name != "tried"}
    if row.lowest_mg_dl < 0.0:  # no concentration: the valid range of the model ended above it
        own["lowest_mg_dl"] = None
    cell = {"controller": row.tried.controller, "guarded": row.tried.guarded, "fault": row.tried.fault}
    return {**cell, **own, "worse": len(row.worse), "worse_people": " ".join(map(str, row.worse))}


def verdict(result: StressResult) -> Iterator[str]:
    """Sentences on the people for whom a fault did more harm than allowed with the guard, and the reasons."""
    yield from left_out(result)
    guarded = [row for row in result.rows if row.tried.guarded and row.tried.fault and row.people]
    if not guarded:
        return
    broken = [row for row in guarded if not row.stands]
    yield (
        f"With the guard, in {len(guarded) - len(broken)} of {len(guarded)} combinations of a controller and a fault "
        "nobody spent more than 1 % more of the time below 60 mg/dl than without the fault."
    )
    not_valid = [row for row in result.rows if row.people_below_validity]
    if not_valid:
        most = max(not_valid, key=lambda row: row.people_below_validity)
        yield (
            f"In {len(not_valid)} of {len(result.rows)} combinations glucose fell below the valid range of the "
            f"patient's model, for at most {most.people_below_validity} of {most.people} people ({most.tried.label}). "
            "Read it as severe hypoglycemia; its depth means nothing."
        )
    for reason in result.reasons:
        more = f"{reason.more_pct:.1f} % more of the time below 60 mg/dl"
        yield f"{reason.tried.label}: person {reason.person}, {more}. {reason.text}"
