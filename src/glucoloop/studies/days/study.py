"""Work of a comparison with a record: habits, scenario, therapy, and the numbers of virtual people beside the record's.

The therapy of the record is scaled to each virtual person: the basal rate at which the person rests at the level of the
record's nights, in the hours of the day as the record has it, with a carbohydrate ratio and a correction factor that
are to it as those of the record are to its basal rate.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.component.grammar import NAME, as_tree
from glucoloop.component.request import Request, completed
from glucoloop.display_units import OTHERS, other_number
from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY, GriddedRecord
from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.profile import PARTS_OF_DAY, by_time_of_day
from glucoloop.metrics.readings.series import Readings
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import MetricRow, lines_table
from glucoloop.reporting.record_groups import GOALS, ReportedGroup, ReportedRecord
from glucoloop.reporting.record_page import medians_plot
from glucoloop.reporting.template import render
from glucoloop.situations.scenarios import SCENARIOS
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.storage.results import Results
from glucoloop.studies.days import SCENARIO, TRIAL, DaysRequest
from glucoloop.studies.days.habits import (
    Gaps,
    Habits,
    WeekendDifference,
    filled,
    habits_of,
    meals_of,
    rises_of,
)
from glucoloop.studies.days.scenario import scenario_text
from glucoloop.studies.twin.study import record_of
from glucoloop.text import how_many
from glucoloop.therapy import BASAL_SHARE, CARB_RULE
from glucoloop.trials.engine import prepare, run_people
from glucoloop.trials.trial import Trial, profile_columns
from glucoloop.units import HOURS_PER_DAY, MU_PER_U

Values = npt.NDArray[np.float64]

_RECORD: Final = "Record"
_NIGHT: Final = next(iter(PARTS_OF_DAY))
_BLOCK_H: Final = 3
"""Hours of the day that have one basal rate."""
_SETPOINT_MG_DL: Final = (90.0, 180.0)
"""Bounds of the glucose at which virtual people rest."""
_PARTS_PCT: Final = (10.0, 1000.0)
_RANGE: Final = (5.0, 95.0)
_AUTOMATIC_PCT: Final = 5.0
_MANY_ALONE: Final = 0.25
"""Share of boluses without entered carbohydrate from which on it is told."""
_FEW_MEALS: Final = 2.0
_FIRST: Final = dt.datetime(2024, 1, 1)
"""Day 1 of virtual people, a Monday."""


class _Number(NamedTuple):
    """A number that stands side by side."""

    name: str
    section: str
    title: str
    words: str
    """Name in a sentence."""
    unit: str
    digits: int = 1


_TIME, _NIGHTS, _RISES, _GIVEN = "Time", "Nights, 0 to 6 h", "Rises by 60 mg/dl in 90 min", "Entered and given"
NUMBERS: Final = (
    _Number("mean_mg_dl", "Glucose", "Mean", "mean", "mg/dl", 0),
    _Number("sd_mg_dl", "Glucose", "Standard deviation", "standard deviation", "mg/dl", 0),
    _Number("cv_pct", "Glucose", "Coefficient of variation", "coefficient of variation", "%"),
    _Number("time_below_54_pct", _TIME, "Below 54 mg/dl", "time below 54 mg/dl", "%"),
    _Number("time_below_70_pct", _TIME, "Below 70 mg/dl", "time below 70 mg/dl", "%"),
    _Number("time_70_180_pct", _TIME, "From 70 to 180 mg/dl", "time from 70 to 180 mg/dl", "%"),
    _Number("time_above_180_pct", _TIME, "Above 180 mg/dl", "time above 180 mg/dl", "%"),
    _Number("time_above_250_pct", _TIME, "Above 250 mg/dl", "time above 250 mg/dl", "%"),
    _Number("night_mean_mg_dl", _NIGHTS, "Mean", "mean of the nights", "mg/dl", 0),
    _Number("night_sd_mg_dl", _NIGHTS, "Standard deviation", "standard deviation of the nights", "mg/dl", 0),
    _Number("night_time_below_70_pct", _NIGHTS, "Below 70 mg/dl", "nights below 70 mg/dl", "%"),
    _Number("night_time_70_180_pct", _NIGHTS, "From 70 to 180 mg/dl", "nights from 70 to 180 mg/dl", "%"),
    _Number("rises_day", _RISES, "Rises a day", "rises", ""),
    _Number("rises_not_entered_pct", _RISES, "Without entered carbohydrate", "rises without carbohydrate", "%", 0),
    _Number("meals_day", _GIVEN, "Entered meals a day", "entered meals", ""),
    _Number("carbs_g_day", _GIVEN, "Entered carbohydrate a day", "entered carbohydrate", "g", 0),
    _Number("insulin_by_basal", _GIVEN, "All insulin over basal insulin", "insulin over basal insulin", "", 2),
)
"""The numbers, of the record and of each virtual person."""


class _People(NamedTuple):
    """Virtual people under a controller."""

    label: str
    days: Sequence[GriddedRecord]
    """Days of each person, as a record has them."""


@dataclasses.dataclass(frozen=True)
class _Compared:
    record: GriddedRecord
    people: tuple[_People, ...]
    scenario: str
    trial: Trial


def results_of(config: DaysRequest, progress: Callable[[str], None]) -> Results:
    """Learn the habits, and let virtual people live them; Refusal for a record that does not tell them."""
    record = record_of(config)
    try:
        habits = habits_of(record)
    except Refusal as error:
        raise error.within(", ".join(config.files)) from None
    progress(f"habits of {how_many(habits.days, 'day')}")
    scenario = scenario_text(habits, record)
    trial = _trial_of(config, habits, record, scenario)
    people = tuple(
        _lived(trial, label, habits.eaten_over_entered, progress) for label in [case.label for case in trial.cases]
    )
    rows = [{"who": _RECORD, **_numbers(record)}]
    over_people = []
    for of_case in people:
        table = pl.DataFrame([_numbers(days) for days in of_case.days])
        for what, percentage in (("median", 50.0), ("low", _RANGE[0]), ("high", _RANGE[1])):
            values = {name: _percentile(table[name].to_numpy(), percentage) for name in table.columns}
            over_people.append({"who": of_case.label, "over_people": what, **values})
    rows += [{"who": row["who"], **row} for row in over_people]
    plain = {
        "habits": _plain(habits),
        "therapy": list(trial.therapy),
        "setpoint_mg_dl": trial.target_mg_dl,
        "people": {of_case.label: len(of_case.days) for of_case in people},
        "config": config.tree(whole=True),
        "rows": rows,
        "notes": [*record.notes, *_notes(habits, record, trial, people)],
    }
    table = pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)
    return Results(plain, {"numbers.csv": table}, _Compared(record, people, scenario, trial))


def _plain(habits: Habits) -> dict[str, Any]:
    named = {
        name: value._asdict() for name, value in vars(habits).items() if isinstance(value, WeekendDifference | Gaps)
    }
    occasions = {
        name: [{**one._asdict(), "per_day": one.per_day} for one in getattr(habits, name)]
        for name in ("entered", "not_entered")
    }
    return {**vars(habits), **named, **occasions}


def _percentile(values: Values, percentage: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percentage)) if known.size else float("nan")


def _trial_of(config: DaysRequest, habits: Habits, record: GriddedRecord, scenario: str) -> Trial:
    """Trial of the virtual people."""
    own = {name: value for name, value in config.explicit.items() if name in Trial.settings()}
    night = record.reading_mg_dl.reshape(record.days, -1)[:, : SAMPLES_PER_DAY // 4]
    night = night if np.isfinite(night).any() else record.reading_mg_dl
    setpoint = float(np.clip(round(float(np.nanmedian(night))), *_SETPOINT_MG_DL))
    settings = {
        "people": config.people,
        "patient": config.patient,
        "controller": config.controller,
        "rescue": config.rescue,
        "setpoint_mg_dl": setpoint,
        **own,
        "scenario": SCENARIOS.read({NAME: "custom", **as_tree(read_toml(scenario, SCENARIO).keys, SCENARIO)}),
        "traces": "all",
    }
    trial = completed(Request(Trial, settings))
    texts = _therapy_texts(habits, record, ratios=not profile_columns(trial))
    return completed(Request(Trial, {**settings, "therapy": tuple(texts)}))


def _therapy_texts(habits: Habits, record: GriddedRecord, *, ratios: bool) -> Iterator[str]:
    """Therapy of the record in parts of what each person needs."""
    by_hour = record.basal_U.reshape(record.days, round(HOURS_PER_DAY / _BLOCK_H), -1).mean(axis=(0, 2))
    for block, part in enumerate(by_hour / by_hour.mean()):
        yield f"basal, {_part_pct(part)}%, {_BLOCK_H * block}h-{_BLOCK_H * (block + 1)}h"
    if ratios:
        by_basal_U = float(record.basal_U.sum()) / record.days / BASAL_SHARE
        yield f"carb_ratio, {_part_pct(habits.eaten_over_entered * habits.carb_ratio_g_U * by_basal_U / CARB_RULE)}%"
        yield f"correction, {_part_pct(by_basal_U / record.total_daily_dose_U)}%"


def _part_pct(part: float) -> str:
    return f"{np.clip(100.0 * part, *_PARTS_PCT):.0f}"


def _lived(trial: Trial, label: str, eaten_over_entered: float, progress: Callable[[str], None]) -> _People:
    """Days of the virtual people under a controller, with entries in the unit of those of the record."""
    numbers = np.arange(trial.people, dtype=np.int64)
    result = run_people(prepare(trial), label, numbers, traces=True)
    assert result.glucose_mg_dl is not None
    assert result.insulin_mU_min is not None
    whole = np.flatnonzero(result.feasible & np.isfinite(result.glucose_mg_dl).all(axis=0))
    if not whole.size:
        raise Refusal(
            f"nobody of {trial.population.name} can rest at {trial.target_mg_dl:g} mg/dl; give another --setpoint, or "
            "another --patient"
        )
    progress(label)
    days = trial.drawn_days(numbers)
    samples = trial.samples
    entered = np.zeros((samples, numbers.size))
    at = np.floor(days.announced_min / SAMPLE_MIN).astype(np.int64)
    # A meal of the plan without a bolus is entered too, as in the record; see `habits.Habits.without_bolus`.
    entered_g = np.where(days.of_plan[:, None] & (days.announced_g == 0.0), days.carbs_g, days.announced_g)
    inside = (at >= 0) & (at < samples) & (entered_g > 0.0) & (days.carbs_g > 0.0)
    rows, people = np.nonzero(inside)
    np.add.at(entered, (at[rows, people], people), entered_g[rows, people])
    given_U = result.insulin_mU_min.astype(np.float64) * SAMPLE_MIN / MU_PER_U
    basal_U = np.broadcast_to(result.basal_insulin_mU_min * SAMPLE_MIN / MU_PER_U, given_U.shape)
    return _People(
        label,
        [
            GriddedRecord(
                first=_FIRST,
                reading_mg_dl=result.glucose_mg_dl[1:, person].astype(np.float64),
                basal_U=basal_U[:, person],
                user_bolus_U=given_U[:, person] - basal_U[:, person],
                automatic_bolus_U=np.zeros(samples),
                carbs_g=entered[:, person] / eaten_over_entered,
                basal_off_schedule_pct=0.0,
            )
            for person in whole
        ],
    )


def _numbers(days: GriddedRecord) -> dict[str, float]:
    """Numbers of a record, or of the days of a virtual person."""
    there = np.isfinite(days.reading_mg_dl)
    readings = Readings.of(SAMPLE_MIN * (np.flatnonzero(there) + 1.0), days.reading_mg_dl[there])
    whole = filled(days)
    rises = rises_of(whole)
    values = {
        **numbers_of(readings),
        **{f"night_{name}": value for name, value in dict(by_time_of_day(readings))[_NIGHT].items()},
        "rises_day": len(rises) / (days.days * float(np.isfinite(whole.reading_mg_dl).mean())),
        "rises_not_entered_pct": 100.0 * float(np.mean([not rise.entered for rise in rises])) if rises else np.nan,
        "meals_day": meals_of(days).size / days.days,
        "carbs_g_day": float(days.carbs_g.sum()) / days.days,
        "insulin_by_basal": float(days.insulin_U.sum() / days.basal_U.sum()),
    }
    return {number.name: values.get(number.name, np.nan) for number in NUMBERS}


def _notes(habits: Habits, record: GriddedRecord, trial: Trial, people: Sequence[_People]) -> Iterator[str]:
    """Sentences on what the comparison rests on."""
    rule_g = habits.carb_ratio_g_U * record.total_daily_dose_U
    yield (
        f"Virtual people rest at {trial.target_mg_dl:.0f} mg/dl, the median of the record's nights, under the basal "
        "rate that each needs for it; ratio and factor are to it as those of the record are to its own basal rate."
    )
    yield "Their numbers are of glucose itself, without the noise and the gaps of a sensor."
    if record.automatic_insulin_pct > _AUTOMATIC_PCT:
        yield (
            f"Automation dosed {record.automatic_insulin_pct:.0f} % of the insulin of the record. No controller here "
            "is that automation; --controller oref0 or loop-like is one of its kind."
        )
    meals = sum(occasion.per_day for occasion in habits.entered)
    if meals < _FEW_MEALS:
        yield (
            f"Only {meals:.1f} meals a day are entered, so most of what is eaten stands as snacks that rises of "
            "glucose tell, and smaller meals are lacking."
        )
    if habits.bolus_alone > _MANY_ALONE:
        yield (
            f"{100.0 * habits.bolus_alone:.0f} % of the person's boluses have no carbohydrate entered within 30 min: "
            "they correct, or are for something that was not entered. Virtual people have no bolus there."
        )
    if habits.eaten_over_entered != 1.0:
        yield (
            f"The carbohydrate ratio times the daily dose is {rule_g:.0f} g, where the rule has {CARB_RULE:.0f} g: "
            f"meals are taken to be {habits.eaten_over_entered:.2g} times what is entered."
        )
    for of_case in people:
        left_out = trial.people - len(of_case.days)
        if left_out:
            yield f"{how_many(left_out, 'person', 'people')} cannot rest there, and are left out of {of_case.label}."


def _cells(results: Results) -> tuple[list[str], list[MetricRow]]:
    """Headings, and a row for each number."""
    by_who: dict[str, list[Mapping[str, Any]]] = {}
    for row in results.rows:
        by_who.setdefault(row["who"], []).append(row)
    rows = []
    for number in NUMBERS:
        texts, others = list[str](), list[str]()
        for of in by_who.values():
            values = [row[number.name] for row in of]
            own = [_text(value, number) for value in values]
            texts.append(_beside(own))
            other = [
                other_number(text, value or 0.0, number.unit) if number.unit in OTHERS else text
                for text, value in zip(own, values, strict=True)
            ]
            others.append(_beside(other))
        rows.append(
            MetricRow(number.section, number.title, number.unit, texts, others if number.unit in OTHERS else None)
        )
    return list(by_who), rows


def _text(value: float | None, number: _Number) -> str:
    return "none" if value is None else f"{value:z.{number.digits}f}"


def _beside(texts: Sequence[str]) -> str:
    return texts[0] if len(texts) == 1 else f"{texts[0]} ({texts[1]} to {texts[2]})"


def tables(config: DaysRequest, results: Results) -> Iterator[object]:
    """The record beside the virtual people."""
    heads, rows = _cells(results)
    yield lines_table("Number", heads, rows)


def sentences(config: DaysRequest, results: Results) -> Iterator[str]:
    """Sentences on the habits, and on where the record lies among the virtual people."""
    habits = results.plain["habits"]
    yield (
        f"By {habits['days']} days of the record: {_a_day(habits['entered'])}, and {_a_day(habits['not_entered'])} "
        "that nobody entered, as rises of glucose tell it."
    )
    record, *others = results.rows
    for label, people in results.plain["people"].items():
        _, low, high = (row for row in others if row["who"] == label)
        outside = [number.words for number in NUMBERS if _outside(record, low, high, number.name)]
        yield (
            f"{label}, {how_many(people, 'person', 'people')}: the record lies outside of nine of ten of them in "
            f"{len(outside)} of {len(NUMBERS)} numbers{': ' if outside else ''}{', '.join(outside)}."
        )
    yield (
        "In brackets: nine of ten virtual people. What differs is what the habits, the therapy or the patient model "
        "lack; the comparison does not tell which."
    )


def _a_day(occasions: Sequence[Mapping[str, float]]) -> str:
    meals = sum(one["per_day"] for one in occasions)
    carbs_g = sum(one["per_day"] * one["carbs_g"] for one in occasions)
    return f"{meals:.1f} meals with {carbs_g:.0f} g a day"


def _outside(record: Mapping[str, Any], low: Mapping[str, Any], high: Mapping[str, Any], name: str) -> bool:
    value, least, most = record[name], low[name], high[name]
    return None not in (value, least, most) and not least <= value <= most


def files_of(config: DaysRequest, results: Results) -> dict[str, bytes]:
    """The scenario, the configuration of the trial, and the page."""
    compared: _Compared = results.extra
    heads, rows = _cells(results)
    record = _reported(_RECORD, compared.record)
    groups = [
        ReportedGroup(of_case.label, [_reported(of_case.label, days) for days in of_case.days])
        for of_case in compared.people
    ]
    page = render(
        Path(__file__).with_name("page.html"),
        "Days of a record",
        sentences=[*sentences(config, results), *results.plain["notes"]],
        facts={
            "Record": f"{how_many(compared.record.days, 'day')}, {compared.record.total_daily_dose_U:.0f} U a day",
            "Virtual people": f"{compared.trial.people} of {compared.trial.patient.display_name}",
            "Therapy": "; ".join(compared.trial.therapy),
        },
        script=True,
        plot=medians_plot([record, *groups], GOALS["adult"]),
        heads=heads,
        rows=rows,
        scenario=compared.scenario,
        file=SCENARIO,
    )
    explicit = compared.trial.tree() | {"traces": "none"}
    return {
        SCENARIO: compared.scenario.encode(),
        TRIAL: toml_text(compared.trial.tree(whole=True), f"trial --config {TRIAL}", explicit).encode(),
        "page.html": page.encode(),
    }


def _reported(label: str, days: GriddedRecord) -> ReportedRecord:
    there = np.isfinite(days.reading_mg_dl)
    return ReportedRecord(label, Readings.of(SAMPLE_MIN * (np.flatnonzero(there) + 1.0), days.reading_mg_dl[there]), {})


def next_steps(results: Results, files: Mapping[str, str]) -> Iterator[str]:
    """Sentences on the use of the files."""
    if SCENARIO in files:
        yield f"These days in any command: --scenario {files[SCENARIO]}"
        yield f"The trial again, with another controller: glucoloop trial --config {files[TRIAL]} --controller oref0"
