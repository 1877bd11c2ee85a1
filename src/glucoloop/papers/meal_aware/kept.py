"""Runs of a comparison in a folder: those of a controller in a situation are kept as soon as they are done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import jax.numpy as jnp
import numpy as np
import polars as pl

from glucoloop.config.key import plain
from glucoloop.papers.meal_aware.experiments import ControllerRuns
from glucoloop.papers.meal_aware.measures import AT_SAMPLES, MEASURES
from glucoloop.papers.meal_aware.mismatched_loops import MismatchRuns
from glucoloop.papers.meal_aware.options import ClaimsKeys
from glucoloop.papers.meal_aware.situations import HORIZON_MIN, mismatches_of, situations_of
from glucoloop.refusal import Refusal
from glucoloop.report.print_figure import KINDS
from glucoloop.storage.resumable import Work
from glucoloop.storage.rows import Rows
from glucoloop.tuning.oscillation import Oscillation

SUMMARY: Final = "claims.json"
TIMING: Final = "timing.json"
_TABLES: Final = ("claims.csv", "claims.html", "numbers.csv", "runs.csv")
_NUMBERS: Final = tuple(dict.fromkeys(measure.name for measure in (*MEASURES, *AT_SAMPLES)))
_COURSES: Final = ("t_min", "glucose_mg_dl", "insulin_t_min", "insulin_mU_min")
_SCHEMA: Final[dict[str, Any]] = {
    "situation": pl.String,
    "controller": pl.String,
    "infeasible": pl.Int64,
    "setpoint_mg_dl": pl.Float64,
    "crossings": pl.Int64,
    "turns": pl.Int64,
    "oscillates": pl.Boolean,
    "run": pl.List(pl.Int64),
    **dict.fromkeys((*_COURSES, *_NUMBERS), pl.List(pl.Float64)),
}
_LONGEST_NAMES: Final = 1000
"""Characters of the names of a situation and of a controller."""
_BETWEEN_S: Final = 10.0
"""Time between two writings of the runs, which may be some tens of megabytes."""


class KeptRuns(NamedTuple):
    """Runs of a controller in a situation."""

    situation: str
    controller: str
    runs: ControllerRuns | MismatchRuns


def work_of(asked: ClaimsKeys) -> Work:
    """Work of ``glucoloop claims``."""
    figures = (f"{situation.name}.{kind}" for situation in situations_of(asked) for kind in KINDS)
    timing = () if asked.only else (TIMING,)
    return Work(
        command="claims",
        what="comparison",
        keys=plain(asked),
        final=(*_TABLES, *timing, *figures, SUMMARY),
        summary=SUMMARY,
    )


def rows_of(asked: ClaimsKeys, controllers: Sequence[str]) -> Rows[KeptRuns]:
    """Rows that are kept: the runs of each controller in each situation."""
    alone = [situation.name for situation in situations_of(asked)]
    wanted = {(name, one) for name in (*alone, *(row.name for row in mismatches_of(asked))) for one in controllers}

    def row(cells: Mapping[str, Any], before: Sequence[KeptRuns]) -> KeptRuns:
        case = cells["situation"], cells["controller"]
        if case not in wanted or any(case == (of.situation, of.controller) for of in before):
            raise Refusal("these runs are not asked for")
        return KeptRuns(*case, _loops(cells) if case[0] in alone else _mismatched(cells))

    return Rows(
        file="loops.parquet",
        what="pairs of situation and controller",
        wanted=len(wanted),
        most=len(wanted),
        schema=_SCHEMA,
        cells=_cells,
        row=row,
        width=len(_SCHEMA) * (int(HORIZON_MIN) + 1) * max(asked.seeds, asked.people),
        longest_text=_LONGEST_NAMES,
        every_s=_BETWEEN_S,
    )


def loops_in(rows: Sequence[KeptRuns]) -> int:
    """Number of loops of the kept runs."""
    return sum(int(of.runs.run.size) + of.runs.infeasible for of in rows)


def _cells(kept: KeptRuns) -> dict[str, Any]:
    runs = kept.runs
    cells = {"situation": kept.situation, "controller": kept.controller, "infeasible": runs.infeasible}
    lists: dict[str, Any] = {"run": runs.run, **runs.numbers}
    if isinstance(runs, ControllerRuns):
        cells["setpoint_mg_dl"] = runs.setpoint_mg_dl
        lists |= {name: getattr(runs, name) for name in _COURSES}
        if runs.quiet is not None:
            cells |= {
                name: np.asarray(getattr(runs.quiet, name)).item() for name in ("crossings", "turns", "oscillates")
            }
    return cells | {name: pl.Series(np.ravel(values)) for name, values in lists.items()}


def _mismatched(cells: Mapping[str, Any]) -> MismatchRuns:
    run = np.asarray(cells["run"], np.int64)
    numbers = {measure.name: _floats(cells[measure.name], run.size) for measure in AT_SAMPLES}
    return MismatchRuns(run=run, numbers=numbers, infeasible=cells["infeasible"])


def _loops(cells: Mapping[str, Any]) -> ControllerRuns:
    run = np.asarray(cells["run"], np.int64)
    t_min, insulin_t_min = (np.asarray(cells[name], float) for name in ("t_min", "insulin_t_min"))
    quiet = None
    if cells["turns"] is not None:
        crossings, turns, oscillates = (jnp.asarray(cells[name]) for name in ("crossings", "turns", "oscillates"))
        quiet = Oscillation(crossings=crossings, turns=turns, oscillates=oscillates)
    return ControllerRuns(
        run=run,
        numbers={measure.name: _floats(cells[measure.name], run.size) for measure in MEASURES},
        t_min=t_min,
        glucose_mg_dl=_floats(cells["glucose_mg_dl"], t_min.size, run.size),
        insulin_t_min=insulin_t_min,
        insulin_mU_min=_floats(cells["insulin_mU_min"], insulin_t_min.size, run.size),
        setpoint_mg_dl=cells["setpoint_mg_dl"],
        infeasible=cells["infeasible"],
        quiet=quiet,
    )


def _floats(values: Sequence[float], *shape: int) -> Any:
    return np.asarray(values, float).reshape(shape)
