"""Courses of simulated people from the folders of runs and trials, as readings that begin at 0 h."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import polars as pl

from glucoloop.metrics.readings.series import Readings
from glucoloop.refusal import Refusal
from glucoloop.schema.tables import ColumnForm, TableBounds
from glucoloop.storage.tables import read_parquet, refusing_damage
from glucoloop.units import MIN_PER_DAY

_OF_RUN: Final = "glucose_1min.parquet"
_OF_TRIAL: Final = "shards/*/traces.parquet"
_NAMES: Final = ("case", "controller", "person")
_COURSE: Final = {
    "t_min": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=36_525.0 * MIN_PER_DAY, optional=False),
    "glucose_mg_dl": ColumnForm(kind=pl.Float64(), at_least=-10_000.0, at_most=10_000.0, nan=True),
}
_BOUNDS: Final = TableBounds(least_rows=1, most_rows=20_000_000, columns=6)


class _SimulatedCourse(NamedTuple):
    """Course of glucose of one person under one controller."""

    name: str
    group: str
    """Case and controller."""
    of_people: bool
    """Whether the simulation is of several people."""
    readings: Readings


def is_simulated(folder: Path) -> bool:
    """Whether a folder holds courses of `glucoloop run`, `compare`, or `trial --traces`; Refusal for other trials."""
    results = bool(_tables_of(folder))
    if not results and (folder / "shards").is_dir():
        raise Refusal(f"{folder} holds no course of glucose; run it by `glucoloop trial --traces`")
    return results


def _tables_of(folder: Path) -> list[Path]:
    return [folder / _OF_RUN] if (folder / _OF_RUN).is_file() else sorted(folder.glob(_OF_TRIAL))


def _table_of(place: Path) -> pl.DataFrame:
    """Courses of a file; Refusal for a table that no run or trial wrote."""
    table = read_parquet(place, _BOUNDS)
    missing = {*_COURSE} - {*table.columns}
    if missing:
        raise Refusal(f"{place} is damaged: it has no column {min(missing)}; write it again")
    wrong = [name for name in _COURSE if not table.schema[name].is_numeric()]
    if wrong:
        raise Refusal(f"{place} is damaged: its column {wrong[0]} has no numbers; write it again")
    names = [name for name in _NAMES if name in table.columns]
    table = table.select(*names, pl.col(*_COURSE).cast(pl.Float64))
    for name, column in _COURSE.items():
        try:
            column.refuse_other(table[name])
        except Refusal as error:
            raise Refusal(f"{place} is damaged: {error}; write it again") from None
    return table


def simulated_trajectories(folder: Path) -> list[_SimulatedCourse]:
    """Courses of a folder: of a run, of each case of a comparison, or of each person of a trial with traces."""
    tables = [_table_of(place) for place in _tables_of(folder)]
    with refusing_damage(folder):
        table = pl.concat(tables)
    names = [name for name in _NAMES if name in table.columns]
    parts = table.partition_by(names, as_dict=True, maintain_order=True) if names else {("the run",): table}
    of_people = "person" in names and table["person"].n_unique() > 1
    results = []
    for key, part in parts.items():
        words = [f"person {value}" if isinstance(value, int) else str(value) for value in key]
        readings = Readings.of(part["t_min"].to_numpy(), part["glucose_mg_dl"].to_numpy())
        group = " ".join(words[:-1] if "person" in names else words) or "People"
        results.append(_SimulatedCourse(" ".join(words), group, of_people, readings))
    return results
