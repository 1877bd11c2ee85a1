"""The whole comparison: simulate, judge, draw and write."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import polars as pl

from glucoloop.papers.meal_aware.comparison import SHARES, Verdict, distances, spread, verdicts
from glucoloop.papers.meal_aware.experiments import (
    Case,
    ComparisonRuns,
    ControllerRuns,
    Progress,
    loops_to_close,
    study,
)
from glucoloop.papers.meal_aware.figures import draw
from glucoloop.papers.meal_aware.kept import SUMMARY, TIMING, KeptRuns, rows_of
from glucoloop.papers.meal_aware.mismatched_loops import MismatchRuns
from glucoloop.papers.meal_aware.options import ClaimsKeys
from glucoloop.papers.meal_aware.pages import page, report
from glucoloop.papers.meal_aware.situations import CONTROLLERS, OURS, mismatches_of, situations_of
from glucoloop.report.print_figure import figure_files
from glucoloop.storage.rows import Rows, RowsFolder
from glucoloop.storage.strict_json import json_text
from glucoloop.storage.tables import csv


def loops_of(asked: ClaimsKeys) -> int:
    """Number of loops that are simulated."""
    return loops_to_close(asked, situations_of(asked), CONTROLLERS, mismatches_of(asked))


def kept_rows(asked: ClaimsKeys) -> Rows[KeptRuns]:
    """Rows that the folder of a comparison keeps."""
    return rows_of(asked, CONTROLLERS)


def carry_out(
    asked: ClaimsKeys, *, progress: Progress, folder: RowsFolder[KeptRuns] | None = None
) -> tuple[ComparisonRuns, list[Verdict]]:
    """Simulate every loop and judge the claims.

    Parameters
    ----------
    asked : ClaimsKeys
    progress : callable
        Called with the number of loops that have just been simulated.
    folder : RowsFolder, optional
        Folder whose runs are not simulated again, and which keeps those that are.
    """
    kept: dict[Case, Any] = {} if folder is None else {(of.situation, of.controller): of.runs for of in folder.rows}

    def keep(situation: str, controller: str, runs: ControllerRuns | MismatchRuns) -> None:
        if folder is not None:
            folder.add(KeptRuns(situation, controller, runs))

    done = study(
        asked,
        situations_of(asked),
        controllers=CONTROLLERS,
        ours=OURS,
        rows=mismatches_of(asked),
        progress=progress,
        timed=not asked.only,
        kept=kept,
        keep=keep,
    )
    return done, verdicts(done)


def judged_before(asked: ClaimsKeys, rows: Sequence[KeptRuns]) -> list[Verdict]:
    """Result of each claim from the runs that a folder keeps."""
    alone, mismatches = situations_of(asked), mismatches_of(asked)
    runs: dict[str, dict[str, Any]] = {}
    for row in rows:
        runs.setdefault(row.situation, {})[row.controller] = row.runs
    return verdicts(
        ComparisonRuns(
            asked=asked,
            loops={of.name: runs[of.name] for of in alone},
            situations=tuple(alone),
            bounds={},
            step_ms={},
            ours=OURS,
            rows=tuple(mismatches),
            of_rows={of.name: runs[of.name] for of in mismatches},
        )
    )


def files_of(done: ComparisonRuns, judged: Sequence[Verdict]) -> dict[str, bytes]:
    """Tables, figures and page, by the name of the file.

    Parameters
    ----------
    done, judged
        Results of `carry_out`.
    """
    files: dict[str, bytes] = {}
    inline: dict[str, str] = {}
    for name, figure in draw(done).items():
        drawn = figure_files(name, figure)
        inline[name] = drawn[f"{name}.svg"].decode()
        files |= drawn
    files["claims.csv"] = csv(claims_table(judged))
    files["numbers.csv"] = csv(numbers_table(done))
    files["runs.csv"] = csv(runs_table(done))
    if done.step_ms:
        files[TIMING] = f"{json_text({'step_ms': dict(done.step_ms)})}\n".encode()
    files["claims.html"] = page(done, judged, inline).encode()
    files[SUMMARY] = f"{json_text(_with_version(report(done, judged)))}\n".encode()
    return files


def _with_version(told: dict[str, Any]) -> dict[str, Any]:
    import glucoloop

    return {"version": glucoloop.__version__, **told}


def claims_table(judged: Sequence[Verdict]) -> pl.DataFrame:
    """Table with one row per claim and the number of every controller."""
    return pl.DataFrame(
        [
            {
                "claim": verdict.claim.id,
                "situation": verdict.claim.situation,
                "what": verdict.claim.what,
                "unit": verdict.claim.unit,
                "kind": "at-least" if verdict.claim.at_least else "at-most",
                "bound": verdict.bound,
                "found": verdict.ours,
                "holds": verdict.holds,
                "runs": verdict.runs,
                **verdict.found,
            }
            for verdict in judged
        ]
    )


def numbers_table(done: ComparisonRuns) -> pl.DataFrame:
    """Table with one row per situation, controller and measure: median and 5 to 95 % of the runs."""
    rows = []
    for situation, controllers in done.runs.items():
        from_bound = distances(done, situation)
        for name, runs in controllers.items():
            found = spread(runs)
            if name in from_bound:
                found["distance_to_bound_mg_dl"] = from_bound[name]
            rows += [
                {
                    "situation": situation,
                    "controller": name,
                    "measure": measure,
                    "runs": int(runs.run.size),
                    **{share: shares[share] for share in SHARES},
                }
                for measure, shares in found.items()
            ]
    return pl.DataFrame(rows)


def runs_table(done: ComparisonRuns) -> pl.DataFrame:
    """Table with one row per run: its seed or person, and every measure."""
    tables = [
        pl.DataFrame({"run": runs.run, **runs.numbers}).select(
            pl.lit(situation).alias("situation"), pl.lit(name).alias("controller"), pl.all()
        )
        for situation, controllers in done.runs.items()
        for name, runs in controllers.items()
    ]
    return pl.concat(tables, how="diagonal")
