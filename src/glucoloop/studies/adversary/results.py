"""Results of the searches for the worst errors: rows, files and sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import polars as pl

from glucoloop.control import Status
from glucoloop.report.print_figure import figure_files
from glucoloop.storage.strict_json import json_text, with_version
from glucoloop.storage.tables import csv, parquet
from glucoloop.studies.adversary.figure import plot_adversary
from glucoloop.studies.adversary.keys import Adversary
from glucoloop.studies.adversary.outcome import SearchOutcome


def row_of(asked: Adversary, of: SearchOutcome) -> dict[str, Any]:
    """Plain values about one search."""
    harm, worst = of.random.harm, of.worst
    return {
        "controller": of.cell.case.label,
        "guarded": of.cell.guarded,
        "error_pct": of.cell.error_pct,
        "below_54_min": worst.below_54_min,
        "lowest_mg_dl": worst.lowest_mg_dl,
        "peak_mg_dl": worst.peak_mg_dl,
        "stuck_from_min": [float(at) * asked.base.sample_time_min for at in worst.stuck_from],
        "sequences_tried": worst.tried,
        "random_people": int(of.random.person.size),
        "random_ever_below_54_pct": of.random.ever_below_54_pct,
        "random_lowest_mg_dl": float(harm.lowest_mg_dl.min()) if of.random.person.size else float("nan"),
        "lowest_without_errors_mg_dl": of.lowest_without_errors_mg_dl,
        "peak_without_errors_mg_dl": of.peak_without_errors_mg_dl,
        "engine": of.engine,
    }


def summary_of(asked: Adversary, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Plain values for JSON."""
    return {"config": asked.keys(), "searches": list(rows)}


def files_of(asked: Adversary, outcomes: Sequence[SearchOutcome], rows: Sequence[dict[str, Any]]) -> dict[str, bytes]:
    """The files about all searches, by name."""
    table = pl.DataFrame([{key: value for key, value in row.items() if key != "stuck_from_min"} for row in rows])
    glucose = pl.col("^.*lowest.*_mg_dl$")  # below 0 the model is not valid, and there is no number
    table = table.with_columns(pl.when(glucose >= 0.0).then(glucose))
    return {
        "adversary.csv": csv(table),
        "worst.parquet": parquet(trace_table(outcomes)),
        "adversary.json": (json_text(with_version(summary_of(asked, rows))) + "\n").encode(),
        **figure_files("worst", plot_adversary(outcomes, title=title_of(asked))),
    }


def trace_table(outcomes: Sequence[SearchOutcome]) -> pl.DataFrame:
    """The worst loops, one row per sample: glucose, reading, its error, insulin, and the status of the dose."""
    return pl.concat(
        pl.DataFrame(
            {
                "controller": [of.cell.case.label] * of.worst.errors.size,
                "guarded": [of.cell.guarded] * of.worst.errors.size,
                "error_pct": [of.cell.error_pct] * of.worst.errors.size,
                "t_min": of.worst.lane.t_min[:-1],
                "glucose_mg_dl": of.worst.lane.glucose_mg_dl[:-1],
                "reading_mg_dl": of.worst.lane.reading_mg_dl,
                "error_of_reading_pct": 100.0 * of.worst.errors,
                "insulin_mU_min": of.worst.lane.insulin_mU_min,
                "status": [Status(code).name.lower().replace("_", " ") for code in of.worst.lane.status.tolist()],
            }
        )
        for of in outcomes
    )


def title_of(asked: Adversary) -> str:
    """Title of a search, in one line."""
    own = asked.own
    who = "the nominal patient" if own.person is None else f"person {own.person} of {asked.base.population.name}"
    stuck = f", {own.stuck_times} stretches of {own.stuck_min:g} min stuck" if own.stuck_times else ""
    return f"The worst errors found for {who}: each held for {own.hold_min:g} min{stuck}"


def sentences(asked: Adversary, rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Conclusions from the table, one sentence each."""
    tried = int(np.sum([row["sequences_tried"] for row in rows]))
    yield f"{title_of(asked)}; {tried} sequences were tried. Worse errors may exist: a search does not prove a bound."
    yield (
        f"Random errors: of the same size, drawn uniformly, on {rows[0]['random_people']} people of "
        f"{asked.base.population.name}."
    )
