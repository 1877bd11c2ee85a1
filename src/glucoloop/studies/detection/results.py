"""Output of a test of estimators of meals: files and plain values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import polars as pl

from glucoloop.report.print_figure import figure_files
from glucoloop.situations.toml import toml_text
from glucoloop.storage.strict_json import json_text, with_version
from glucoloop.storage.tables import csv, parquet
from glucoloop.studies.detection.detection import Detection
from glucoloop.studies.detection.figure import plot_detection
from glucoloop.studies.detection.keys import detection_keys
from glucoloop.studies.detection.result import DetectionResult

CONFIGURATION = "detect.toml"


def report(detection: Detection, result: DetectionResult) -> dict[str, Any]:
    """Plain values for JSON."""
    return {
        "config": detection_keys(detection),
        "days": result.days,
        "unable": result.infeasible,
        "estimators": {of.estimator: of.summary() for of in result.estimators},
        "curves": {
            of.estimator: {name: _plain(values) for name, values in of.curve.columns().items()}
            for of in result.estimators
        },
    }


def files_of(detection: Detection, result: DetectionResult) -> dict[str, bytes]:
    """The files of a folder, by name."""
    files = {
        "detect.json": (json_text(with_version(report(detection, result))) + "\n").encode(),
        CONFIGURATION: toml_text(
            detection_keys(detection), f"detect --config {CONFIGURATION}", detection.given
        ).encode(),
    }
    for name, table in _tables(result).items():
        files |= {f"{name}.csv": csv(table), f"{name}.parquet": parquet(table)}
    return {**files, **figure_files("figure", plot_detection(result, title=title(detection)))}


def title(detection: Detection) -> str:
    """Title of the figure."""
    trial = detection.trial
    people = f"{trial.people} people of {trial.population.name}" if trial.people > 1 else "one person"
    days = "A day" if detection.days == 1 else f"{detection.days} days"
    of = "of each of" if trial.people > 1 else "of"
    under = {case.controller for case in trial.cases}
    return f"{days} {of} {people}, with meals that nobody announced; doses by {', '.join(sorted(under))}"


def notes(detection: Detection, result: DetectionResult) -> Iterator[str]:
    """Further notes, one sentence each."""
    days = "1 day" if result.days == 1 else f"{result.days} days"
    fed = f"{days} with meals and as many without" if detection.trial.plan.meals else f"{days} without a meal"
    yield (
        f"Of {fed}; three numbers are the 10 % quantile, the median and the 90 % "
        f"quantile. A meal is detected above a probability of {detection.threshold:g}; errors of the size are those of "
        "meals that are detected by then."
    )
    if result.infeasible:
        people = "1 person has" if result.infeasible == 1 else f"{result.infeasible} people have"
        yield f"{people} no basal rate that holds them at the setpoint, and take no part."
    late = detection.trial.dead_time_samples * detection.trial.sample_time_min
    if late and not detection.trial.cases[0].known_dead_time:
        yield f"The estimators do not know of the dead time of {late:g} min; --known-dead-time tells it."


def _tables(result: DetectionResult) -> dict[str, pl.DataFrame]:
    """Each meal, each threshold, the error over time and a day, of all estimators."""
    return {
        "meals": _stacked({of.estimator: of.meals.columns() for of in result.estimators}),
        "curve": _stacked({of.estimator: of.curve.columns() for of in result.estimators}),
        "size_error": _stacked({of.estimator: of.size_error.columns() for of in result.estimators}),
        "day": _stacked({of.estimator: of.example.columns() for of in result.estimators}),
    }


def _stacked(parts: Mapping[str, Mapping[str, Any]]) -> pl.DataFrame:
    """Tables stacked with the estimator as their first column; NaN becomes an empty cell."""
    tables = (
        pl.DataFrame(dict(columns)).select(pl.lit(name).alias("estimator"), pl.all()) for name, columns in parts.items()
    )
    return pl.concat(list(tables)).with_columns(pl.col(pl.Float64).fill_nan(None))


def _plain(values: Any) -> list[float | None]:
    return [value if value == value else None for value in values.tolist()]
