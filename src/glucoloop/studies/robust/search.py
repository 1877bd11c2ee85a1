"""Search for a tuning that is robust to people and noise, and its result on subjects that it never saw.

Of an objective less is better. Of the tunings that keep the bounds, those that no other beats in both objectives are
the Pareto front, of which one is chosen.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.component.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, decimals
from glucoloop.reporting.descriptions import engine_facts
from glucoloop.situations.case import Case
from glucoloop.storage.results import Results
from glucoloop.storage.rows import Rows
from glucoloop.studies.robust import BOTH, ROBUST, Search
from glucoloop.studies.robust.tuning_loop import TuningLoop, draw_subjects
from glucoloop.text import how_many
from glucoloop.tuning.samplers import Evaluated

CHOSEN: Final = "chosen"
AS_IT_WAS: Final = "as it was"
_MAX_CANDIDATES: Final = 1_000_000
_LARGEST_SCORE: Final = 1e9
"""Magnitude that no objective of a run reaches."""
Candidate = dict[str, Any]
"""A tuning that was tried, as a row: its number, its round, the tuned numbers, and its scores."""
_LOW_MG_DL: Final = 60.0


def _objective(name: str, head: str, short: str, digits: int = 1) -> Column:
    return Column(name=name, head=head, short=short, text=decimals(digits))


OBJECTIVES: Final = {
    "undershoot-median": _objective("undershoot_median_mg_dl", "Undershoot, median (mg/dl)", "Undershoot\nmedian"),
    "undershoot-p95": _objective(
        "undershoot_p95_mg_dl", "Undershoot, 95th percentile (mg/dl)", "Undershoot\n95th pct."
    ),
    "peak-median": _objective("peak_median_mg_dl", "Peak, median (mg/dl)", "Peak\nmedian"),
    "peak-p95": _objective("peak_p95_mg_dl", "Peak, 95th percentile (mg/dl)", "Peak\n95th pct."),
    "people-undershoot-p95": _objective(
        "people_undershoot_p95_mg_dl",
        "Undershoot of people, 95th percentile (mg/dl)",
        "People's under-\nshoot, 95th pct.",
    ),
    "people-peak-p95": _objective(
        "people_peak_p95_mg_dl", "Peak of people, 95th percentile (mg/dl)", "People's peak,\n95th pct."
    ),
    "people-below-60": _objective("people_below_60", "People below 60 mg/dl", "People\n< 60", digits=0),
    "total-variation": _objective(
        "total_variation_mU_min", "Total variation of insulin, median (mU/min)", "Travel\nmU/min", digits=0
    ),
}
"""Objectives by the names that users write; they are about the nominal patient under noise unless it says people."""

Scores = Mapping[str, float]
"""The objectives of a controller by the names of their columns; NaN where a run had no finite number."""
NO_SCORES: Final[Scores] = {objective.name: float("nan") for objective in OBJECTIVES.values()}


def objective(name: str) -> Column:
    """An objective by the name that users write; Refusal for an unknown one."""
    if name not in OBJECTIVES:
        raise Refusal(f"unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    return OBJECTIVES[name]


def scores(metrics: Mapping[str, npt.NDArray[Any]], people: int) -> Scores:
    """The objectives from values ``(subjects,)`` of each of `METRICS`; 95th percentiles are interpolated.

    The first `people` of the subjects are people, and the others are the nominal patient under noise.
    """
    undershoot, peak = metrics["undershoot_mg_dl"], metrics["peak_mg_dl"]
    lowest, variation = metrics["minimum_mg_dl"], metrics["insulin_total_variation_mU_min"]
    of_people, nominal = slice(None, people), slice(people, None)
    finite = bool(np.isfinite(lowest[of_people]).all())
    return {
        "undershoot_median_mg_dl": float(np.median(undershoot[nominal])),
        "undershoot_p95_mg_dl": float(np.quantile(undershoot[nominal], 0.95)),
        "peak_median_mg_dl": float(np.median(peak[nominal])),
        "peak_p95_mg_dl": float(np.quantile(peak[nominal], 0.95)),
        "people_undershoot_p95_mg_dl": float(np.quantile(undershoot[of_people], 0.95)),
        "people_peak_p95_mg_dl": float(np.quantile(peak[of_people], 0.95)),
        "people_below_60": float((lowest[of_people] < _LOW_MG_DL).sum()) if finite else float("nan"),
        "total_variation_mU_min": float(np.median(variation[nominal])),
    }


@dataclass(frozen=True)
class _Bound:
    """A bound on an objective."""

    objective: str
    most: float
    controller: str | None = None
    """Controller whose value is the bound, or None for a given number."""

    def violation(self, scores: Any) -> Any:
        """Relative excess of scores, or of columns of them, over the bound; 0 or less where it is kept."""
        return (scores[OBJECTIVES[self.objective].name] - self.most) / max(abs(self.most), 1.0)


def _judged(
    candidates: pl.DataFrame, bounds: Sequence[_Bound], objectives: Sequence[str], prefer: str = BOTH
) -> pl.DataFrame:
    """Tunings that were tried, with columns for those that keep the bounds, those on the front, and the chosen one.

    If none keeps the bounds, the one that exceeds them by the smallest amount is chosen; Refusal if none has a
    controller.
    """
    values = candidates.select(OBJECTIVES[name].name for name in objectives).to_numpy()
    finite = np.isfinite(values).all(axis=1)
    if not finite.any():
        raise Refusal("no tuning of the search has a controller that works; give other ranges")
    over = np.array([bound.violation(candidates).to_numpy() for bound in bounds]).reshape(-1, len(candidates))
    acceptable = finite & np.all(over <= 0.0, axis=0)
    front = np.zeros(len(candidates), bool)
    if acceptable.any():
        front[acceptable] = _pareto(values[acceptable])
        chosen = np.flatnonzero(front)[_choose(values[front], objectives, prefer)]
    else:
        excess = np.maximum(over, 0.0).sum(axis=0)
        chosen = np.argmin(np.where(finite & np.isfinite(excess), excess, np.inf))
    return candidates.with_columns(
        pl.Series("keeps_the_bounds", acceptable),
        pl.Series("on_the_front", front),
        pl.Series("chosen", np.arange(len(candidates)) == chosen),
    )


def _pareto(values: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Whether each row of ``(n, 2)`` is on the Pareto front: no row is better in one column and as good in both."""
    order = np.lexsort((values[:, 1], values[:, 0]))
    front = np.zeros(len(values), bool)
    least, at = np.inf, np.inf
    for place in order:
        first, second = values[place]
        if second < least or (second == least and first == at):
            front[place] = True
            least, at = second, first
    return front


