"""People of a trial under its controllers: drawn, simulated, measured and counted, block by block."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._pytree import chosen, replaced, varying
from glucoloop.build.assemble import AtRest, PeopleLoop, close_loop, own_controllers, with_profile_of_each
from glucoloop.build.designs import controller_of
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import Surroundings, shared_surroundings
from glucoloop.build.titration import with_profiles
from glucoloop.control import Controller
from glucoloop.control.protocol import computed_settings
from glucoloop.meals import Scenario
from glucoloop.meals.habits import LivedDays
from glucoloop.metrics import Metrics, RunningMetrics
from glucoloop.patients.population import VirtualPeople, of_people, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.simulation import Trace
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs
from glucoloop.simulation.person_loop import Accumulator
from glucoloop.trials.people import PeopleRows, block_size, few_in_a_block, in_blocks
from glucoloop.trials.statistics import bin_numbers, glucose_edges, insulin_edges
from glucoloop.trials.trial import Trial, fingerprint, profile_columns

Array = npt.NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class PeopleResult(PeopleRows):
    """Results of people under one controller, with their counts and, where they were asked for, their traces."""

    glucose_counts: npt.NDArray[np.int64]
    """(samples + 1, bins) numbers of people with a basal rate in each bin."""
    insulin_counts: npt.NDArray[np.int64]
    """(samples, bins) numbers of people with a basal rate in each bin."""
    week_counts: npt.NDArray[np.int64]
    """(weeks, bins) numbers of samples of these people with glucose in each bin; no week but in a long run."""
    glucose_mg_dl: npt.NDArray[np.float32] | None = None
    """(samples + 1, n) glucose without noise."""
    insulin_mU_min: npt.NDArray[np.float32] | None = None
    """(samples, n) delivered insulin."""


@dataclass(frozen=True)
class PreparedCase:
    """A controller of a trial with its compiled loop."""

    controller: Controller
    """Controller designed for the nominal patient."""
    loop: PeopleLoop
    """Compiled loop, which cases that differ only in a fault share."""
    surroundings: Surroundings
    """Sensor and pump of one person."""
    alike: tuple[Surroundings, ...]
    """Sensors and pumps of all cases that share the loop, this one included; none where it is alone."""


@dataclass(frozen=True)
class PreparedTrial:
    """A trial whose controllers are designed."""

    trial: Trial
    accumulator: RunningMetrics
    cases: Mapping[str, PreparedCase]

    @property
    def engines(self) -> dict[str, dict[str, str]]:
        """Engine of each controller by its label, as `PeopleLoop.engine_facts` has it."""
        return {label: case.loop.engine_facts for label, case in self.cases.items()}

    @property
    def computed_settings(self) -> dict[str, dict[str, float]]:
        """Settings that followed from the design of each controller for the nominal patient, by label."""
        return {label: computed_settings(case.controller) for label, case in self.cases.items()}


_PREPARED: Final[dict[str, PreparedTrial]] = {}
_MAX_PREPARED: Final = 2
_COUNTED_AT_ONCE: Final = 1 << 17
"""Numbers that are counted together, about, so that what is computed of them stays in the processor's cache."""


def prepare(trial: Trial) -> PreparedTrial:
    """Design the controllers of a trial and compile their loops; the last two are kept.

    Refusal if a controller cannot be designed.
    """
    key = fingerprint(trial)
    result = _PREPARED.pop(key, None) or _prepare(trial)
    _PREPARED[key] = result
    if len(_PREPARED) > _MAX_PREPARED:
        del _PREPARED[next(iter(_PREPARED))]
    return result


def _prepare(trial: Trial) -> PreparedTrial:
    accumulator, example = fold_of(trial), people_of(trial, [trial.first_person])
    prepared: dict[str, PreparedCase] = {}
    for by_label in shared_surroundings(trial, trial.cases):
        # these cases differ only in their label, sensor and pump
        case = next(case for case in trial.cases if case.label in by_label)
        controller, alike = controller_of(trial, case), tuple(by_label.values())
        loop = loop_of(
            trial,
            controller,
            accumulator,
            example,
            controllers_of=own_controllers(trial, case, controller, example, individual=trial.design == "individual"),
            surroundings=by_label[case.label],
            varied=by_label[case.label].of_people(alike, 1),
        )
        shared = alike if len(alike) > 1 else ()
        prepared |= {
            label: PreparedCase(controller, loop, surroundings, shared) for label, surroundings in by_label.items()
        }
    return PreparedTrial(trial=trial, accumulator=accumulator, cases=prepared)


def people_of(trial: Trial, person: npt.ArrayLike) -> VirtualPeople:
    """People of a trial at steady state at its target, by their numbers."""
    people = virtual_people(trial.population, trial.seed, person, setpoint_mg_dl=trial.target_mg_dl)
    return with_profiles(trial, people, trial.products)


def fold_of(trial: Trial) -> RunningMetrics:
    """Metrics of people of a trial, kept along their loops."""
    inside_min = tuple(trial.grid.inside_min.tolist())
    return RunningMetrics(
        setpoint_mg_dl=trial.target_mg_dl, limits=trial.limits, inside_min=inside_min, further=trial.further_metrics
    )


