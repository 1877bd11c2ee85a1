"""Sources of the records of a report: files, folders with a file or a folder for each person, and simulations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import polars as pl

from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.given import NOTHING, NOTHING_GIVEN, Amounts, Given
from glucoloop.metrics.readings.series import LONGEST_FILLED_MIN, Readings
from glucoloop.records import DeviceRecord, FileRefusal, read_people
from glucoloop.records.reading import files_of_people
from glucoloop.refusal import Refusal
from glucoloop.schema.tables import ColumnForm, TableBounds
from glucoloop.storage.results import parquet_table, read_parquet, refusing_damage
from glucoloop.studies.record_report import RecordRequest
from glucoloop.text import how_many, printable
from glucoloop.trials.folder import RECORD, TrialOrigin, traces_in_store
from glucoloop.units import MIN_PER_DAY, MU_MIN_PER_U_H, MU_PER_U, S_PER_MIN


class RecordSource(NamedTuple):
    """Files of one record, or the folder of a simulation."""

    label: str
    group: str
    """Name of the folder of people that it is of; empty for a file that was named itself."""
    paths: tuple[Path, ...]
    alone: bool = False
    """Whether it is all that is reported."""

    @property
    def simulated(self) -> bool:
        """Whether it is the folder of a simulation."""
        return self.paths[0].is_dir() and _is_simulated(self.paths[0])


class NamedReadings(NamedTuple):
    """Readings of one record."""

    label: str
    group: str
    readings: Readings
    notes: tuple[str, ...]
    given: Given
    """Insulin, carbohydrate and glucagon of the whole record."""


def sources_of(config: RecordRequest) -> list[RecordSource]:
    """Sources in the order of the files, and within a folder in that of the names."""
    results: list[RecordSource] = []
    paths_given = [Path(name) for name in config.files]
    if len(paths_given) > 1 and all(path.is_file() for path in paths_given):
        people = files_of_people(paths_given)
        if len(people) < len(paths_given):
            own_labels = dict(zip(paths_given, config.labels, strict=False))
            return [
                RecordSource(own_labels.get(own[0]) or f"Record {number}", "", own, len(people) == 1)
                for number, own in enumerate(people, 1)
            ]
    for place, name in enumerate(config.files):
        path, people = Path(name), list[tuple[Path, ...]]()
        if path.is_dir() and not _is_simulated(path):
            people = _people_of(path)
            files = [paths[0] for paths in people]
            if len(files) > 1 and all(len(paths) == 1 for paths in people):
                people = files_of_people(files)
        label = config.labels[place] if config.labels else printable(path.name) if config.file_names else ""
        if not people:
            results.append(RecordSource(label or f"Record {place + 1}", "", (path,), len(config.files) == 1))
            continue
        group = label or ("People" if len(config.files) == 1 else f"Group {place + 1}")
        begin = "" if len(config.files) == 1 and not config.labels else f"{group}: "
        for number, paths in enumerate(people, 1):
            own = printable(paths[0].relative_to(path).parts[0]) if config.file_names else f"person {number}"
            results.append(
                RecordSource(f"{begin}{own}" if begin or config.file_names else f"Person {number}", group, paths)
            )
    twice = {source.label for source in results if sum(other.label == source.label for other in results) > 1}
    if twice:
        raise Refusal(f"{min(twice)!r} would name more than one record; give each file a --label")
    return results


def _people_of(folder: Path) -> list[tuple[Path, ...]]:
    """Files of each person of a folder: a file or a folder each, in the order of their names; hidden ones are none."""
    people = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_dir() and not _is_simulated(path):
            files = sorted(file for file in path.iterdir() if not file.name.startswith("."))
            people.append(tuple(files) or (path,))
        else:
            people.append((path,))
    if not people:
        raise Refusal(
            f"{folder} is empty; give a folder with a file for each person, or that of `glucoloop run`, `compare`, or "
            "`trial --traces`"
        )
    return people


def read(source: RecordSource, config: RecordRequest) -> Iterator[NamedReadings]:
    """Records of a source: one of a monitor, or one for each course of a simulation; FileRefusal or Refusal."""
    [first, *_] = source.paths
    if source.simulated:
        try:
            trajectories = _simulated_trajectories(first)
        except Refusal:
            if source.group:  # whose refusals tell no path
                raise FileRefusal([first], Refusal("its simulated courses are damaged", "write them again")) from None
            raise
        for trajectory in trajectories:
            label = (
                source.label
                if len(trajectories) == 1
                else trajectory.name
                if source.alone
                else f"{source.label}: {trajectory.name}"
            )
            group = source.group or (trajectory.group if source.alone else f"{source.label} {trajectory.group}".strip())
            group = group if trajectory.of_people or source.group else ""
            notes = ("A simulated course; its first minute is 0 h.",)
            yield NamedReadings(label, group, trajectory.readings, notes, trajectory.given)
        return
    for label, group, record in records(source, config):
        yield _named(record, label, group, source.paths)


def records(source: RecordSource, config: RecordRequest) -> Iterator[tuple[str, str, DeviceRecord]]:
    """Label, group and record of each person of a source that is no simulation; FileRefusal."""
    people = read_people(
        *source.paths,
        person_column=config.person_column,
        reader=config.reader,
        dates=config.dates,
        glucose_unit=config.glucose_unit,
        time_zone=config.time_zone,
        columns=config.columns,
        file_units=config.file_units,
        device=config.device,
        scans=config.scans,
    )
    begin = "" if source.alone and not config.labels else f"{source.label}: "
    for number, (name, record) in enumerate(people.items(), 1):
        if len(people) == 1:
            yield source.label, source.group, record
            continue
        who = printable(name) if config.file_names else f"person {number}"
        label = f"{begin}{who}" if begin or config.file_names else f"Person {number}"
        yield label, source.group or (source.label if begin else "People"), record


def _named(record: DeviceRecord, label: str, group: str, paths: Sequence[Path]) -> NamedReadings:
    """Readings of a record; FileRefusal where there are too few."""
    finite = record.frame.filter(pl.col("glucose_mg_dl").is_finite())
    offsets = finite["utc_offset_min"]
    try:
        readings = Readings.of_times(
            finite["time"].to_numpy(),
            finite["glucose_mg_dl"].to_numpy(),
            None if offsets.null_count() else offsets.to_numpy(),
        )
    except Refusal as error:
        raise FileRefusal(paths, error) from None
    averaged = finite.height - readings.t_min.size
    more = (f"{how_many(averaged, 'reading')} at the time of another one: their mean was taken.",) if averaged else ()
    counted = _by_count(readings)
    clocked = record.frame.with_columns(
        clock_min=(pl.col("time") - pl.lit(readings.day_0)).dt.total_seconds() / S_PER_MIN
    )

    def above_zero(name: str) -> Amounts:
        return _amounts(clocked.filter(pl.col(name) > 0.0), name)

    given = Given(
        basal_U_h=_amounts(clocked.filter(pl.col("basal_U_h").is_not_null()), "basal_U_h"),
        bolus_U=above_zero("bolus_U"),
        long_acting_U=above_zero("long_acting_U"),
        carbs_g=above_zero("carbs_g"),
        glucagon_ug=above_zero("glucagon_ug"),
    )
    return NamedReadings(label, group, readings, (*record.notes, *more, *counted), given)


def _amounts(table: pl.DataFrame, column: str) -> Amounts:
    return Amounts(table["clock_min"].to_numpy(), table[column].to_numpy())


_COUNTED: Final = {
    "active_pct": "time active {:.1f} %",
    "mean_mg_dl": "mean {:.0f} mg/dl",
    "time_below_70_pct": "below 70 mg/dl {:.1f} %",
    "time_70_180_pct": "from 70 to 180 mg/dl {:.1f} %",
    "time_above_180_pct": "above 180 mg/dl {:.1f} %",
}
"""Numbers of the consensus that are told too as it counts them, with each reading alike."""


def _by_count(readings: Readings) -> Iterator[str]:
    """Note on readings that stand for different times, with the numbers that counting them gives."""
    if readings.weight_min is None:
        return
    numbers = numbers_of(readings.by_count)
    texts = ", ".join(text.format(numbers[name]) for name, text in _COUNTED.items())
    yield (
        "Readings come at different steps: each counts for the time until the next one, at most one step of the sensor "
        f"and {LONGEST_FILLED_MIN:g} min. Counted alike, as the consensus counts them, they give {texts}."
    )


_OF_RUN: Final = "glucose_1min.parquet"
_TRACE: Final = "trace.parquet"
_OF_TRIAL: Final = "shards/*/traces.parquet"
_NAMES: Final = ("case", "controller", "person")
_COURSE: Final = {
    "t_min": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=36_525.0 * MIN_PER_DAY, optional=False),
    "glucose_mg_dl": ColumnForm(kind=pl.Float64(), at_least=-10_000.0, at_most=10_000.0, nan=True),
}
_INSULIN: Final = "insulin_mU_min"
_DOSES: Final = {_INSULIN: ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=1e6)}
"""Column that traces of a trial have beside glucose."""
_BOUNDS: Final = TableBounds(least_rows=1, most_rows=20_000_000, columns=6)


class _SimulatedCourse(NamedTuple):
    """Course of glucose of one person under one controller."""

    name: str
    group: str
    """Case and controller."""
    of_people: bool
    """Whether the simulation is of several people."""
    readings: Readings
    given: Given


def _is_simulated(folder: Path) -> bool:
    """Whether a folder holds courses of `glucoloop run`, `compare`, or `trial --traces`; Refusal for other trials."""
    results = bool(_tables_of(folder)) or _has_store(folder)
    if not results and (folder / "shards").is_dir():
        raise Refusal(f"{folder} holds no course of glucose; run it by `glucoloop trial --traces`")
    return results


def _tables_of(folder: Path) -> list[Path]:
    return [folder / _OF_RUN] if (folder / _OF_RUN).is_file() else sorted(folder.glob(_OF_TRIAL))


def _has_store(folder: Path) -> bool:
    """Whether the traces of a trial are in a store."""
    return (folder / RECORD).is_file() and TrialOrigin.of_folder(folder).traces_at is not None


def _table_of(place: Path) -> pl.DataFrame:
    """Courses of a file; Refusal for a table that no run or trial wrote."""
    return _courses(place, read_parquet(place, _BOUNDS))


def _courses(place: Path | str, table: pl.DataFrame) -> pl.DataFrame:
    missing = {*_COURSE} - {*table.columns}
    if missing:
        raise Refusal(f"{place} is damaged: it has no column {min(missing)}; write it again")
    wrong = [name for name in (*_COURSE, *_DOSES) if name in table.columns and not table.schema[name].is_numeric()]
    if wrong:
        raise Refusal(f"{place} is damaged: its column {wrong[0]} has no numbers; write it again")
    names = [name for name in _NAMES if name in table.columns]
    columns = {name: form for name, form in {**_COURSE, **_DOSES}.items() if name in table.columns}
    table = table.select(*names, pl.col(*columns).cast(pl.Float64))
    for name, column in columns.items():
        try:
            column.refuse_other(table[name])
        except Refusal as error:
            raise Refusal(f"{place} is damaged: {error}; write it again") from None
    return table


def _simulated_trajectories(folder: Path) -> list[_SimulatedCourse]:
    """Courses of a folder: of a run, of each case of a comparison, or of each person of a trial with traces."""
    tables = [_table_of(place) for place in _tables_of(folder)]
    if not tables:
        stored = traces_in_store(folder)
        tables = [_courses(place, parquet_table(place, data, _BOUNDS)) for place, data in stored]
    with refusing_damage(folder):
        table = pl.concat(tables)
    names = [name for name in _NAMES if name in table.columns]
    parts = table.partition_by(names, as_dict=True, maintain_order=True) if names else {("the run",): table}
    given = _simulated_doses(folder)
    of_people = "person" in names and table["person"].n_unique() > 1
    results = []
    for key, part in parts.items():
        words = [f"person {value}" if isinstance(value, int) else str(value) for value in key]
        readings = Readings.of(part["t_min"].to_numpy(), part["glucose_mg_dl"].to_numpy())
        group = " ".join(words[:-1] if "person" in names else words) or "People"
        own = given.get(key, NOTHING_GIVEN)
        own = _insulin_of(part) if own is NOTHING_GIVEN and _INSULIN in part.columns else own
        results.append(_SimulatedCourse(" ".join(words), group, of_people, readings, own))
    return results


def _insulin_of(trace: pl.DataFrame) -> Given:
    """All insulin of a person of a trial, whose traces tell no more; the end has none."""
    trace = trace.filter(pl.col(_INSULIN).is_not_null())
    return Given(insulin_U_h=Amounts(trace["t_min"].to_numpy(), trace[_INSULIN].to_numpy() / MU_MIN_PER_U_H))


def _simulated_doses(folder: Path) -> dict[tuple[object, ...], Given]:
    """Doses and meals of a run, or of each case of a comparison."""
    if not (folder / _TRACE).is_file():
        return {}
    table = read_parquet(folder / _TRACE, _BOUNDS)
    if not {"t_min", _INSULIN, "carbs_g"} <= {*table.columns}:
        return {}
    parts = table.partition_by("case", as_dict=True) if "case" in table.columns else {("the run",): table}
    return {key: _simulated_given(part) for key, part in parts.items()}


def _simulated_given(trace: pl.DataFrame) -> Given:
    def above_zero(column: str, divisor: float = 1.0) -> Amounts:
        if column not in trace.columns:
            return NOTHING
        given = trace.filter(pl.col(column) > 0.0)
        return Amounts(given["t_min"].to_numpy(), given[column].to_numpy() / divisor)

    rate_U_h = trace[_INSULIN].to_numpy() / MU_MIN_PER_U_H
    return Given(
        basal_U_h=Amounts(trace["t_min"].to_numpy(), rate_U_h),
        bolus_U=above_zero("bolus_mU", MU_PER_U),
        carbs_g=above_zero("carbs_g"),
        glucagon_ug=above_zero("glucagon_ug"),
        complete=True,
    )
