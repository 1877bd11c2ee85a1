"""Distance to what could be reached at all: the best doses that are found for the first people of a family.

A person under a controller is compared with the same person under the best doses, on the same days and meals; a sensor
plays no part in those, since the person is known.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.bounds import IN_ADVANCE, LeastRiskDoses, least_risk_doses
from glucoloop.meals import Scenario
from glucoloop.metrics.readings import Readings
from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.patients.population import of_people
from glucoloop.patients.protocol import Patient
from glucoloop.reporting.columns import Column, Row, decimals, terse_percent, whole
from glucoloop.studies.league.numbers import ALL, GLUCAGON_UG, LINE, METRICS, RESCUE_CARBS, difference, factors, signed
from glucoloop.text import how_many
from glucoloop.trials.engine import person_of
from glucoloop.trials.trial import Trial

START, ADVANCE = "start", "advance"
KNOWN: Final = {START: 0.0, ADVANCE: IN_ADVANCE}
"""Time at which a meal is known, counted from its start, by the name under which the best doses are kept."""
_OF: Final = {"gri": "gri", "in_range_pct": "time_70_180_pct"}
"""Metric of each number of the best doses that is shown."""


class BestDoses:
    """Search of the best doses of people of a league; meals known in advance continue from meals known at the start."""

    def __init__(self) -> None:
        self._last: tuple[Trial, int, LeastRiskDoses] | None = None

    def of(self, trial: Trial, person: int, information: str) -> dict[str, npt.NDArray[Any]]:
        """A person of a trial under the best doses: ``person``, ``able``, and the metrics, NaN where not known."""
        people, scenario = person_of(trial, person)
        able, metrics = bool(people.feasible[0]), dict.fromkeys(METRICS, math.nan)
        if able:
            patient = of_people(people.patient, 0)
            results = self._from_start(trial, person, patient, scenario)
            if information == ADVANCE:
                results = _search(trial, patient, scenario, KNOWN[information], results.insulin_mU_min)
            metrics |= _metrics(results, trial.sample_time_min)
        columns = {name: np.array([value]) for name, value in metrics.items()}
        return {"person": np.array([person]), "able": np.array([able]), **columns}

    def _from_start(self, trial: Trial, person: int, patient: Patient, scenario: Scenario) -> LeastRiskDoses:
        last = self._last
        if last is None or last[0] is not trial or last[1] != person:
            self._last = last = trial, person, _search(trial, patient, scenario, KNOWN[START])
        return last[2]


def _search(
    trial: Trial,
    patient: Patient,
    scenario: Scenario,
    known_after_min: float,
    start_mU_min: npt.NDArray[np.float64] | None = None,
) -> LeastRiskDoses:
    return least_risk_doses(
        patient,
        scenario,
        known_after_min=known_after_min,
        sample_time_min=trial.sample_time_min,
        start_mU_min=start_mU_min,
    )


def _metrics(results: LeastRiskDoses, sample_time_min: float) -> dict[str, float]:
    """Metrics of people under the best doses, of those that are known; none where glucose is not finite."""
    if not math.isfinite(results.gri):
        return {}
    numbers = numbers_of(Readings.of(results.fine_t_min, results.glucose_mg_dl)) | {
        "minimum_mg_dl": float(results.glucose_mg_dl.min()),
        "insulin_total_mU": float(results.insulin_mU_min.sum() * sample_time_min),
        **dict.fromkeys((RESCUE_CARBS, GLUCAGON_UG), 0.0),
    }
    return {name: numbers[name] for name in METRICS if name in numbers}


def beside(people: pl.DataFrame, best: pl.DataFrame, scenarios: int) -> pl.DataFrame:
    """People with what the best doses reach on the same person, and the distance to it; null where that is not known.

    `best` has ``family``, ``scenario``, ``controller``, which is one of `KNOWN`, ``person`` and the metrics. Beside the
    line of a person over all cells stand the means over all `scenarios`.
    """
    place = ("family", "scenario", "person")
    for information in KNOWN:
        names = {f"{information}_{name}": pl.col(metric) for name, metric in _OF.items()}
        of = best.filter(controller=information).select(*place, **names)
        over = of.group_by("family", "person", maintain_order=True).agg(pl.col(*names).mean(), pl.len())
        over = over.filter(pl.col("len") == scenarios).with_columns(scenario=pl.lit(ALL)).select(of.columns)
        people = people.join(pl.concat([of, over]), on=place, how="left", maintain_order="left").with_columns(
            (pl.col("gri") - pl.col(f"{information}_gri")).alias(f"gri_above_{information}"),
            (pl.col(f"{information}_in_range_pct") - pl.col("time_70_180_pct")).alias(
                f"in_range_below_{information}_pct"
            ),
        )
    same = pl.col("start_gri").is_not_null()
    return people.with_columns(
        same_gri=pl.when(same).then("gri"),
        same_in_range_pct=pl.when(same).then("time_70_180_pct"),
        same_factor=factors(people.select(pl.col("start_gri").count().over(LINE)).to_series()),
    )


_SAME: Final = "The same people"
_LABELS: Final = {START: "Best doses, meals known from their start", ADVANCE: "Best doses, meals known in advance"}


def _means(of: str, group: str) -> list[Column]:
    column = functools.partial(Column, group=group)
    gri, in_range = (pl.col(f"{of}_{name}").mean() for name in _OF)
    return [
        column(name=f"{of}_gri_mean", value=gri, head="GRI", text=decimals(1)),
        column(name=f"{of}_in_range_mean_pct", value=in_range, head="70-180 (%)", short_text=terse_percent),
    ]


def _distance(information: str) -> list[Column]:
    """Distance from the best doses with its intervals, of which the page has one; the files have them all."""
    more, label = functools.partial(difference, factor="same_factor"), _LABELS[information]
    short = "GRI over\nbest" if information == START else None
    gri, *gri_interval = more(f"gri_above_{information}", f"gri_above_{information}", label, short)
    below, *below_interval = more(f"in_range_below_{information}_pct", f"in_range_below_{information}_pct", label)
    interval = gri_interval if information == START else map(_not_on_page, gri_interval)
    on_page = replace(gri, head="GRI above"), *interval, replace(below, head="70-180 (%) below")
    return [*on_page, *map(_not_on_page, below_interval)]


def _not_on_page(column: Column) -> Column:
    return replace(column, group="", head="")


_known: Final = pl.col("same_gri").count()
COLUMNS: Final = (
    Column(name="same_people", value=_known, empty=0, group=_SAME, head="known", text=whole),
    *_means("same", _SAME),
    *(column for known, label in _LABELS.items() for column in (*_means(known, label), *_distance(known))),
)
"""Numbers of a controller in a cell beside the best doses."""

CAPTION: Final = (
    "Best doses: any dose in each sample, a bolus too, for a person who is known exactly, searched for the minimum "
    "glycemia risk index, where each meal is known from its start, or all in advance. What was found can be reached; "
    "better doses may exist, and a controller that bets on a meal to come can do better than doses for meals that are "
    "known from their start."
)


def _first_table() -> Iterator[Column]:
    nearest, groups = "Nearest controller", {START: "Known from their start", ADVANCE: "Known in advance"}
    by_name = {column.name: column for column in COLUMNS}

    def shown(name: str, group: str, short: str | None = None, **others: Any) -> Column:
        return replace(by_name[name], value=None, empty=None, group=group, short=short, **others)

    yield shown("same_people", "People", "people")
    for known, group in groups.items():
        yield shown(f"{known}_gri_mean", group, f"{known}\nGRI")
        yield shown(f"{known}_in_range_mean_pct", group, f"{known}\n70-180 %")
    yield Column(name="nearest", group=nearest, head="name", text=str, short="nearest", left=True)
    yield shown("same_gri_mean", nearest, "its\nGRI")
    yield shown("same_in_range_mean_pct", nearest, "its\n70-180 %")
    yield shown("gri_above_start", nearest, "GRI over\nstart", head="GRI above")
    yield shown("gri_above_start_low", nearest)
    yield shown("gri_above_start_high", nearest)


NEAREST: Final = tuple(_first_table())
"""Numbers of the best doses of a family, and of the controller whose index is nearest to theirs."""


def nearest(rows: Sequence[Row]) -> list[Row]:
    """Lines that are nearest to the best doses: of each family over all cells, and in each scenario."""
    best: dict[tuple[str, str], Row] = {}
    for row in rows:
        place = row["family"], row["scenario"]
        if not row["same_people"]:
            continue
        name = row["controller"] if row["sensor"] == ALL else f"{row['controller']}, {row['sensor']}"
        if place not in best or row["gri_above_start"] < best[place]["gri_above_start"]:
            best[place] = {**row, "nearest": name}
        elif row["gri_above_start"] == best[place]["gri_above_start"]:
            best[place] = {**best[place], "nearest": f"{best[place]['nearest']}; {name}"}
    families = list(dict.fromkeys(family for family, _ in best))
    return sorted(best.values(), key=lambda row: families.index(row["family"]))


def distances(rows: Sequence[Row]) -> str:
    """Sentence on the distance of each controller of a family over all cells, the nearest first; empty if not known."""
    known = [row for row in rows if row["sensor"] == ALL and row["same_people"]]
    ordered = sorted(known, key=lambda row: float(row["gri_above_start"]))
    if not ordered:
        return ""
    people = how_many(max(row["same_people"] for row in known), "person", "people")
    listed = "; ".join(f"{row['controller']} {signed(row['gri_above_start'])}" for row in ordered)
    return f"Index above that of the best doses for meals known from their start, on {people}: {listed}."
