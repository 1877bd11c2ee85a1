"""Files of a shard: one row per person and controller, exact counts over time, and traces where they are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.schema.tables import TableBounds
from glucoloop.storage.results import parquet, read_parquet, refusing_damage
from glucoloop.trials.people import PeopleRows, Shard
from glucoloop.trials.statistics import glucose_edges, insulin_edges
from glucoloop.trials.trial import Trial, profile_columns
from glucoloop.units import MIN_PER_WEEK

if TYPE_CHECKING:
    from glucoloop.trials.engine import PeopleResult

PEOPLE: Final = "people.parquet"
BANDS: Final = "bands.parquet"
TRACES: Final = "traces.parquet"
FILES: Final = (PEOPLE, BANDS, TRACES)
BY_WEEK: Final = "glucose_by_week"
"""Quantity of a long run: glucose at all samples of a week, named by the time at which the week begins."""
_MAX_COLUMNS: Final = 256
NAME: Final = "name"
"""Column of the names of people who have one."""
PROFILE: Final = "profile_"
"""Beginning of the columns that tell the profiles of people."""
_FIRST_COLUMNS: Final = ("person", NAME, "controller", "able", "basal_insulin_mU_min")

Simulate = Callable[[str, npt.NDArray[np.int64], bool], "PeopleResult"]
"""Function that simulates people under the controller of a label, with or without their traces."""
Counts = dict[str, npt.NDArray[np.int64]]
"""Counts ``(times, bins)`` by quantity."""


def column_name(parameter: str) -> str:
    """Column name of a parameter: ``M_IHGP.strength`` as ``M_IHGP_strength``, which SQL reads unquoted."""
    return parameter.replace(".", "_")


def edges(trial: Trial) -> dict[str, npt.NDArray[np.float64]]:
    """Edges of the bins in which glucose [mg/dl] and insulin [mU/min] are counted."""
    low = glucose_edges()
    return {"glucose": low, "insulin": insulin_edges(float(trial.limits.max_mU_min)), BY_WEEK: low}


def times(trial: Trial) -> dict[str, npt.NDArray[np.float64]]:
    """Times at which glucose and insulin are counted [min], glucose also at the end; in a long run of a day, and weeks.

    They are the quantities of a trial.
    """
    t_min = trial.sample_time_min * np.arange(trial.counted_samples + 1, dtype=np.float64)
    weeks = {BY_WEEK: MIN_PER_WEEK * np.arange(trial.counted_weeks, dtype=np.float64)} if trial.counted_weeks else {}
    return {"glucose": t_min, "insulin": t_min[:-1], **weeks}


def bounds(trial: Trial, index: int) -> dict[str, TableBounds]:
    """Largest size of each file of a shard."""
    person, cases = trial.shard(index), len(trial.cases)
    table = trial.population.table
    label = max(len(text.encode()) for text in (*(case.label for case in trial.cases), *(table.names if table else ())))
    counted = sum(t_min.size * (edges(trial)[name].size - 1) for name, t_min in times(trial).items())
    traced = int(trial.traced(person).sum())
    rows = person.size * cases
    result = {
        PEOPLE: TableBounds(least_rows=rows, most_rows=rows, columns=_MAX_COLUMNS, longest_text=label),
        BANDS: TableBounds(least_rows=0, most_rows=counted * cases, columns=7, longest_text=label + len(BY_WEEK)),
    }
    if traced:
        rows = traced * (trial.samples + 1) * cases
        result[TRACES] = TableBounds(least_rows=rows, most_rows=rows, columns=5, longest_text=label)
    return result


def compute_shard(trial: Trial, index: int, simulate: Simulate) -> dict[str, bytes]:
    """Simulate the people of a shard under each controller.

    The contents of the files, by name, are the same to the bit on every machine.
    """
    person = trial.shard(index)
    traced = trial.traced(person)
    results = {case.label: simulate(case.label, person, bool(traced.any())) for case in trial.cases}
    files = {
        PEOPLE: parquet(pl.concat([_people_table(trial, label, result) for label, result in results.items()])),
        BANDS: parquet(pl.concat(_count_tables(trial, results))),
    }
    if traced.any():
        files[TRACES] = parquet(pl.concat(_trace_tables(trial, results, traced)))
    return files


def _people_table(trial: Trial, label: str, result: PeopleResult) -> pl.DataFrame:
    table = pl.DataFrame(
        {
            "person": result.person,
            **_names(trial, result.person),
            "controller": pl.repeat(label, result.person.size, eager=True),
            "able": pl.Series(result.feasible),
            "basal_insulin_mU_min": result.basal_insulin_mU_min,
            **{PROFILE + name: values for name, values in result.profile.items()},
            **{column_name(name): values for name, values in result.drawn.items()},
        }
    )
    table = table.hstack([pl.Series(name, values) for name, values in result.metrics.items()])
    # Nothing is known of a person without a basal rate, not even that glucose is never below 60 mg/dl.
    table = table.with_columns(pl.when("able").then(pl.col(list(result.metrics))))
    return table.with_columns(pl.col(pl.Float64).fill_nan(None))


def _names(trial: Trial, person: npt.NDArray[np.int64]) -> dict[str, list[str]]:
    """Column of the names of people, where they have names."""
    names = trial.population.names(trial.seed, person)
    return {} if names is None else {NAME: names}


def _count_tables(trial: Trial, results: Mapping[str, PeopleResult]) -> Iterator[pl.DataFrame]:
    """Tables of the bins with a count above zero."""
    low, t_min = edges(trial), times(trial)
    for label, result in results.items():
        counted = {"glucose": result.glucose_counts, "insulin": result.insulin_counts, BY_WEEK: result.week_counts}
        for quantity in t_min:
            counts = counted[quantity]
            when, number = np.nonzero(counts)
            yield pl.DataFrame(
                {
                    "controller": pl.repeat(label, when.size, eager=True),
                    "quantity": pl.repeat(quantity, when.size, eager=True),
                    "t_min": t_min[quantity][when],
                    "bin": number.astype(np.int32),
                    "low": low[quantity][number],
                    "high": low[quantity][number + 1],
                    "count": counts[when, number].astype(np.int64),
                }
            )


def _trace_tables(
    trial: Trial, results: Mapping[str, PeopleResult], traced: npt.NDArray[np.bool_]
) -> Iterator[pl.DataFrame]:
    t_min = trial.sample_time_min * np.arange(trial.samples + 1, dtype=np.float64)
    for label, result in results.items():
        glucose, insulin = result.glucose_mg_dl, result.insulin_mU_min
        if glucose is None or insulin is None:
            raise TypeError("traces were asked for, but the engine gave none")
        traced_people = result.person[traced]
        after = np.full((1, traced_people.size), np.nan, np.float32)  # no dose follows the end
        table = pl.DataFrame(
            {
                "person": np.repeat(traced_people, t_min.size),
                "controller": pl.repeat(label, traced_people.size * t_min.size, eager=True),
                "t_min": np.tile(t_min, traced_people.size),
                "glucose_mg_dl": glucose[:, traced].astype(np.float32).ravel("F"),
                "insulin_mU_min": np.concatenate([insulin[:, traced].astype(np.float32), after]).ravel("F"),
            }
        )
        yield table.with_columns(pl.col(pl.Float32).fill_nan(None))


def read_people(folder: Path, trial: Trial, index: int) -> dict[str, PeopleRows]:
    """The people of a shard, by controller; ValueError if these are not its people under those of the trial."""
    place = folder / PEOPLE
    table = read_parquet(place, bounds(trial, index)[PEOPLE])
    person = trial.shard(index)
    drawn = {parameter: column_name(parameter) for parameter in trial.population.parameters}
    profile = {name: PROFILE + name for name in profile_columns(trial)}
    with refusing_damage(place):
        yes_or_no = frozenset(name for name, kind in table.schema.items() if kind == pl.Boolean and name != "able")
        table = table.with_columns(pl.exclude("person", NAME, "controller", "able").cast(pl.Float64).fill_null(np.nan))
        metrics = [name for name in table.columns if name not in {*_FIRST_COLUMNS, *drawn.values(), *profile.values()}]
        people = {}
        # Rows of a controller follow one another.
        for position, case in enumerate(trial.cases):
            rows = table.slice(position * person.size, person.size)
            if not (rows["controller"] == case.label).all() or not np.array_equal(rows["person"], person):
                raise Refusal(f"the rows of {case.label!r} are not those of persons {person[0]} to {person[-1]}")
            of_case = {column.name: column.to_numpy() for column in rows}
            people[case.label] = PeopleRows(
                person=of_case["person"],
                feasible=of_case["able"],
                basal_insulin_mU_min=of_case["basal_insulin_mU_min"],
                drawn={name: of_case[column] for name, column in drawn.items()},
                profile={name: of_case[column] for name, column in profile.items()},
                metrics={name: of_case[name] for name in metrics},
                yes_or_no=yes_or_no,
            )
    return people


def people_table(shards: Iterable[Shard]) -> pl.DataFrame:
    """The people of shards under each label as one table: ``label``, ``person``, ``feasible`` and the metrics."""
    tables = [
        pl.DataFrame(
            {
                "label": pl.repeat(label, people.person.size, eager=True),
                "person": people.person,
                "feasible": people.feasible,
                **{"time_below_validity_pct": np.zeros(people.person.shape), **people.metrics},
            }
        )
        for shard in shards
        for label, people in shard.items()
    ]
    return pl.concat(tables).with_columns(pl.col(pl.Float64).fill_nan(None))


def no_counts(trial: Trial) -> dict[str, Counts]:
    """Counts of zero, by controller."""
    bins, t_min = edges(trial), times(trial)
    return {
        case.label: {name: np.zeros((of.size, bins[name].size - 1), np.int64) for name, of in t_min.items()}
        for case in trial.cases
    }


def add_counts(folder: Path, trial: Trial, index: int, total: dict[str, Counts]) -> None:
    """Add the counts of a shard to those of others; ValueError if they are not counts of its people."""
    place = folder / BANDS
    table = read_parquet(place, bounds(trial, index)[BANDS])
    most = trial.shard(index).size * (trial.samples_a_week if trial.counted_weeks else 1)
    with refusing_damage(place):
        for (label, quantity), part in table.partition_by("controller", "quantity", as_dict=True).items():
            counts: Any = total[str(label)][str(quantity)]
            every_min = MIN_PER_WEEK if quantity == BY_WEEK else trial.sample_time_min
            when = np.rint(part["t_min"].to_numpy() / every_min).astype(np.intp)
            number, count = part["bin"].to_numpy(), part["count"].to_numpy()
            if min(when.min(), number.min()) < 0 or not 0 <= count.min() <= count.max() <= most:
                raise Refusal("it counts people who cannot be")
            np.add.at(counts, (when, number), count)