def _choose(values: npt.NDArray[np.float64], objectives: Sequence[str], prefer: str) -> int:
    """Index of the row of a front ``(n, 2)`` that is chosen.

    It has the minimum value of the preferred objective; or, for ``"both"``, it is nearest to the minimum of both, each
    measured by its range over the front.
    """
    if prefer in objectives:
        first = list(objectives).index(prefer)
        return int(np.lexsort((values[:, 1 - first], values[:, first]))[0])
    least, reach = values.min(axis=0), np.ptp(values, axis=0)
    away = (values - least) / np.where(reach > 0.0, reach, 1.0)
    return int(np.argmin(np.hypot(away[:, 0], away[:, 1])))


def _tuning_of(config: Search, candidate: Candidate) -> dict[str, float]:
    """The tuned numbers of a candidate."""
    return {setting.name: candidate[setting.name] for setting in config.space}


def rows_of(config: Search) -> Rows[Candidate]:
    """The rows that are kept."""
    numbers = [*(setting.name for setting in config.space), *NO_SCORES]

    def row(cells: Mapping[str, Any], before: Sequence[Candidate]) -> Candidate:
        if cells["candidate"] != len(before):
            raise Refusal("the candidates are not in their order")
        for setting in config.space:
            if cells[setting.name] is None or not setting.holds(cells[setting.name]):
                raise Refusal(
                    f"candidate {cells['candidate']} has {setting.name} {cells[setting.name]}, and the search is from "
                    f"{setting.low:g} to {setting.high:g}"
                )
        for name in NO_SCORES:
            if cells[name] is not None and not abs(cells[name]) <= _LARGEST_SCORE:
                raise Refusal(f"candidate {cells['candidate']} has {name} {cells[name]:g}, which no run has")
        return {name: float("nan") if cell is None else cell for name, cell in cells.items()}

    return Rows(
        file=ROBUST.results,
        what="candidates",
        wanted=config.rounds * config.batch,
        most=_MAX_CANDIDATES,
        schema={"candidate": pl.Int64, "round": pl.Int64, **dict.fromkeys(numbers, pl.Float64)},
        cells=dict,
        row=row,
    )


