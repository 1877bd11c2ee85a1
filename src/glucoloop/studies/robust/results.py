"""Results of a search: texts and files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from glucoloop.printable import how_many
from glucoloop.report.print_figure import figure_files
from glucoloop.situations.toml import toml_text
from glucoloop.storage.strict_json import json_text, with_version
from glucoloop.storage.tables import csv, parquet
from glucoloop.studies.robust.figure import plot_robust
from glucoloop.studies.robust.front import Bound
from glucoloop.studies.robust.keys import Robust
from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.search import Candidate, Checked, Judgement, SearchEngine, judge
from glucoloop.studies.robust.work import rows_of


@dataclass(frozen=True)
class Found:
    """Results of a search."""

    candidates: Sequence[Candidate]
    references: Mapping[str, Mapping[str, float]]
    """Scores of the reference controllers."""
    bounds: Sequence[Bound]
    verdict: Judgement
    checked: Sequence[Checked]

    @property
    def chosen(self) -> Candidate:
        """The tuning that was chosen."""
        return self.candidates[self.verdict.chosen]


def found_of(
    asked: Robust,
    candidates: Sequence[Candidate],
    references: Mapping[str, Mapping[str, float]],
    bounds: Sequence[Bound],
    engine: SearchEngine,
) -> Found:
    """Choose a tuning and check it."""
    verdict = judge(asked.search, bounds, candidates, asked.far.prefer)
    checked = engine.check(candidates[verdict.chosen].tuning)
    return Found(candidates=candidates, references=references, bounds=bounds, verdict=verdict, checked=checked)


def found_before(asked: Robust, candidates: Sequence[Candidate], told: Mapping[str, Any]) -> Found:
    """Results of a finished search, from its candidates and its summary."""
    bounds = [Bound(of["objective"], of["at_most"], of["of"]) for of in told["bounds"]]
    none = np.zeros(0)
    return Found(
        candidates=candidates,
        references={label: _numbers(scores) for label, scores in told["beside"].items()},
        bounds=bounds,
        verdict=judge(asked.search, bounds, candidates, asked.far.prefer),
        checked=[Checked(label, _numbers(scores), none, none, none, 0) for label, scores in told["check"].items()],
    )


def summary_of(asked: Robust, found: Found) -> dict[str, Any]:
    """Plain values for JSON."""
    front = [found.candidates[place] for place in np.flatnonzero(found.verdict.front).tolist()]
    front.sort(key=lambda of: of.scores[asked.search.objectives[0]])
    return {
        "config": asked.keys(),
        "candidates": len(found.candidates),
        "keeping_the_bounds": int(found.verdict.keeps.sum()),
        "bounds": [{"objective": b.objective, "at_most": b.most, "of": b.of} for b in found.bounds],
        "chosen": {**_candidate(found.chosen), "keeps_the_bounds": found.verdict.bounded},
        "front": [_candidate(of) for of in front],
        "beside": {label: _plain(scores) for label, scores in found.references.items()},
        "check": {of.label: _plain(of.scores) for of in found.checked},
    }


def files_of(asked: Robust, found: Found) -> dict[str, bytes]:
    """The files about the whole search, by name."""
    search = asked.search
    table = (
        rows_of(search, asked.far.rounds)
        .table(found.candidates)
        .with_columns(
            pl.Series("keeps_the_bounds", found.verdict.keeps),
            pl.Series("on_the_front", found.verdict.front),
            pl.Series("chosen", np.arange(len(found.candidates)) == found.verdict.chosen),
        )
    )
    figure = plot_robust(
        search, found.candidates, found.verdict, found.bounds, found.references, found.checked, title=_title(asked)
    )
    best = asked.run_of(search.tuned(found.chosen.tuning)).keys()
    return {
        "best.toml": toml_text(best, "run --config best.toml").encode(),
        "candidates.csv": csv(table),
        "check.parquet": parquet(_check_table(found.checked)),
        **figure_files("front", figure),
        "robust.json": (json_text(with_version(summary_of(asked, found))) + "\n").encode(),
    }


def sentences(asked: Robust, found: Found) -> Iterator[str]:
    """Conclusions from the tables, one sentence each."""
    verdict, objectives = found.verdict, asked.search.objectives
    for bound in found.bounds:
        whose = "" if bound.of is None else f", what {bound.of} comes to"
        yield f"Bound: {bound.objective} at most {bound.most:.4g}{whose}."
    tried, kept = how_many(len(found.candidates), "tuning"), int(verdict.keeps.sum())
    told = f"Of {tried} {how_many(kept, 'keeps', 'keep')} the bounds"
    if not verdict.bounded:
        yield f"{told}; chosen is the one that exceeds them least, candidate {found.chosen.number}."
        return
    preferred = f"the least of {asked.far.prefer}" if asked.far.prefer in objectives else "nearest to the least of both"
    front = f"{how_many(int(verdict.front.sum()), 'makes', 'make')} the front of {' and '.join(objectives)}"
    yield (
        f"{f'{told}, and {front}' if found.bounds else f'Of {tried} {front}'}; "
        f"chosen is candidate {found.chosen.number}, {preferred}."
    )


def _title(asked: Robust) -> str:
    own, search = asked.own, asked.search
    tunings, people = how_many(asked.far.rounds * search.batch, "tuning"), how_many(own.people, "person", "people")
    return (
        f"{search.case.label}: {tunings}, {people} of {search.trial.population.name} and {how_many(own.seeds, 'seed')} "
        f"of noise {search.trial.noise_variance:g} (mg/dl)²"
    )


def _check_table(checked: Sequence[Checked]) -> pl.DataFrame:
    """Table with one row per subject and controller."""
    return pl.concat(
        pl.DataFrame(
            {
                "controller": [of.label] * of.undershoot_mg_dl.size,
                "group": ["people"] * of.people + ["noise"] * (of.undershoot_mg_dl.size - of.people),
                "undershoot_mg_dl": of.undershoot_mg_dl,
                "peak_mg_dl": of.peak_mg_dl,
                "total_variation_mU_min": of.total_variation_mU_min,
            }
        )
        for of in checked
    )


def _candidate(of: Candidate) -> dict[str, Any]:
    return {"candidate": of.number, "tuning": dict(of.tuning), "scores": _plain(of.scores)}


def _plain(scores: Mapping[str, float]) -> dict[str, float | None]:
    return {o.column: scores[name] if np.isfinite(scores[name]) else None for name, o in OBJECTIVES.items()}


def _numbers(plain: Mapping[str, float | None]) -> dict[str, float]:
    told = {name: plain[o.column] for name, o in OBJECTIVES.items()}
    return {name: float("nan") if value is None else value for name, value in told.items()}
