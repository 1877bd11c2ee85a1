"""A league carried out: its cells and rows, its tables and sentences, and its page."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.cohorts.blocks import block_size
from glucoloop.cohorts.engine import prepare, run_people
from glucoloop.cohorts.trial import Trial
from glucoloop.parts.setting import Default
from glucoloop.patients.settings import NOMINAL
from glucoloop.printable import how_many, the_first
from glucoloop.refusal import Refusal
from glucoloop.report import Repeat
from glucoloop.report.columns import FittingTable, Row, headings, terminal_table
from glucoloop.report.heat import SHADES_PCT, UNKNOWN, HeatCell, HeatMap
from glucoloop.report.template import render
from glucoloop.situations.run import BOLUS_INTO_A_VEIN
from glucoloop.storage.findings import Findings
from glucoloop.storage.rows import Rows
from glucoloop.studies.league import MOST_PEOPLE, League, texts
from glucoloop.studies.league.numbers import (
    ALL,
    COLUMNS,
    LINE,
    METRICS,
    TARGETS,
    harms,
    line_table,
    over_all_cells,
    ranking,
)
from glucoloop.units import MIN_PER_DAY

_DESIGN_S: Final = 1.5
_PATIENT_DAYS_S: Final = 3000.0
_SLOW_PATIENT_DAYS_S: Final = 30.0
"""What a loop takes before it runs, and the patient-days a second of a processor, for the estimate of the time."""
_LONGEST_REASON: Final = 1000


@dataclass(frozen=True)
class Line:
    """A controller in a cell."""

    family: str
    sensor: str
    scenario: str
    controller: str
    """Label of the case."""
    trial: Trial | None
    """Trial of the controller alone; None where it is not possible."""
    reason: str = ""
    """Why it is not possible."""

    @property
    def names(self) -> dict[str, str]:
        """Values of the columns `LINE`."""
        return {name: getattr(self, name) for name in LINE}

    @property
    def days(self) -> float:
        """Length of the run in days."""
        return 0.0 if self.trial is None else self.trial.horizon_min / MIN_PER_DAY


class Shard(NamedTuple):
    """A shard of the people of a line: one row."""

    line: Line
    number: int

    @property
    def person(self) -> npt.NDArray[np.int64]:
        """Numbers of the people."""
        return np.empty(0, np.int64) if self.line.trial is None else self.line.trial.shard(self.number)


class ShardResult(NamedTuple):
    """People of a shard under the controller of a line."""

    shard: Shard
    engine: str
    lacks: str
    """What native code lacks, where another engine computed."""
    reason: str
    """Why the controller takes no part; empty where it does."""
    people: Mapping[str, npt.NDArray[Any]]
    """``person``, ``able`` and the metrics."""


@functools.lru_cache(maxsize=1)
def _lines(asked: tuple[tuple[Any, ...], int, int]) -> list[Line]:
    (families, sensors, scenarios, cases), people, seed = asked
    found = []
    for patient in families:
        for sensor in sensors:
            for scenario in scenarios:
                for case in cases:
                    parts = {"patient": patient, "sensor": (sensor,), "scenario": scenario, "controller": (case,)}
                    names = *texts((patient, sensor, scenario)), case.label
                    try:
                        trial = Trial.partial({**parts, "seed": seed}).completed({"people": Default(people)})
                        _ = trial.cases
                    except Refusal as error:
                        found.append(Line(*names, None, str(error)))
                    else:
                        found.append(Line(*names, trial))
    return found


def lines_of(asked: League) -> list[Line]:
    """Every controller in every cell; the controllers of a cell follow one another."""
    return _lines(((asked.families, asked.sensors, asked.scenarios, asked.cases), asked.people, asked.seed))


def shards_of(asked: League) -> list[Shard]:
    """All shards, in the order in which they are computed."""
    return [
        Shard(line, number)
        for line in lines_of(asked)
        for number in range(1 if line.trial is None else line.trial.shards)
    ]


def notes(asked: League) -> Iterator[str]:
    """How much there is to do and how long that may take, and who takes no part."""
    lines = [line for line in lines_of(asked) if line.trial is not None]
    patient_days = sum(line.days * line.trial.people for line in lines if line.trial)
    minutes = max(1, round(sum(map(_estimated_s, lines)) / 60.0))
    yield (
        f"{how_many(len(lines), 'loop')} to design and compile, and {patient_days:,.0f} patient-days: about "
        f"{how_many(minutes, 'minute')} on {how_many(os.cpu_count() or 1, 'idle core')}, fewer for loops that were "
        "compiled before."
    )
    yield from _left_out(asked)


def _estimated_s(line: Line) -> float:
    assert line.trial is not None
    slow = any(case.controller.slow for case in line.trial.cases)
    size = block_size("xla" if slow else "native")
    blocks = -(-line.trial.people // size)
    per_core = size * line.days / (_SLOW_PATIENT_DAYS_S if slow else _PATIENT_DAYS_S)
    return _DESIGN_S + per_core * -(-blocks // (os.cpu_count() or 1))


def _left_out(asked: League) -> Iterator[str]:
    for name in asked.left_out:
        yield f"{name} takes no part, since its decisions take long; name it with --controller to have it in the league."


def rows(asked: League) -> Rows[ShardResult]:
    """Rows that are kept: the people of each shard."""
    shards = shards_of(asked)

    def row(cells: Mapping[str, Any], before: Sequence[ShardResult]) -> ShardResult:
        shard = shards[len(before)]
        people = {name: np.asarray(cells[name]) for name in ("person", "able", *METRICS)}
        expected = np.empty(0) if cells["reason"] else shard.person
        if any(cells[name] != value for name, value in {**shard.line.names, "shard": shard.number}.items()) or not (
            np.array_equal(people["person"], expected)
            and all(values.shape == expected.shape for values in people.values())
        ):
            raise Refusal("this is not the next shard of the league")
        return ShardResult(shard, cells["engine"], cells["lacks"], cells["reason"], people)

    def cells(result: ShardResult) -> dict[str, Any]:
        shard, *said, people = result
        return {
            **shard.line.names,
            "shard": shard.number,
            **dict(zip(("engine", "lacks", "reason"), said, strict=True)),
            **{name: pl.Series(values) for name, values in people.items()},
        }

    return Rows(
        file="people.parquet",
        what="results",
        wanted=len(shards),
        most=len(shards),
        schema={
            **dict.fromkeys(LINE, pl.String),
            "shard": pl.Int64,
            **dict.fromkeys(("engine", "lacks", "reason"), pl.String),
            "person": pl.List(pl.Int64),
            "able": pl.List(pl.Boolean),
            **dict.fromkeys(METRICS, pl.List(pl.Float64)),
        },
        cells=cells,
        row=row,
        width=MOST_PEOPLE * (2 + len(METRICS)),
        longest_text=4 * _LONGEST_REASON,
        every_s=15.0,  # since all people are written each time
        unit="patient-days",
        work=lambda number: round(shards[number].person.size * shards[number].line.days) or 1,
    )


class LeagueSearch:
    """The loops of a league, one controller in one cell after the other."""

    def __init__(self, asked: League) -> None:
        self._asked, self._shards = asked, shards_of(asked)
        self._refused: dict[Line, str] = {}

    def missing(self, rows: Sequence[ShardResult]) -> Iterator[ShardResult]:
        """Carry out the shards that follow; a controller that cannot be designed has the reason in its rows."""
        yield from map(self._carried_out, self._shards[len(rows) :])

    def _carried_out(self, shard: Shard) -> ShardResult:
        line, nobody = shard.line, dict.fromkeys(METRICS, np.empty(0))
        try:
            if line.trial is None:
                raise Refusal(line.reason)
            prepared = prepare(line.trial)
        except Refusal as error:
            people = {"person": np.empty(0, np.int64), "able": np.empty(0, bool), **nobody}
            return ShardResult(shard, "", "", str(error)[:_LONGEST_REASON], people)
        found = run_people(prepared, line.controller, shard.person)
        facts = prepared.engines[line.controller]
        people = {"person": found.person, "able": found.feasible, **{name: found.metrics[name] for name in METRICS}}
        return ShardResult(shard, facts["engine"], facts.get("not_native", ""), "", people)

    def found(self, results: Sequence[ShardResult]) -> Findings:
        """Numbers of all lines, the ranking of each family, who is harmed, and who takes no part and why."""
        asked, kind = self._asked, rows(self._asked)
        table, lines = kind.table(results), pl.DataFrame([line.names for line in lines_of(asked)])
        days = pl.DataFrame([{**line.names, "days": line.days} for line in lines_of(asked)])
        people = table.filter(reason="").explode("person", "able", *METRICS).join(days, on=LINE, maintain_order="left")
        known = people.filter("able", *(pl.col(name).is_finite() for name in METRICS)).select(
            *LINE, "person", *METRICS, insulin_U_day=pl.col("insulin_total_mU") / 1000.0 / pl.col("days")
        )
        wanted = lines.group_by("family", maintain_order=True).agg(
            wanted=pl.struct("sensor", "scenario").n_unique().cast(pl.UInt32)
        )
        together = over_all_cells(known, wanted)
        heads = lines.select("family", pl.lit(ALL).alias("sensor"), pl.lit(ALL).alias("scenario"), "controller").unique(
            maintain_order=True
        )
        numbers = line_table(
            pl.concat([together, known]), pl.concat([heads, lines]), asked.reference.label, asked.worse_by_pct
        )
        plain = {
            "config": asked.tree(whole=True),
            "families": list(self._families(people)),
            "rows": numbers.to_dicts(),
            "rankings": [ranking(together, family, asked.seed) for family in asked.family_names],
            "harms": harms(numbers.to_dicts(), asked.reference.label),
            "absent": [*_left_out(asked), *_absent(results)],
            "targets": {name: [bound for bound in bounds if np.isfinite(bound)] for name, bounds in TARGETS.items()},
            "repeat": "glucoloop league --config league.toml --out again",
        }
        return Findings(plain, {"league.csv": numbers, "league.parquet": numbers})

    def _families(self, people: pl.DataFrame) -> Iterator[dict[str, Any]]:
        """Population and people of each family, and what is special about it."""
        for family, alike in groupby(lines_of(self._asked), lambda line: line.family):
            trials = [line.trial for line in alike if line.trial is not None]
            if not trials:
                yield {"family": family, "population": "", "people": 0, "unable": 0, "notes": []}
                continue
            of_family = people.filter(family=family).unique("person").select("able").to_series()
            population, patient = trials[0].population.name, trials[0].patient
            told = []
            if population == NOMINAL:
                told.append("All people are the nominal patient: they differ in their days and readings alone.")
            if not patient.under_the_skin and any(c.controller.gives_boluses for t in trials for c in t.cases):
                told.append(BOLUS_INTO_A_VEIN)
            yield {
                "family": family,
                "population": population,
                "people": trials[0].people,
                "unable": int((~of_family).sum()),
                "notes": told,
            }


search = LeagueSearch


def _absent(results: Sequence[ShardResult]) -> Iterator[str]:
    """Sentences on the pairs that do not go together, on slow engines, and on people whose numbers are not known."""
    refused: dict[tuple[str, str, str], list[str]] = {}
    slow: dict[tuple[str, str], None] = {}
    lost: dict[tuple[str, str], int] = {}
    for result in results:
        line = result.shard.line
        if result.reason:
            where = refused.setdefault((line.controller, line.family, result.reason), [])
            where += [f"{line.sensor}, {line.scenario}"] if not result.shard.number else []
        elif result.lacks:
            slow[line.controller, result.lacks] = None
        finite = np.logical_and.reduce([np.isfinite(result.people[name]) for name in METRICS])
        number = int((result.people["able"] & ~finite).sum())
        if number:
            lost[line.controller, line.family] = lost.get((line.controller, line.family), 0) + number
    for (controller, family, reason), where in refused.items():
        yield f"{controller} takes no part on {family} in {how_many(len(where), 'cell')} ({the_first(where, 2)}): {reason}."
    for controller, lacks in slow:
        yield f"{controller} is computed by the slower engine xla, since native code lacks {lacks}."
    for (controller, family), number in lost.items():
        yield (
            f"{controller} on {family}: the numbers of {how_many(number, 'run')} did not stay finite; these people are "
            "left out of its numbers there, and of the ranking."
        )


# ---------------------------------------------------------------------------------------------- how it is shown


def _by_family(found: Findings) -> dict[str, list[Row]]:
    return {
        family: [r for r in found.rows if r["family"] == family]
        for family in dict.fromkeys(r["family"] for r in found.rows)
    }


def cell_name(row: Row) -> str:
    """Sensor and scenario of a row, or both together."""
    return "all cells" if row["sensor"] == ALL else f"{row['sensor']}, {row['scenario']}"


def tables(asked: League, found: Findings) -> Iterator[FittingTable]:
    """A section for each family and a line for each controller, over all cells."""
    sections = [
        (family, [(row["controller"], [row]) for row in rows if row["sensor"] == ALL])
        for family, rows in _by_family(found).items()
    ]
    yield terminal_table(
        "Controller",
        sections,
        COLUMNS,
        caption=f"Over all sensors and scenarios. In bold: on target (Battelino et al., 2019). Harmed: people below 54 "
        f"or 70 mg/dl for over {asked.worse_by_pct:g} % of the time longer than under {asked.reference.label}. Less "
        "ref.: the mean difference from it. GRI: glycemia risk index, 0 is best.",
    )


def sentences(asked: League, found: Findings) -> Iterator[str]:
    """Who is best for whom, where each does harm, and who takes no part."""
    for of in found.plain["rankings"]:
        yield _verdict(
            of, {r["controller"]: r for r in found.rows if r["family"] == of["family"] and r["sensor"] == ALL}
        )
    reference = asked.reference.label
    for row in found.plain["harms"]:
        yield (
            f"{row['controller']} does most harm on {row['family']} ({cell_name(row)}): compared with {reference}, "
            f"{row['harmed_below_54']} of {how_many(row['people'], 'person', 'people')} are below 54 mg/dl for over "
            f"{asked.worse_by_pct:g} % of the time longer (half of all people by {row['more_below_54_median_pct']:+z.1f} "
            f"% or more, the worst by {row['more_below_54_most_pct']:+z.1f} %), and {row['harmed_below_70']} below 70 mg/dl."
        )
    yield from found.plain["absent"]


def _verdict(of: Mapping[str, Any], rows: Mapping[str, Row]) -> str:
    """Best overall, best for the worst-off, for how many people each is best, and whom the best one harms."""
    if not of["people"]:
        return f"{of['family']}: no controller took part in all cells with people whose numbers are known."
    overall, worst = of["overall"], of["worst_off"]
    whom = sorted(((number, label) for label, number in of["for_whom"].items() if number), reverse=True)
    best_for = "; ".join(f"{label} for {number}" for number, label in whom) or "no single controller for anybody"
    row = rows[overall["best"]]
    harmed = row["harmed_below_54"]
    harm = "nobody is" if not harmed else f"{how_many(harmed, 'person is', 'people are')}"
    return (
        f"{of['family']}: best overall is {_first(overall)}. For the worst-off tenth, "
        f"{how_many(worst['people'], 'person', 'people')}, it is {_first(worst)}. Of "
        f"{how_many(of['people'], 'person', 'people')}, the least index is with {best_for}. With {overall['best']} "
        f"{harm} harmed below 54 mg/dl."
    )


def _first(of: Mapping[str, Any]) -> str:
    """The best controller, and how far ahead of the next it is."""
    best = f"{of['best']} with a glycemia risk index of {of['gri'][of['best']]:.1f}"
    if "second" not in of:
        return f"{best}, the only one"
    interval = "" if of["low"] is None else f" (95 % interval {of['low']:z.1f} to {of['high']:z.1f})"
    told = f"{of['difference']:.1f}{interval} less than {of['second']}, the next"
    return f"{best}, {told}" if of["told_apart"] else f"{best}, which is not told apart from {of['second']}: {told}"


_ZONES: Final = tuple(
    shade._replace(most=most, label=label)
    for shade, (most, label) in zip(
        SHADES_PCT[1:],
        ((20.0, "A: to 20"), (40.0, "B: to 40"), (60.0, "C: to 60"), (80.0, "D: to 80"), (100.0, "E: above 80")),
        strict=False,
    )
)
"""Zones of the glycemia risk index, of D. C. Klonoff et al., J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023."""


def family_map(family: str, rows: Sequence[Row]) -> HeatMap:
    """Glycemia risk index of a family: cells in rows, all of them first, and controllers across."""
    by_place = {(cell_name(row), row["controller"]): row for row in rows}
    risk = next(column for column in COLUMNS if column.name == "gri_mean")

    def cell(name: str, controller: str) -> HeatCell:
        row = by_place[name, controller]
        told = [f"{controller}, {family}, {name}"]
        for group, columns in headings(COLUMNS):
            told.append(f"{group}: {', '.join(f'{column.head} {column.value_text(row)}' for column in columns)}")
        shade = UNKNOWN
        if row["gri_mean"] is not None:
            shade = next((zone for zone in _ZONES if row["gri_mean"] <= zone.most), _ZONES[-1])
        harmed = row["harmed_below_54"]
        return HeatCell(shade, risk.value_text(row), f"▲{harmed}" if harmed else "", "\n".join(told))

    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    return HeatMap("Glycemia risk index", list(dict.fromkeys(map(cell_name, rows))), controllers, cell)


def page(asked: League, found: Findings) -> str:
    """The page of a league: one file that needs neither network nor script."""
    families, by_family = {of["family"]: of for of in found.plain["families"]}, _by_family(found)
    maps = {family: family_map(family, rows) for family, rows in by_family.items()}
    unknown = any(cell.shade is UNKNOWN for each in maps.values() for cell in each.cells())
    bodies = {
        family: [(name, [(row["controller"], row) for row in alike]) for name, alike in groupby(rows, cell_name)]
        for family, rows in by_family.items()
    }
    said = list(sentences(asked, found))[: len(found.rows)]
    verdicts = dict(zip(by_family, said, strict=False))
    facts = {
        "People": f"{asked.people} of each family, or all of one that has fewer",
        "Scenarios": "; ".join(texts(asked.scenarios)),
        "Sensors": "; ".join(texts(asked.sensors)),
        "Controllers": "; ".join(case.label for case in asked.cases),
        "Reference": asked.reference.label,
        "Seed": str(asked.seed),
    }
    files = {"league.csv": "all numbers", "people.parquet": "metrics of each person", "summary.json": "what was found"}
    return render(
        Path(__file__).with_name("page.html"),
        "League of controllers",
        sentences=said[len(by_family) : len(by_family) + len(found.plain["harms"])],
        facts=facts,
        repeat=Repeat("league --config league.toml", asked.tree(whole=True), files, given=asked.tree()),
        asked=asked,
        families=families,
        verdicts=verdicts,
        rankings=found.plain["rankings"],
        maps=maps,
        shades=[*_ZONES, *([UNKNOWN] if unknown else [])],
        bodies=bodies,
        columns=COLUMNS,
        absent=found.plain["absent"],
    )


def drawn(asked: League, found: Findings) -> dict[str, bytes]:
    """The page, by the name of its file."""
    return {"league.html": page(asked, found).encode()}