class SearchEngine:
    """A search that was prepared: its people are drawn, and the reference controllers tried.

    Loops are compiled when they are first needed; Refusal if one cannot be closed.
    """

    def __init__(self, config: Search) -> None:
        self.config = config
        self.subjects = draw_subjects(
            config.trial, config.people, config.people_seed, seeds=config.seeds, first_seed=config.first_seed
        )
        self._loops: dict[str, TuningLoop] = {}
        self.references = {
            case.label: self._scores(next(self._loop(case).run(self.subjects))) for case in config.trial.cases[1:]
        }
        """Scores of the reference controllers, by label."""
        self.bounds = [
            _Bound(name, self.references[most][OBJECTIVES[name].name], most)
            if isinstance(most, str)
            else _Bound(name, most)
            for name, most in config.bounds
        ]

    def missing(self, before: Sequence[Candidate]) -> Iterator[Candidate]:
        """Yield the candidates that are still missing, each as soon as it is known.

        Refusal for a sampler that asks for other tunings than it did before.
        """
        config, rows = self.config, list(before)
        start = None
        if all(setting.holds(config.initial[setting.name]) for setting in config.space):
            start = {setting.name: setting.rounded(config.initial[setting.name]) for setting in config.space}
        sampler = config.sampler.made(space=config.space, batch=config.batch, start=start)
        for first in range(0, config.rounds * config.batch, config.batch):
            tunings = sampler.ask(config.batch)
            stored = rows[first : first + config.batch]
            for candidate, tuning in zip(stored, tunings, strict=False):
                if _tuning_of(config, candidate) != tuning:
                    raise Refusal(
                        f"candidate {candidate['candidate']} of the search was another tuning than "
                        f"{config.sampler.display_name} proposes now; go on with the libraries with which it was "
                        "begun, or begin again with --overwrite"
                    )
            todo = tunings[len(stored) :]
            runs = self._loop(config.tuned).run(self.subjects, todo) if todo else ()
            for tuning, metrics in zip(todo, runs, strict=True):
                place = {"candidate": len(rows), "round": first // config.batch}
                rows.append({**place, **tuning, **self._scores(metrics)})
                yield rows[-1]
            sampler.tell([self._outcome(candidate) for candidate in rows[first : first + config.batch]])

    def results_of(self, rows: Sequence[Candidate]) -> Results:
        """Choose a tuning, and check it."""
        config = self.config
        table = _judged(rows_of(config).table(rows), self.bounds, config.objectives, config.prefer)
        acceptable, front = table.filter("keeps_the_bounds"), table.filter("on_the_front")
        front = front.sort(OBJECTIVES[config.objectives[0]].name, maintain_order=True)
        chosen = table.row(by_predicate=pl.col("chosen"), named=True)
        check, scores_of_check = self.check(_tuning_of(config, chosen))
        left, people = self.subjects.infeasible, how_many(config.people, "person", "people")
        has, was = ("has", "was") if left == 1 else ("have", "were")
        left_out = [f"{left} of {people} {has} no basal rate and {was} left out."] if left else []
        plain = {
            "config": config.tree(whole=True),
            "candidates": len(table),
            "keeping_the_bounds": len(acceptable),
            "bounds": [{"objective": b.objective, "at_most": b.most, "of": b.controller} for b in self.bounds],
            "chosen": {**self._plain(chosen), "keeps_the_bounds": chosen["keeps_the_bounds"]},
            "front": [self._plain(row) for row in front.to_dicts()],
            "as_it_was": self._plain(rows[0]) if _tuning_of(config, rows[0]) == config.initial else None,
            "beside": self.references,
            "check": scores_of_check,
            "engines": (engines := {label: loop.engine_facts for label, loop in self._loops.items()}),
            "notes": [*left_out, f"Engine: {engine_facts(engines)['Engine']}."],
        }
        return Results(plain, {"candidates.csv": table, "check.parquet": check})

    def check(self, tuning: Mapping[str, float]) -> tuple[pl.DataFrame, dict[str, Scores]]:
        """The chosen, the initial and the reference tunings on subjects outside the search: each subject, and scores.

        A tuning that the design refuses is left out.
        """
        config = self.config
        subjects = draw_subjects(
            config.trial,
            config.check_people,
            config.check_people_seed,
            seeds=config.check_seeds,
            first_seed=config.check_first_seed,
        )
        runs = dict(
            zip((CHOSEN, AS_IT_WAS), self._loop(config.tuned).run(subjects, [tuning, config.initial]), strict=True)
        )
        runs |= {case.label: next(self._loop(case).run(subjects)) for case in config.trial.cases[1:]}
        done = {label: metrics for label, metrics in runs.items() if metrics is not None}
        group = np.where(np.arange(subjects.number) < subjects.people, "people", "noise")
        table = pl.concat(
            pl.DataFrame(
                {
                    "controller": label,
                    "group": group,
                    "undershoot_mg_dl": metrics["undershoot_mg_dl"],
                    "peak_mg_dl": metrics["peak_mg_dl"],
                    "total_variation_mU_min": metrics["insulin_total_variation_mU_min"],
                }
            )
            for label, metrics in done.items()
        )
        return table, {label: scores(metrics, subjects.people) for label, metrics in done.items()}

    def _loop(self, case: Case) -> TuningLoop:
        if case.label not in self._loops:
            space = self.config.space if case.label == self.config.tuned.label else ()
            self._loops[case.label] = TuningLoop(self.config.trial, case, space, self.subjects)
        return self._loops[case.label]

    def _scores(self, metrics: Mapping[str, npt.NDArray[Any]] | None) -> Scores:
        return NO_SCORES if metrics is None else scores(metrics, self.subjects.people)

    def _plain(self, row: Candidate) -> dict[str, Any]:
        scores = {name: row[name] for name in NO_SCORES}
        return {"candidate": row["candidate"], "tuning": _tuning_of(self.config, row), "scores": scores}

    def _outcome(self, candidate: Candidate) -> Evaluated:
        return Evaluated(
            values=tuple(candidate[OBJECTIVES[name].name] for name in self.config.objectives),
            violation=tuple(float(np.nan_to_num(bound.violation(candidate), nan=1e9)) for bound in self.bounds),
        )
