"""Search for a tuning that is robust to people and noise, and its result on subjects that it never saw."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.cohorts.trial import Trial
from glucoloop.parts.ranges import Tuned
from glucoloop.parts.setting import Value
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.studies.robust.front import Bound, choose, keeps, pareto
from glucoloop.studies.robust.loop import TuningLoop
from glucoloop.studies.robust.objectives import OBJECTIVES, objective, scores
from glucoloop.studies.robust.options import BOTH
from glucoloop.studies.robust.subjects import Subjects, draw_subjects
from glucoloop.tuning.samplers import Told, make_sampler

CHOSEN: Final = "chosen"
AS_IT_WAS: Final = "as it was"
_NO_SCORES: Final = dict.fromkeys(OBJECTIVES, float("nan"))


@dataclass(frozen=True)
class Group:
    """Subjects on whom a tuning is tried."""

    people: int
    people_seed: int
    seeds: int
    first_seed: int


@dataclass(frozen=True, kw_only=True)
class Search:
    """Everything that the candidates of a search depend on, but for their number.

    Raises
    ------
    ValueError
        For objectives that are unknown or the same, nothing to tune, or groups that share subjects.
    """

    trial: Trial
    """The situation; its first case is tuned, and the others are references."""
    space: tuple[Tuned, ...]
    group: Group
    """Subjects on whom the controller is tuned."""
    check: Group
    """Subjects on whom the chosen tuning is checked."""
    objectives: tuple[str, str] = ("undershoot-p95", "peak-median")
    at_most: tuple[tuple[str, float | str], ...] = ()
    """Objectives with a bound: a number, or the label of a reference case."""
    batch: int = 64
    sampler: str = "tpe"
    sampler_seed: int = 0

    def __post_init__(self) -> None:
        if not self.space:
            raise Refusal("nothing is tuned; give at least one range, like .1:2, in place of a number")
        for name in (*self.objectives, *(name for name, _ in self.at_most)):
            objective(name)
        if len(set(self.objectives)) != 2:
            raise Refusal(f"the objectives are {' and '.join(self.objectives)}; give two that differ")
        beside = [case.label for case in self.trial.cases[1:]]
        for name, most in self.at_most:
            if isinstance(most, str) and most not in beside:
                raise Refusal(
                    f"{name} is bounded by {most!r}, which is neither a number nor a controller that stands beside: "
                    f"{', '.join(beside) or 'there are none'}"
                )
        if self.group.people_seed == self.check.people_seed:
            raise Refusal(
                f"people are drawn with the seed {self.group.people_seed} for the search and for the check; "
                "give another seed for one of them"
            )
        first, second = sorted((self.group, self.check), key=lambda group: group.first_seed)
        if first.first_seed + first.seeds > second.first_seed:
            raise Refusal(
                f"the noise of seed {second.first_seed} is met in the search and in the check; "
                "move the first seed of one of them"
            )

    @property
    def case(self) -> Case:
        """The controller that is tuned."""
        return self.trial.cases[0]

    @property
    def start(self) -> dict[str, float]:
        """Initial values of the tuned numbers."""
        return {of.name: float(self.case.tuning[of.name]) for of in self.space}

    def tuned(self, tuning: Mapping[str, float]) -> Case:
        """The case with a tuning."""
        settings: dict[str, Value] = {**self.case.tuning, **tuning}
        return dataclasses.replace(self.case, tuning=settings)


@dataclass(frozen=True)
class Candidate:
    """A tuning that was tried."""

    number: int
    tuning: Mapping[str, float]
    scores: Mapping[str, float]
    """Score of each objective; NaN for a tuning that the design refuses."""


@dataclass(frozen=True)
class Checked:
    """A controller on the subjects of the check."""

    label: str
    scores: Mapping[str, float]
    undershoot_mg_dl: npt.NDArray[np.float64]
    """(subjects,) undershoot, people first."""
    peak_mg_dl: npt.NDArray[np.float64]
    total_variation_mU_min: npt.NDArray[np.float64]
    people: int


@dataclass(frozen=True)
class Judgement:
    """Judgement of the candidates."""

    keeps: npt.NDArray[np.bool_]
    """(candidates,) whether each keeps the bounds."""
    front: npt.NDArray[np.bool_]
    chosen: int
    """Index of the chosen candidate."""
    bounded: bool
    """Whether it keeps the bounds; if none does, the one that exceeds them least is chosen."""


class SearchEngine:
    """A search whose loops are compiled when they are first needed.

    Parameters
    ----------
    search : Search

    Raises
    ------
    ValueError
        If none of the people has a basal rate, or a controller cannot be designed.
    """

    def __init__(self, search: Search) -> None:
        self.search = search
        self.subjects = self._subjects(search.group)
        self._loops: dict[str, TuningLoop] = {}

    def references(self) -> dict[str, dict[str, float]]:
        """Scores of the reference controllers on the subjects of the search, by label."""
        found = {}
        for case in self.search.trial.cases[1:]:
            metrics = next(self._loop(case).run(self.subjects))
            found[case.label] = _NO_SCORES if metrics is None else scores(metrics, self.subjects.people)
        return found

    def candidates(self, rounds: int, bounds: Sequence[Bound], before: Sequence[Candidate] = ()) -> Iterator[Candidate]:
        """Yield the candidates that are still missing, each as soon as it is known.

        Parameters
        ----------
        rounds : int
            Number of rounds of the whole search.
        bounds : sequence of Bound
        before : sequence of Candidate
            Candidates that were found before, in order.

        Raises
        ------
        ValueError
            For a sampler that is not installed, or that asks for other tunings than it did before.
        """
        search, known = self.search, list(before)
        start = None
        if all(of.holds(search.start[of.name]) for of in search.space):
            start = {of.name: of.rounded(search.start[of.name]) for of in search.space}
        sampler = make_sampler(search.sampler, search.space, search.sampler_seed, batch=search.batch, start=start)
        loop = None
        for first in range(0, rounds * search.batch, search.batch):
            asked = sampler.ask(search.batch)
            held = known[first : first + search.batch]
            for candidate, tuning in zip(held, asked, strict=False):
                if dict(candidate.tuning) != tuning:
                    raise Refusal(
                        f"candidate {candidate.number} of the search was another tuning than {search.sampler} proposes "
                        "now; go on with the libraries with which it was begun, or begin again with --overwrite"
                    )
            todo = asked[len(held) :]
            if todo:
                loop = self._loop(search.case) if loop is None else loop
                for tuning, metrics in zip(todo, loop.run(self.subjects, todo), strict=True):
                    found = _NO_SCORES if metrics is None else scores(metrics, self.subjects.people)
                    candidate = Candidate(number=len(known), tuning=tuning, scores=found)
                    known.append(candidate)
                    yield candidate
            sampler.tell([_told(search, bounds, one) for one in known[first : first + search.batch]])

    def check(self, tuning: Mapping[str, float]) -> list[Checked]:
        """Results of the chosen, the initial and the reference tunings on subjects outside the search."""
        search = self.search
        subjects = self._subjects(search.check)
        tunings = {CHOSEN: dict(tuning), AS_IT_WAS: search.start}
        runs = self._loop(search.case).run(subjects, list(tunings.values()))
        told = dict(zip(tunings, runs, strict=True))
        told |= {case.label: next(self._loop(case).run(subjects)) for case in search.trial.cases[1:]}
        return [_checked(label, metrics, subjects.people) for label, metrics in told.items() if metrics is not None]

    def _loop(self, case: Case) -> TuningLoop:
        if case.label not in self._loops:
            space = self.search.space if case is self.search.case else ()
            self._loops[case.label] = TuningLoop(self.search.trial, case, space, self.subjects)
        return self._loops[case.label]

    def _subjects(self, group: Group) -> Subjects:
        trial = self.search.trial
        nominal = trial.nominal
        return draw_subjects(
            nominal,
            trial.population,
            people=group.people,
            people_seed=group.people_seed,
            seeds=group.seeds,
            first_seed=group.first_seed,
            setpoint_mg_dl=float(nominal.setpoint_mg_dl),
        )


def bounds_of(search: Search, references: Mapping[str, Mapping[str, float]]) -> tuple[Bound, ...]:
    """Bounds of a search as numbers; some are values of reference controllers."""
    return tuple(
        Bound(name, references[most][name], most) if isinstance(most, str) else Bound(name, most)
        for name, most in search.at_most
    )


def judge(search: Search, bounds: Sequence[Bound], candidates: Sequence[Candidate], prefer: str = BOTH) -> Judgement:
    """Candidates that keep the bounds, those on the front, and the chosen one.

    Parameters
    ----------
    search : Search
    bounds : sequence of Bound
    candidates : sequence of Candidate
    prefer : str
        Preference, see `front.choose`.

    Raises
    ------
    ValueError
        If no candidate has a controller, or for an objective that cannot be preferred.
    """
    values = np.array([[of.scores[name] for name in search.objectives] for of in candidates]).reshape(-1, 2)
    finite = np.isfinite(values).all(axis=1)
    if not finite.any():
        raise Refusal("no tuning of the search has a controller that works; give other ranges")
    kept = np.array([keeps(of.scores, bounds, search.objectives) for of in candidates])
    front = np.zeros(len(candidates), bool)
    eligible = np.flatnonzero(kept)
    if not eligible.size:
        sums = [sum(max(bound.violation(of.scores), 0.0) for bound in bounds) for of in candidates]
        excess = np.where(finite & np.isfinite(sums), sums, np.inf)
        choose(values[finite], search.objectives, prefer)  # refuses what cannot be preferred
        return Judgement(keeps=kept, front=front, chosen=int(np.argmin(excess)), bounded=False)
    front[eligible[pareto(values[eligible])]] = True
    on_it = np.flatnonzero(front)
    return Judgement(
        keeps=kept, front=front, chosen=int(on_it[choose(values[on_it], search.objectives, prefer)]), bounded=True
    )


def _told(search: Search, bounds: Sequence[Bound], candidate: Candidate) -> Told:
    return Told(
        values=tuple(candidate.scores[name] for name in search.objectives),
        violation=tuple(float(np.nan_to_num(bound.violation(candidate.scores), nan=1e9)) for bound in bounds),
    )


def _checked(label: str, metrics: Mapping[str, Any], people: int) -> Checked:
    return Checked(
        label=label,
        scores=scores(metrics, people),
        undershoot_mg_dl=metrics["undershoot_mg_dl"],
        peak_mg_dl=metrics["peak_mg_dl"],
        total_variation_mU_min=metrics["insulin_total_variation_mU_min"],
        people=people,
    )