def loop_of(
    trial: Trial, controller: Controller, accumulator: Accumulator, example: AtRest | None = None, **others: Any
) -> PeopleLoop:
    """The loop of a controller in the situation of a trial: that of its cells, and of searches and tests of people.

    Meals and arithmetic are those of the trial, and each person brings an own profile, unless `others` say otherwise;
    `example` is the first person by default. See `PeopleLoop`.
    """
    defaults = {
        "meals": None if trial.plan.varies else trial.plan.same_for_all(),
        "own_announcements": trial.individual_announcements,
        "controllers_of": with_profile_of_each(controller),
        "precision": trial.precision,
        "products": trial.products,
        "minute_inputs": _minute_inputs_of(trial, np.array([trial.first_person])).names,
    }
    example = people_of(trial, [trial.first_person]) if example is None else example
    return PeopleLoop(trial, controller, example, trial.grid, accumulator, **{**defaults, **others})


def run_people(
    prepared: PreparedTrial,
    label: str,
    person: npt.ArrayLike,
    *,
    traces: bool = False,
    threads: int | None = None,
    done: Callable[[float], None] = lambda people: None,
) -> PeopleResult:
    """Simulate people of a trial, by their numbers, under the controller of a label.

    The result does not depend on the number of threads, two for each core by default. `done` is called with a
    number of people whenever so many more are done; a part of a long run counts as that part of its people.
    """
    number = np.asarray(person, np.int64)
    if not number.size:
        raise Refusal("nobody was asked for; give the number of at least one person")
    of_case, trial, grid = prepared.cases[label], prepared.trial, prepared.trial.grid
    counts, drawn_together = _Counts(trial), block_size(of_case.loop.engine)
    few = few_in_a_block(number.size)

    def run(block: npt.NDArray[np.int64], n: int) -> PeopleResult:
        with one_at_a_time:
            # JAX always has the same number of people before it, for another one might have other last digits
            filled = np.resize(block, drawn_together)
            drawn, days = people_of(trial, filled), trial.drawn_days(block)
            alike = of_case.surroundings.of_people(of_case.alike, filled.size) if of_case.alike else None
            of_days = {**brought(trial, days), "key": keys_of_people(trial.seed, filled)}
            people = of_case.loop.people(drawn, surroundings=alike, **of_days)
        feasible, kept, first = drawn.feasible[:n], [], 0

        def take(glucose: Array, insulin: Array) -> None:
            nonlocal first
            counts.add(first, glucose, insulin, feasible)
            first += len(glucose)
            if traces:
                kept.append((glucose[:, :n].astype(np.float32), insulin[:, :n].astype(np.float32)))
            done(n * len(glucose) / grid.samples)

        accumulator, end, _ = of_case.loop.cohort.follow(people, take, number=block.size)
        counts.end(end, feasible)
        with one_at_a_time:
            metrics: Metrics = prepared.accumulator.finish(
                accumulator,
                samples=grid.samples,
                sample_time_min=grid.sample_time_min,
                meal_t_min=np.floor(days.first_min() / grid.sample_time_min) * grid.sample_time_min,
                precision=of_case.loop.cohort.precision,
            )
        values = {name: np.asarray(column)[:n] for name, column in metrics.by_name().items()}
        # the metrics are not numbers where anything in the run was not
        known = feasible & np.isfinite(values["mean_mg_dl"]) & np.isfinite(values["insulin_total_mU"])
        if not np.array_equal(known, feasible):
            unknown, first = feasible & ~known, 0

            def take_away(glucose: Array, insulin: Array) -> None:
                nonlocal first
                counts.add(first, glucose, insulin, unknown, -1)
                first += len(glucose)

            of_case.loop.cohort.follow(people, take_away, number=block.size)
            counts.end(end, unknown, -1)
        kept.append((end[None, :n].astype(np.float32), np.zeros((0, n), np.float32)))
        glucose, insulin = (np.concatenate(parts) for parts in zip(*kept, strict=True))
        return PeopleResult(
            person=block[:n],
            feasible=feasible,
            drawn={name: column[:n] for name, column in drawn.draw.values.items()},
            basal_insulin_mU_min=drawn.basal_insulin_mU_min[:n],
            profile={name: np.asarray(drawn.profile.by_name()[name])[:n] for name in profile_columns(trial)},
            metrics=values,
            glucose_counts=counts.glucose,
            insulin_counts=counts.insulin,
            week_counts=counts.weeks,
            glucose_mg_dl=glucose if traces else None,
            insulin_mU_min=insulin if traces else None,
        )

    return _joined(in_blocks(run, number, min(drawn_together, trial.people_a_block, few), threads))


