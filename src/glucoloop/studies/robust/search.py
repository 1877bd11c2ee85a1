"""Search for a tuning that is robust to people and noise, and its result on subjects that it never saw."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.printable import how_many
from glucoloop.refusal import Refusal
from glucoloop.report.facts import engine_facts
from glucoloop.situations.case import Case
from glucoloop.storage.findings import Findings
from glucoloop.storage.rows import Rows
from glucoloop.studies.robust import Search
from glucoloop.studies.robust.loop import TuningLoop, draw_subjects
from glucoloop.studies.robust.objectives import NO_SCORES, OBJECTIVES, Bound, Scores, judged, scores
from glucoloop.tuning.samplers import Told, make_sampler

CHOSEN: Final = "chosen"
AS_IT_WAS: Final = "as it was"
_MOST_CANDIDATES: Final = 1_000_000
Candidate = dict[str, Any]
"""A tuning that was tried, as a row: its number, its round, the tuned numbers, and its scores."""


def tuning_of(asked: Search, candidate: Candidate) -> dict[str, float]:
    """The tuned numbers of a candidate."""
    return {of.name: candidate[of.name] for of in asked.space}


def rows_of(asked: Search) -> Rows[Candidate]:
    """The rows that are kept."""
    numbers = [*(of.name for of in asked.space), *NO_SCORES]

    def row(cells: Mapping[str, Any], before: Sequence[Candidate]) -> Candidate:
        if cells["candidate"] != len(before):
            raise Refusal("the candidates are not in their order")
        return {name: float("nan") if cell is None else cell for name, cell in cells.items()}

    return Rows(
        file="candidates.parquet",
        what="candidates",
        wanted=asked.rounds * asked.batch,
        most=_MOST_CANDIDATES,
        schema={"candidate": pl.Int64, "round": pl.Int64, **dict.fromkeys(numbers, pl.Float64)},
        cells=dict,
        row=row,
    )


class SearchEngine:
    """A search that was prepared: its people are drawn, and the reference controllers tried.

    Loops are compiled when they are first needed; Refusal if one cannot be closed.
    """

    def __init__(self, asked: Search) -> None:
        self.asked = asked
        self.subjects = draw_subjects(
            asked.trial, asked.people, asked.people_seed, seeds=asked.seeds, first_seed=asked.first_seed
        )
        self._loops: dict[str, TuningLoop] = {}
        self.references = {
            case.label: self._scores(next(self._loop(case).run(self.subjects))) for case in asked.trial.cases[1:]
        }
        """Scores of the reference controllers, by label."""
        self.bounds = [
            Bound(name, self.references[most][OBJECTIVES[name].name], most)
            if isinstance(most, str)
            else Bound(name, most)
            for name, most in asked.bounds
        ]

    def missing(self, before: Sequence[Candidate]) -> Iterator[Candidate]:
        """Yield the candidates that are still missing, each as soon as it is known.

        Refusal for a sampler that asks for other tunings than it did before.
        """
        asked, known = self.asked, list(before)
        start = None
        if all(of.holds(asked.initial[of.name]) for of in asked.space):
            start = {of.name: of.rounded(asked.initial[of.name]) for of in asked.space}
        sampler = make_sampler(asked.sampler, asked.space, asked.sampler_seed, batch=asked.batch, start=start)
        for first in range(0, asked.rounds * asked.batch, asked.batch):
            tunings = sampler.ask(asked.batch)
            held = known[first : first + asked.batch]
            for candidate, tuning in zip(held, tunings, strict=False):
                if tuning_of(asked, candidate) != tuning:
                    raise Refusal(
                        f"candidate {candidate['candidate']} of the search was another tuning than {asked.sampler} "
                        "proposes now; go on with the libraries with which it was begun, or begin again with "
                        "--overwrite"
                    )
            todo = tunings[len(held) :]
            runs = self._loop(asked.tuned).run(self.subjects, todo) if todo else ()
            for tuning, metrics in zip(todo, runs, strict=True):
                place = {"candidate": len(known), "round": first // asked.batch}
                known.append({**place, **tuning, **self._scores(metrics)})
                yield known[-1]
            sampler.tell([self._told(candidate) for candidate in known[first : first + asked.batch]])

    def found(self, rows: Sequence[Candidate]) -> Findings:
        """Choose a tuning, and check it."""
        asked = self.asked
        table = judged(rows_of(asked).table(rows), self.bounds, asked.objectives, asked.prefer)
        kept, front = table.filter("keeps_the_bounds"), table.filter("on_the_front")
        front = front.sort(OBJECTIVES[asked.objectives[0]].name, maintain_order=True)
        chosen = table.row(by_predicate=pl.col("chosen"), named=True)
        check, scores = self.check(tuning_of(asked, chosen))
        plain = {
            "config": asked.tree(whole=True),
            "candidates": len(table),
            "keeping_the_bounds": len(kept),
            "bounds": [{"objective": b.objective, "at_most": b.most, "of": b.of} for b in self.bounds],
            "chosen": {**self._plain(chosen), "keeps_the_bounds": chosen["keeps_the_bounds"]},
            "front": [self._plain(row) for row in front.to_dicts()],
            "as_it_was": self._plain(rows[0]) if tuning_of(asked, rows[0]) == asked.initial else None,
            "beside": self.references,
            "check": scores,
            "engines": (engines := {label: loop.engine_told for label, loop in self._loops.items()}),
            "notes": [*self._left_out(), f"Engine: {engine_facts(engines)['Engine']}."],
        }
        return Findings(plain, {"candidates.csv": table, "check.parquet": check})

    def check(self, tuning: Mapping[str, float]) -> tuple[pl.DataFrame, dict[str, Scores]]:
        """The chosen, the initial and the reference tunings on subjects outside the search: each subject, and scores.

        Nothing is told of a tuning that the design refuses.
        """
        asked = self.asked
        subjects = draw_subjects(
            asked.trial,
            asked.check_people,
            asked.check_people_seed,
            seeds=asked.check_seeds,
            first_seed=asked.check_first_seed,
        )
        runs = dict(
            zip((CHOSEN, AS_IT_WAS), self._loop(asked.tuned).run(subjects, [tuning, asked.initial]), strict=True)
        )
        runs |= {case.label: next(self._loop(case).run(subjects)) for case in asked.trial.cases[1:]}
        done = {label: metrics for label, metrics in runs.items() if metrics is not None}
        group = np.where(np.arange(subjects.number) < subjects.people, "people", "noise")
        table = pl.concat(
            pl.DataFrame(
                {
                    "controller": label,
                    "group": group,
                    "undershoot_mg_dl": of["undershoot_mg_dl"],
                    "peak_mg_dl": of["peak_mg_dl"],
                    "total_variation_mU_min": of["insulin_total_variation_mU_min"],
                }
            )
            for label, of in done.items()
        )
        return table, {label: scores(of, subjects.people) for label, of in done.items()}

    def _loop(self, case: Case) -> TuningLoop:
        if case.label not in self._loops:
            space = self.asked.space if case.label == self.asked.tuned.label else ()
            self._loops[case.label] = TuningLoop(self.asked.trial, case, space, self.subjects)
        return self._loops[case.label]

    def _scores(self, metrics: Mapping[str, npt.NDArray[Any]] | None) -> Scores:
        return NO_SCORES if metrics is None else scores(metrics, self.subjects.people)

    def _left_out(self) -> list[str]:
        left, people = self.subjects.infeasible, how_many(self.asked.people, "person", "people")
        has, was = ("has", "was") if left == 1 else ("have", "were")
        return [f"{left} of {people} {has} no basal rate and {was} left out."] if left else []

    def _plain(self, row: Candidate) -> dict[str, Any]:
        scores = {name: row[name] for name in NO_SCORES}
        return {"candidate": row["candidate"], "tuning": tuning_of(self.asked, row), "scores": scores}

    def _told(self, candidate: Candidate) -> Told:
        return Told(
            values=tuple(candidate[OBJECTIVES[name].name] for name in self.asked.objectives),
            violation=tuple(float(np.nan_to_num(bound.violation(candidate), nan=1e9)) for bound in self.bounds),
        )
