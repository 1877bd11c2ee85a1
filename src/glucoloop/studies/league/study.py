"""A league carried out: its lines and their shards, the rows that are kept, and what is found in them."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import itertools
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.component.request import Request, completed, request_of
from glucoloop.patients.component import NOMINAL
from glucoloop.refusal import Refusal
from glucoloop.situations.case import label_of
from glucoloop.situations.run import intravenous_boluses
from glucoloop.storage.results import Results
from glucoloop.storage.rows import Rows
from glucoloop.studies.league import LEAGUE, MAX_BEST, MAX_PEOPLE, League, reach, texts
from glucoloop.studies.league.numbers import (
    A_DAY,
    ALL,
    EQUATIONS,
    GLUCAGON_UG,
    LINE,
    METRICS,
    PROFILE,
    RESCUE_CARBS,
    TARGETS,
    harms,
    line_table,
    over_all_cells,
    ranking,
)
from glucoloop.studies.league.report import columns_of
from glucoloop.studies.league.report import files_of as files_of
from glucoloop.studies.league.report import sentences as sentences
from glucoloop.studies.league.report import tables as tables
from glucoloop.text import how_many
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.trial import Trial
from glucoloop.units import MIN_PER_DAY

_DESIGN_S: Final = 0.5
_PATIENT_DAYS_S: Final = 2200.0
_SLOW_PATIENT_DAYS_S: Final = 300.0
_BEST_PATIENT_DAYS_S: Final = 2.0
"""Time of a design, and patient-days a second of a processor, which weigh the work of which progress tells: of a loop,
of one with a slow controller, and of the search of the best doses."""
_SAID: Final = ("engine", "lacks", "reason")
"""Texts of a row, by its names."""
_LONGEST_TEXT: Final = 4000
_KEPT_LOOPS: Final = 20
"""Number of loops after which compiled programs are given up; hundreds of them take gigabytes."""


class _Line(NamedTuple):
    """A controller in a cell, or the best doses in a scenario, whose sensor is `ALL` and whose controller `KNOWN`."""

    family: str
    sensor: str
    scenario: str
    controller: str
    """Label of the case."""
    trial: Trial | None
    """Trial of the controller alone; None where it is not possible."""
    reason: str
    """Refusal of that trial."""

    @property
    def names(self) -> dict[str, str]:
        """Values of the columns `LINE`."""
        return {name: getattr(self, name) for name in LINE}

    @property
    def days(self) -> float:
        """Length of the run in days."""
        return 0.0 if self.trial is None else self.trial.horizon_min / MIN_PER_DAY

    def work(self, people: int) -> float:
        """Units of work of some people, of which one is about a second of a processor."""
        if self.sensor == ALL:
            return people * self.days / _BEST_PATIENT_DAYS_S
        slow = self.trial is not None and any(case.controller.slow for case in self.trial.cases)
        return _DESIGN_S + people * self.days / (_SLOW_PATIENT_DAYS_S if slow else _PATIENT_DAYS_S)


class _ShardResult(NamedTuple):
    """People of a shard of a line: one row."""

    line: _Line
    shard: int
    engine: str
    lacks: str
    """Operation that native code lacks, where another engine computed."""
    reason: str
    """Refusal of a controller that takes no part; empty where it does."""
    people: Mapping[str, npt.NDArray[Any]]
    """``person``, ``able`` and the metrics."""


@functools.lru_cache(maxsize=1)
def _lines_of(config: League) -> list[_Line]:
    """Every controller in every cell; the controllers of a cell follow one another."""
    results = []
    for patient, sensor, scenario, case in itertools.product(
        config.families, config.sensors, config.scenarios, config.cases
    ):
        settings = {"patient": patient, "sensor": (sensor,), "scenario": scenario, "controller": (case,)}
        settings |= config.of_family(patient.component.subcutaneous)
        family, of_sensor, of_scenario = texts((patient, sensor, scenario))
        trial, reason = None, ""
        try:
            trial = completed(Request(Trial, settings), {"people": config.people})
        except Refusal as error:
            reason = str(error)
        results.append(_Line(family, of_sensor, of_scenario, label_of(case), trial, reason))
    return results


Shard = tuple[_Line, int, npt.NDArray[np.int64]]
"""A line, a number, and people."""
_NOBODY: Final = np.empty(0, np.int64)


def _shards_of(config: League, best_people: int | None = None) -> list[Shard]:
    """All shards with their people, in the order in which they are computed; one of nobody where it is not possible.

    The best doses come last, person after person, of as many as are asked for unless told otherwise, so that those of
    more people go on where those of few end.
    """
    best_people = config.bound_people if best_people is None else best_people
    loops = [
        (line, number, _NOBODY if line.trial is None else line.trial.shard(number))
        for line in _lines_of(config)
        for number in range(1 if line.trial is None else line.trial.shards)
    ]
    best = [
        (line, number, _NOBODY if line.trial is None else np.array([number]))
        for number, line in itertools.product(range(best_people), _best_lines(config))
        if number < (1 if line.trial is None else line.trial.people)
    ]
    return loops + best


def _best_lines(config: League) -> list[_Line]:
    """Best doses of each family in each scenario; a trial with any of the controllers has its people and days."""
    places: dict[tuple[str, str], _Line] = {}
    for line in _lines_of(config):
        place = line.family, line.scenario
        if place not in places or places[place].trial is None:
            places[place] = line._replace(sensor=ALL)
    return [line._replace(controller=known) for line in places.values() for known in reach.KNOWN]


def notes(config: League) -> Iterator[str]:
    """Notes on the amount of work, and on controllers that take no part."""
    lines = _lines_of(config)
    patient_days = sum(line.days * line.trial.people for line in lines if line.trial)
    best = sum(
        line.days * person.size
        for line, _, person in _shards_of(config)
        if (line.sensor, line.controller) == (ALL, reach.START)
    )
    searches = f", and the best doses of {best:.0f} patient-days to search for" if best else ""
    yield (
        f"{how_many(len(lines), 'loop')} to design and compile, and {patient_days:.0f} patient-days{searches}; if that "
        "takes long, it is said how long once the first are timed."
    )
    yield from _left_out(config)


def _left_out(config: League) -> Iterator[str]:
    for name in config.left_out:
        yield (
            f"{name} takes no part, since each of its loops compiles for up to half a minute; --controller {name} has "
            "it in the league."
        )


def rows(config: League) -> Rows[_ShardResult]:
    """Rows that are kept: the people of each shard."""
    shards = _shards_of(config, MAX_BEST)  # those of a folder that went further are read, and refused with a sentence

    def row(cells: Mapping[str, Any], before: Sequence[_ShardResult]) -> _ShardResult:
        line, number, person = shards[len(before)]
        people = {name: np.asarray(cells[name]) for name in ("person", "able", *METRICS)}
        person = person[:0] if cells["reason"] else person
        expected = {**line.names, "shard": number}
        same_people = np.array_equal(people["person"], person) and len({v.shape for v in people.values()}) == 1
        if not same_people or any(cells[name] != value for name, value in expected.items()):
            raise Refusal("this is not the next shard of the league")
        return _ShardResult(line, number, **{name: cells[name] for name in _SAID}, people=people)

    return Rows(
        file=LEAGUE.results,
        what="shards",
        wanted=len(_shards_of(config)),
        most=len(shards),
        schema={
            **dict.fromkeys(LINE, pl.String),
            "shard": pl.Int64,
            **dict.fromkeys(_SAID, pl.String),
            "person": pl.List(pl.Int64),
            "able": pl.List(pl.Boolean),
            **dict.fromkeys(METRICS, pl.List(pl.Float64)),
        },
        cells=lambda of: {
            **of.line.names,
            "shard": of.shard,
            **{name: getattr(of, name) for name in _SAID},
            **{name: pl.Series(values) for name, values in of.people.items()},
        },
        row=row,
        width=MAX_PEOPLE * (2 + len(METRICS)),
        longest_text=_LONGEST_TEXT,
        every_s=15.0,  # since all people are written each time
        unit="units of work",
        rate_over_s=600.0,  # one controller may take ten times as long as another
        work=lambda number: max(1, round(shards[number][0].work(shards[number][2].size))),
    )


class _LeagueSearch:
    """The loops of a league, one controller in one cell after the other."""

    def __init__(self, config: League) -> None:
        self._config = config

    def missing(self, rows: Sequence[_ShardResult]) -> Iterator[_ShardResult]:
        """Carry out the shards that follow; a controller that cannot be designed has the reason in its rows."""
        best = reach.BestDoses()
        for place, (line, number, person) in enumerate(_shards_of(self._config)[len(rows) :]):
            if place and place % _KEPT_LOOPS == 0:
                _give_up_programs()
            try:
                result = _computed(line, number, person, best)
            except Refusal as error:
                people = {"person": person[:0], "able": person[:0] > 0, **dict.fromkeys(METRICS, np.empty(0))}
                result = _ShardResult(line, number, "", "", str(error)[: _LONGEST_TEXT // 2], people)
            yield result

    def results_of(self, results: Sequence[_ShardResult]) -> Results:
        """Numbers of all lines, the ranking of each family, who is harmed, and who takes no part and why."""
        config, whole = self._config, rows(self._config).table(results)
        table, plans = whole.filter(pl.col("sensor") != ALL), whole.filter(sensor=ALL)
        lines = pl.DataFrame([{**line.names, "days": line.days} for line in _lines_of(config)])
        people = table.filter(reason="").explode("person", "able", *METRICS).join(lines, on=LINE, maintain_order="left")
        people = people.with_columns(
            **{name: per * pl.col(metric) / pl.col("days") for name, (metric, per) in A_DAY.items()},
            known=pl.col("able") & pl.all_horizontal(pl.col(METRICS).is_finite()),
        )
        cells = len(config.sensors) * len(config.scenarios)
        together = over_all_cells(people.filter("known"), cells)
        every = [pl.lit(ALL).alias(name) for name in ("sensor", "scenario")]
        heads = lines.with_columns(every).unique(maintain_order=True, subset=LINE)
        shown, known = [of.select(LINE) for of in (heads, lines)], people.filter("known").select(together.columns)
        best = plans.filter(reason="").explode("person", "able", *METRICS).filter(pl.col("gri").is_finite())
        numbers = line_table(
            reach.beside(pl.concat([together, known]), best, len(config.scenarios)),
            pl.concat(shown),
            config.reference_label,
            config.worse_by_pct,
            columns_of(config),
        )
        design = {
            label_of(case): EQUATIONS if request_of(case.value("controller")).component.on_equations else PROFILE
            for case in config.cases
        }
        numbers = numbers.with_columns(design=pl.col("controller").replace_strict(design, default=None))
        plain = {
            "config": config.tree(whole=True),
            "families": dict(_families(config)),
            "rows": numbers.to_dicts(),
            "rankings": [ranking(together, family, config.seed) for family in config.family_names],
            "harms": harms(numbers.to_dicts(), config.reference_label),
            "nearest": reach.nearest(numbers.to_dicts()) if config.bound_people else [],
            "absent": [*_left_out(config), *_absent(table, people), *_without_best(plans)],
            "targets": {name: [bound for bound in bounds if np.isfinite(bound)] for name, bounds in TARGETS.items()},
        }
        return Results(plain, {"league.csv": numbers, "league.parquet": numbers})


search = _LeagueSearch


def _give_up_programs() -> None:
    """Give up the programs that JAX holds, and give their memory back; what is needed again is compiled again."""
    import jax

    jax.clear_caches()  # type: ignore[no-untyped-call]
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):  # another C library than GNU's
        ctypes.CDLL(None).malloc_trim(0)


def _computed(line: _Line, number: int, person: npt.NDArray[np.int64], best: reach.BestDoses) -> _ShardResult:
    """People of a line under its controller, or one under the best doses; Refusal where that is not possible."""
    if line.trial is None:
        raise Refusal(line.reason)
    if line.sensor == ALL:
        return _ShardResult(line, number, "", "", "", best.of(line.trial, number, line.controller))
    prepared = prepare(line.trial)
    results, facts = run_people(prepared, line.controller, person), prepared.engines[line.controller]
    nothing = np.zeros(person.size)  # eaten against low glucose, or given of glucagon, where the loop has none
    known = {**dict.fromkeys((RESCUE_CARBS, GLUCAGON_UG), nothing), **results.metrics}
    metrics = {name: known[name] for name in METRICS}
    people = {"person": results.person, "able": results.feasible, **metrics}
    return _ShardResult(line, number, facts["engine"], facts.get("not_native", ""), "", people)


def _families(config: League) -> Iterator[tuple[str, str]]:
    """Population and people of each family, and what is special about it."""
    for family, of_family in groupby(_lines_of(config), lambda line: line.family):
        trials = [line.trial for line in of_family if line.trial is not None]
        names = sorted({f"{how_many(trial.people, 'person', 'people')} of {trial.population.name}" for trial in trials})
        lines = [f"{'; '.join(names)}."] if names else []
        if any(trial.population.name == NOMINAL for trial in trials):
            lines.append("All are the nominal patient, and differ in their days and readings alone.")
        lines += dict.fromkeys(text for trial in trials for text in intravenous_boluses(trial))
        yield family, " ".join(lines)


def _absent(table: pl.DataFrame, people: pl.DataFrame) -> Iterator[str]:
    """Sentences on the pairs that do not go together, on slow engines, and on people whose numbers are not known."""
    refused = table.filter(pl.col("reason") != "").group_by("controller", "family", "reason", maintain_order=True)
    for row in refused.agg(cell=pl.format("{}, {}", "sensor", "scenario").unique(maintain_order=True)).to_dicts():
        where = f"{how_many(len(row['cell']), 'cell')} ({'; '.join(row['cell'])})"
        what = f"{row['controller']} takes no part on {row['family']} in {where}, and is not ranked there"
        yield f"{what}: {row['reason'].rstrip('.')}."
    slow = table.filter(pl.col("lacks") != "").select("controller", "lacks").unique(maintain_order=True)
    for controller, lacks in slow.rows():
        yield f"{controller} is computed by the slower engine xla, since native code lacks {lacks}."
    for family, of_family in people.filter(~pl.col("able")).group_by("family", maintain_order=True):
        number = how_many(of_family["person"].n_unique(), "person has", "people have")
        yield f"{family[0]}: {number} no basal rate for the setpoint, and no part in any number."
    lost = people.filter("able", ~pl.col("known")).group_by("controller", "family", maintain_order=True).len()
    for controller, family, number in lost.rows():
        runs = how_many(number, "run")
        yield f"{controller} on {family}: {runs} did not stay finite, and these people have no part in the ranking."


def _without_best(plans: pl.DataFrame) -> Iterator[str]:
    for family, scenario, reason in (
        plans.filter(pl.col("reason") != "").select("family", "scenario", "reason").unique(maintain_order=True).rows()
    ):
        yield f"The best doses of {family} in {scenario} are not known: {reason.rstrip('.')}."