class _Counts:
    """Counts of glucose and insulin of people over time, to which the threads of a run add."""

    def __init__(self, trial: Trial) -> None:
        self._rows, self._week, self._lock = trial.counted_samples, trial.samples_a_week, threading.Lock()
        self._edges = glucose_edges(), insulin_edges(float(trial.limits.max_mU_min))
        self.glucose = np.zeros((self._rows + 1, self._edges[0].size - 1), np.int64)
        self.insulin = np.zeros((self._rows, self._edges[1].size - 1), np.int64)
        self.weeks = np.zeros((trial.counted_weeks, self._edges[0].size - 1), np.int64)

    def add(self, first: int, glucose: Array, insulin: Array, whose: npt.NDArray[np.bool_], sign: int = 1) -> None:
        """Count a piece of a run from its first sample on, of some of its first people; with -1, take it away.

        Only people are counted of whom the piece holds numbers alone.
        """
        most = max(1, _COUNTED_AT_ONCE // whose.size)
        if len(glucose) > most:
            for start in range(0, len(glucose), most):
                part = slice(start, start + most)
                self.add(first + start, glucose[part], insulin[part], whose, sign)
            return
        sample = first + np.arange(len(glucose))
        glucose, insulin = glucose[:, : whose.size], insulin[:, : whose.size]
        there = whose & np.isfinite(glucose).all(axis=0) & np.isfinite(insulin).all(axis=0)
        of_glucose, of_insulin = (
            bin_numbers(_of(values, there), edges)
            for values, edges in zip((glucose, insulin), self._edges, strict=True)
        )
        self._count(self.glucose, of_glucose, sample % self._rows, sign)
        self._count(self.insulin, of_insulin, sample % self._rows, sign)
        # the end of a day is the beginning of the next
        ends = (sample % self._rows == 0) & (sample > 0)
        self._count(self.glucose, of_glucose[ends], np.full(ends.sum(), self._rows), sign)
        if len(self.weeks):
            self._count(self.weeks, of_glucose, sample // self._week, sign)

    def end(self, glucose: Array, whose: npt.NDArray[np.bool_], sign: int = 1) -> None:
        """Count glucose at the end of the run."""
        last = glucose[None, : whose.size]
        there = whose & np.isfinite(last[0])
        self._count(self.glucose, bin_numbers(_of(last, there), self._edges[0]), np.array([self._rows]), sign)

    def _count(self, counts: npt.NDArray[np.int64], number: Array, row: Array, sign: int) -> None:
        place = number + (counts.shape[1] * row)[:, None]
        with self._lock:
            # takes the places as quickly as they come, and does not touch the other bins
            np.add.at(counts.reshape(-1), place.ravel(), sign)


def _of(values: Array, people: Array) -> Array:
    """Columns of the first people; without a copy if all are wanted."""
    return values if people.all() else values[:, people]


def person_of(trial: Trial, person: int) -> tuple[VirtualPeople, Scenario]:
    """One person of a trial, by number, and the scenario that the person meets."""
    number = np.array([person], np.int64)
    days = trial.drawn_days(number)
    return people_of(trial, number), trial.scenario_of(days.meals_of(0, trial.horizon_min), person=person)


def alone(prepared: PreparedTrial, label: str, person: int) -> Trace:
    """The loop of one person of a trial under the controller of a label, as a full trace."""
    trial, of_case = prepared.trial, prepared.cases[label]
    drawn, scenario = person_of(trial, person)
    controller = of_case.loop.controller
    if of_case.loop.controllers_of is not None:
        individual = of_case.loop.controllers_of(drawn)
        varies = varying(individual, controller)
        controller = replaced(individual, varies, [leaf[..., 0] for leaf in chosen(individual, varies)])
    return close_loop(
        trial,
        controller,
        scenario,
        patient=of_people(drawn.patient, 0),
        surroundings=of_case.surroundings,
        key=keys_of_people(trial.seed, np.array([person], np.int64))[0],
    )


def brought(trial: Trial, days: LivedDays) -> dict[str, Any]:
    """Keys, meals and announcements of people of a trial, as `PeopleLoop.people` takes them."""
    own = trial.individual_announcements
    return {
        "key": keys_of_people(trial.seed, days.person),
        "meals": days.eaten if trial.plan.varies else None,
        "announced_g": days.announced_g if own else None,
        "announced_min": days.announced_min if own else None,
        "minute_inputs": _minute_inputs_of(trial, days.person),
    }


def _minute_inputs_of(trial: Trial, person: npt.NDArray[np.int64]) -> PeopleMinuteInputs:
    """Exercise of people of a trial, and what its rhythms change in them, from the beginning of the warm-up on."""
    grid = dataclasses.replace(trial.grid, start_min=trial.start_min or 0.0)
    return PeopleMinuteInputs(grid.whole, trial.bouts_of(person), trial.rhythms, trial.seed, person)


def _joined(parts: list[PeopleResult]) -> PeopleResult:
    """Results of blocks joined in their order; all have the same counts."""
    if len(parts) == 1:
        return parts[0]

    def joined(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        if values[0] is None:
            return None
        if isinstance(values[0], Mapping):
            return {key: np.concatenate([part[key] for part in values]) for key in values[0]}
        return values[0] if name.endswith("_counts") else np.concatenate(values, axis=-1)

    names = (field.name for field in dataclasses.fields(PeopleResult) if field.name != "yes_or_no")
    return PeopleResult(**{name: joined(name) for name in names})
