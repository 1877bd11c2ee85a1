"""Search for a tuning that is robust to people and noise, and its result on subjects that it never saw."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.cohorts.trial import Trial
from glucoloop.config.key import plain
from glucoloop.config.trial import trial_keys
from glucoloop.experiments.case import Case
from glucoloop.parts.ranges import Tuned
from glucoloop.printable import how_many
from glucoloop.refusal import Refusal
from glucoloop.storage.findings import Findings
from glucoloop.storage.rows import Rows
from glucoloop.studies.robust import TAKEN, HowFar, RobustSettings
from glucoloop.studies.robust.front import Bound, judged
from glucoloop.studies.robust.loop import TuningLoop
from glucoloop.studies.robust.objectives import NO_SCORES, OBJECTIVES, Scores, scores
from glucoloop.studies.robust.subjects import draw_subjects
from glucoloop.tuning.samplers import Told, make_sampler

CHOSEN: Final = "chosen"
AS_IT_WAS: Final = "as it was"
_MOST_CANDIDATES: Final = 1_000_000
Candidate = dict[str, Any]
"""A tuning that was tried, as a row: its number, its round, the tuned numbers, and its scores."""


@dataclass(frozen=True, kw_only=True)
class Search:
    """A search that is complete and checked."""

    trial: Trial
    """The situation; its first case is tuned, and the others are references."""
    space: tuple[Tuned, ...]
    at_most: tuple[tuple[str, float | str], ...] = ()
    """Objectives with a bound: a number, or the label of a reference case."""
    own: RobustSettings
    far: HowFar = field(default_factory=HowFar)
    top: int = 10
    """Number of tunings in the table."""
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Flat keys from which it was read, if it was."""

    def keys(self) -> dict[str, Any]:
        """The flat keys of all values that are used."""
        ranges = {of.name: of.text for of in self.space}
        return {**plain(self.own), **plain(self.far), **self.shared(), **self.case.tuning, **ranges}

    def shared(self) -> dict[str, Any]:
        """The flat keys that a search has in common with a trial."""
        trial = {**trial_keys(self.trial), "known_dead_time": self.case.known_dead_time}
        return {key: trial[key] for key in TAKEN if key in trial}

    @property
    def case(self) -> Case:
        """The controller that is tuned."""
        return self.trial.cases[0]

    @property
    def start(self) -> dict[str, float]:
        """Initial values of the tuned numbers."""
        return {of.name: float(self.case.tuning[of.name]) for of in self.space}

    def tuning(self, candidate: Candidate) -> dict[str, float]:
        """The tuned numbers of a candidate."""
        return {of.name: candidate[of.name] for of in self.space}

    def rows(self) -> Rows[Candidate]:
        """The rows that are kept."""
        numbers = [*(of.name for of in self.space), *NO_SCORES]

        def row(cells: Mapping[str, Any], before: Sequence[Candidate]) -> Candidate:
            if cells["candidate"] != len(before):
                raise Refusal("the candidates are not in their order")
            return {name: float("nan") if cell is None else cell for name, cell in cells.items()}

        return Rows(
            file="candidates.parquet",
            what="candidates",
            wanted=self.far.rounds * self.own.batch,
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
        own = asked.own
        self.asked = asked
        self.subjects = draw_subjects(
            asked.trial, people=own.people, people_seed=own.people_seed, seeds=own.seeds, first_seed=own.first_seed
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
            for name, most in asked.at_most
        ]

    def missing(self, before: Sequence[Candidate]) -> Iterator[Candidate]:
        """Yield the candidates that are still missing, each as soon as it is known.

        Refusal for a sampler that asks for other tunings than it did before.
        """
        asked, own, known = self.asked, self.asked.own, list(before)
        start = None
        if all(of.holds(asked.start[of.name]) for of in asked.space):
            start = {of.name: of.rounded(asked.start[of.name]) for of in asked.space}
        sampler = make_sampler(own.sampler, asked.space, own.sampler_seed, batch=own.batch, start=start)
        for first in range(0, asked.far.rounds * own.batch, own.batch):
            tunings = sampler.ask(own.batch)
            held = known[first : first + own.batch]
            for candidate, tuning in zip(held, tunings, strict=False):
                if asked.tuning(candidate) != tuning:
                    raise Refusal(
                        f"candidate {candidate['candidate']} of the search was another tuning than {own.sampler} "
                        "proposes now; go on with the libraries with which it was begun, or begin again with "
                        "--overwrite"
                    )
            todo = tunings[len(held) :]
            if todo:
                for tuning, metrics in zip(todo, self._loop(asked.case).run(self.subjects, todo), strict=True):
                    number = len(known)
                    known.append({"candidate": number, "round": number // own.batch, **tuning, **self._scores(metrics)})
                    yield known[-1]
            sampler.tell([self._told(candidate) for candidate in known[first : first + own.batch]])

    def found(self, rows: Sequence[Candidate]) -> Findings:
        """Choose a tuning, and check it."""
        asked, own = self.asked, self.asked.own
        table = judged(asked.rows().table(rows), self.bounds, own.objectives, asked.far.prefer)
        kept, front = table.filter("keeps_the_bounds"), table.filter("on_the_front")
        front = front.sort(OBJECTIVES[own.objectives[0]].name, maintain_order=True)
        chosen = table.row(by_predicate=pl.col("chosen"), named=True)
        check, scores = self.check(asked.tuning(chosen))
        plain = {
            "config": asked.keys(),
            "candidates": len(table),
            "keeping_the_bounds": len(kept),
            "bounds": [{"objective": b.objective, "at_most": b.most, "of": b.of} for b in self.bounds],
            "chosen": {**self._plain(chosen), "keeps_the_bounds": chosen["keeps_the_bounds"]},
            "front": [self._plain(row) for row in front.to_dicts()],
            "as_it_was": self._plain(rows[0]) if asked.tuning(rows[0]) == asked.start else None,
            "beside": self.references,
            "check": scores,
            "notes": self._left_out(),
        }
        return Findings(plain, {"candidates.csv": table, "check.parquet": check})

    def check(self, tuning: Mapping[str, float]) -> tuple[pl.DataFrame, dict[str, Scores]]:
        """The chosen, the initial and the reference tunings on subjects outside the search: each subject, and scores.

        Nothing is told of a tuning that the design refuses.
        """
        asked, own = self.asked, self.asked.own
        subjects = draw_subjects(
            asked.trial,
            people=own.check_people,
            people_seed=own.check_people_seed,
            seeds=own.check_seeds,
            first_seed=own.check_first_seed,
        )
        runs = dict(zip((CHOSEN, AS_IT_WAS), self._loop(asked.case).run(subjects, [tuning, asked.start]), strict=True))
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
            space = self.asked.space if case is self.asked.case else ()
            self._loops[case.label] = TuningLoop(self.asked.trial, case, space, self.subjects)
        return self._loops[case.label]

    def _scores(self, metrics: Mapping[str, npt.NDArray[Any]] | None) -> Scores:
        return NO_SCORES if metrics is None else scores(metrics, self.subjects.people)

    def _left_out(self) -> list[str]:
        left, people = self.subjects.infeasible, how_many(self.asked.own.people, "person", "people")
        return [f"{left} of {people} {'has' if left == 1 else 'have'} no basal rate and took no part."] if left else []

    def _plain(self, row: Candidate) -> dict[str, Any]:
        scores = {name: row[name] for name in NO_SCORES}
        return {"candidate": row["candidate"], "tuning": self.asked.tuning(row), "scores": scores}

    def _told(self, candidate: Candidate) -> Told:
        return Told(
            values=tuple(candidate[OBJECTIVES[name].name] for name in self.asked.own.objectives),
            violation=tuple(float(np.nan_to_num(bound.violation(candidate), nan=1e9)) for bound in self.bounds),
        )
