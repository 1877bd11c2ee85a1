"""The whole comparison: simulate, judge, draw and write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import polars as pl

from glucoloop.config.key import plain
from glucoloop.config.toml import toml_text
from glucoloop.papers.meal_aware.comparison import SHARES, Verdict, distances, spread, verdicts
from glucoloop.papers.meal_aware.experiments import ComparisonRuns, Progress, loops_to_close, study
from glucoloop.papers.meal_aware.figures import draw
from glucoloop.papers.meal_aware.options import ClaimsKeys
from glucoloop.papers.meal_aware.pages import REPEAT, page, report
from glucoloop.papers.meal_aware.situations import CONTROLLERS, OURS, mismatches_of, situations_of
from glucoloop.report.print_figure import KINDS, figure_bytes
from glucoloop.storage.strict_json import json_text
from glucoloop.storage.tables import csv

WriteFile = Callable[[str, bytes | str], None]


def loops_of(asked: ClaimsKeys) -> int:
    """Number of loops that are simulated."""
    return loops_to_close(asked, situations_of(asked), CONTROLLERS, mismatches_of(asked))


def carry_out(asked: ClaimsKeys, *, progress: Progress) -> tuple[ComparisonRuns, list[Verdict]]:
    """Simulate every loop and judge the claims.

    Parameters
    ----------
    asked : ClaimsKeys
    progress : callable
        Called with the number of loops that have just been simulated.
    """
    done = study(
        asked,
        situations_of(asked),
        controllers=CONTROLLERS,
        ours=OURS,
        rows=mismatches_of(asked),
        progress=progress,
        timed=not asked.only,
    )
    return done, verdicts(done)


def write(write_file: WriteFile, done: ComparisonRuns, judged: Sequence[Verdict]) -> None:
    """Write tables, figures, page, and the configuration that repeats the comparison.

    Parameters
    ----------
    write_file : callable
        Function that writes a file, given its name and content.
    done, judged
        Results of `carry_out`.
    """
    inline = {}
    for name, figure in draw(done).items():
        for kind in KINDS:
            data = figure_bytes(figure, kind)
            write_file(f"{name}.{kind}", data)
            if kind == "svg":
                inline[name] = data.decode()
    write_file("claims.csv", csv(claims_table(judged)))
    write_file("numbers.csv", csv(numbers_table(done)))
    write_file("runs.csv", csv(runs_table(done)))
    write_file("claims.json", json_text(_with_version(report(done, judged))) + "\n")
    if done.step_ms:
        write_file("timing.json", json_text({"step_ms": dict(done.step_ms)}) + "\n")
    write_file("claims.toml", toml_text(plain(done.asked), f"{REPEAT} --out again"))
    write_file("claims.html", page(done, judged, inline))


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
