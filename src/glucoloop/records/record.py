"""Tidy record of a person, and the one function that reads it, whatever file it comes from."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final

import polars as pl

from glucoloop._representation import represented
from glucoloop.records.answers import Answers, pairs_from_text
from glucoloop.records.times import YEARS
from glucoloop.refusal import Refusal
from glucoloop.schema.tables import PARQUET, ColumnForm, NoMetadata, TableBounds, read_table, table_metadata
from glucoloop.schema.values import ValueBounds, checked, json_value
from glucoloop.units import MIN_PER_DAY

LOWEST_MG_DL: Final = 20.0
HIGHEST_MG_DL: Final = 800.0
"""Bounds of a reading: no sensor or meter shows less than 20 or more than 600 mg/dl, and the wider one is no number
that mmol/l could be."""
LARGEST_AMOUNTS: Final = {"carbs": 1000.0, "bolus": 100.0, "long_acting": 300.0, "basal": 35.0, "glucagon": 5000.0}
"""Largest amounts [g, U, U, U/h, ug]: a pump gives up to 25 or 75 U at once, and up to 35 U/h; a pen up to 80 or 160 U;
an emergency dose of glucagon is 1 mg injected, or 3 mg into the nose."""
_LARGEST_RATE_U_H: Final = 100.0
"""Largest rate of a record, also of one that a simulator gives over a sample."""
IN_MEMORY: Final = Path("the table")
"""Name by which messages call a table that is no file."""
AUTOMATIC: Final = "automatic"
MANUAL: Final = "manual"
COLUMNS: Final = {
    "time": ColumnForm(
        kind=pl.Datetime("us"), at_least=datetime(YEARS[0], 1, 1), at_most=datetime(YEARS[1] + 1, 1, 8), optional=False
    ),
    "utc_offset_min": ColumnForm(kind=pl.Int32(), at_least=-6100, at_most=6100),
    "glucose_mg_dl": ColumnForm(kind=pl.Float64(), at_least=LOWEST_MG_DL, at_most=HIGHEST_MG_DL),
    "carbs_g": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=LARGEST_AMOUNTS["carbs"]),
    "bolus_U": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=LARGEST_AMOUNTS["bolus"]),
    "bolus_min": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=MIN_PER_DAY),
    "bolus_type": ColumnForm(kind=pl.String(), choices=(AUTOMATIC, MANUAL)),
    "long_acting_U": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=LARGEST_AMOUNTS["long_acting"]),
    "basal_U_h": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=_LARGEST_RATE_U_H, nan=True),
    "glucagon_ug": ColumnForm(kind=pl.Float64(), at_least=0.0, at_most=LARGEST_AMOUNTS["glucagon"]),
    "out_of_range": ColumnForm(kind=pl.String(), choices=("low", "high")),
    "device": ColumnForm(kind=pl.String()),
}
"""Columns of a record, with the values that are possible."""
SCHEMA: Final = {name: column.kind for name, column in COLUMNS.items()}
"""Columns of a record and their types."""
_LATER: Final = (
    ("glucagon_ug",),
    ("bolus_type", "glucagon_ug"),
    ("bolus_min", "bolus_type", "long_acting_U", "glucagon_ug"),
)
"""Columns that records of earlier versions do not have."""
_METADATA: Final = "glucoloop_record"
_BOUNDS: Final = TableBounds(least_rows=0, most_rows=5_000_000, columns=len(COLUMNS))
"""Size of a record: nine years of a reading a minute."""
_Count = Annotated[int, ValueBounds(at_least=0, at_most=10**12)]


@dataclass(frozen=True)
class _About:
    """Contents of the footer of a record; see `DeviceRecord`."""

    rows: _Count
    left_out: dict[str, _Count]
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        if sum(self.left_out.values()) >= self.rows:
            raise Refusal(f"of its {self.rows} rows {sum(self.left_out.values())} are left out")


class FileRefusal(Refusal):
    """A file, or several of one person, that cannot be read; `why` names none of them."""

    def __init__(self, paths: Sequence[Path], why: Refusal) -> None:
        super().__init__(f"{', '.join(map(str, paths))}: {why.problem}", *why.remedies)
        self.paths, self.why = tuple(paths), str(why)


@represented
@dataclass(frozen=True, kw_only=True)
class DeviceRecord:
    """Record that devices made of a person: one row for each reading, meal, dose or change of the basal rate.

    The columns of ``frame``, in which null says that the row is about something else:

    ===================  ==============================================================================================
    ``time``             local time on the wall, without a zone; rows are sorted by it
    ``utc_offset_min``   minutes by which that time is ahead of UTC, null where it is not known
    ``glucose_mg_dl``    reading of the sensor [mg/dl]; the limit of its range where ``out_of_range`` says so
    ``carbs_g``          carbohydrate that was entered or eaten at this time [g]
    ``bolus_U``          bolus of rapid-acting insulin given at this time [U]
    ``bolus_min``        time over which that bolus is given [min]; null for one at once
    ``bolus_type``       ``automatic`` where automation gave that bolus, ``manual`` where the person did; null where
                         the file does not tell it
    ``long_acting_U``    dose of long-acting insulin, by a pen, at this time [U]
    ``basal_U_h``        basal rate from this time to the next row that has one [U/h]; NaN where it is not known from
                         here on, as after a temporary rate over an unknown usual one
    ``glucagon_ug``      glucagon given at this time [ug]
    ``out_of_range``     ``low`` or ``high`` where the sensor could not tell a number
    ``device``           kind of device, as ``Dexcom G6``; never a serial number or a name
    ===================  ==============================================================================================
    """

    frame: pl.DataFrame
    rows: int
    """Number of rows, entries or events of the files."""
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Number of rows that were left out by reason; all others were used."""
    notes: tuple[str, ...] = ()
    """Sentences on everything that was changed or left out, with counts."""

    @property
    def rows_used(self) -> int:
        """Number of rows of the files that are in the record."""
        return self.rows - sum(self.left_out.values())

    def parquet(self) -> bytes:
        """Record as a Parquet file, with its notes."""
        buffer = io.BytesIO()
        about = {"rows": self.rows, "left_out": dict(self.left_out), "notes": list(self.notes)}
        self.frame.write_parquet(buffer, metadata={_METADATA: json.dumps(about)})
        return buffer.getvalue()

    def write_parquet(self, path: str | Path) -> None:
        """Write the record to a Parquet file, which `read_record` reads back."""
        Path(path).write_bytes(self.parquet())


def is_parquet_record(data: bytes) -> bool:
    """Whether the bytes of a file are those of a Parquet file of `DeviceRecord.parquet`, also of a damaged one."""
    if not data.startswith(PARQUET):
        return False
    try:
        table_metadata(data, _METADATA)
    except NoMetadata:
        return False
    except Refusal:
        return True
    return True


def record_from_parquet(data: bytes) -> DeviceRecord:
    """Record from the bytes of a Parquet file that `DeviceRecord.parquet` made; Refusal for any other."""
    try:
        about = checked(_About, json_value(table_metadata(data, _METADATA)))
        frame = _table(data)
        if not frame.height:
            raise Refusal("it has no row")
        if not frame["time"].is_sorted():
            raise Refusal("its rows are not in the order of time")
    except Refusal as error:
        raise Refusal(
            f"it is a Parquet file, but no whole record that glucoloop wrote: {error}; read the first file again"
        ) from None
    return DeviceRecord(frame=frame, rows=about.rows, left_out=about.left_out, notes=about.notes)


def _table(data: bytes) -> pl.DataFrame:
    """Table of a record, also of one that an earlier version wrote without some of the columns."""
    for absent in ((), *_LATER):
        try:
            frame = read_table(data, _BOUNDS, {name: form for name, form in COLUMNS.items() if name not in absent})
        except Refusal as error:
            if absent == _LATER[-1] or not error.problem.startswith("its columns are"):
                raise
        else:
            break
    return frame.with_columns(pl.lit(None, SCHEMA[name]).alias(name) for name in absent).select(*SCHEMA)


def read_record(
    *paths: str | Path | pl.DataFrame,
    reader: str | None = None,
    dates: str | None = None,
    glucose_unit: str | None = None,
    time_zone: str | None = None,
    columns: Mapping[str, str] | str | None = None,
    file_units: Mapping[str, str] | str | None = None,
    device: str | None = None,
    scans: bool = False,
) -> DeviceRecord:
    """Read the record of a person from one file or several, exported from a device, an app or a simulator.

    Which program wrote a file is seen from what it holds. Nothing is changed or left out in silence: the notes of the
    record say it with counts, and what a file leaves open is asked for.

    Parameters
    ----------
    *paths : str, Path or polars.DataFrame
        Files of one person, such as entries and treatments of Nightscout, a folder or a ZIP of them, a record that
        `DeviceRecord` wrote, or tables in memory, read as a file of the same columns is.
    reader : str, optional
        Name of the reader, where it cannot be seen; ``glucoloop list readers`` has all.
    dates : {"day-first", "month-first", "year-first"}, optional
        Order of day and month, where all dates of a file could be either, or of a year of two digits.
    glucose_unit : {"mg/dl", "mmol/l"}, optional
        Unit of glucose, where the file does not say it.
    time_zone : str, optional
        Time zone of the person, as ``Europe/Berlin``. Times that a file tells in UTC become local, and offsets become
        known where it tells local times.
    columns : mapping or str, optional
        Names of columns of any other table, as ``{"time": "Zeit", "glucose_mg_dl": "BZ"}`` or
        ``"time=Zeit,glucose_mg_dl=BZ"``. Files with other names have them with a bar between, as ``time=Zeit|Uhrzeit``.
    file_units : mapping or str, optional
        Units of amounts, where they are not g, U, U/h and ug, as ``"basal=mU/h,carbs=10g"``.
    device : str, optional
        Device whose readings are used, where several read at the same time, by the name that the notes have.
    scans : bool
        Whether scans of a Libre are kept beside the readings that it stores by itself.

    Returns
    -------
    DeviceRecord
        The record, whose frame has the columns ``time``, ``utc_offset_min``, ``glucose_mg_dl``, ``carbs_g``,
        ``bolus_U``, ``bolus_min``, ``bolus_type``, ``long_acting_U``, ``basal_U_h``, ``glucagon_ug``, ``out_of_range``
        and ``device``.

    Raises
    ------
    FileRefusal
        If a file cannot be read, no reader or more than one takes it, it leaves something open that matters, or it is a
        table of several people.
    Refusal
        If what was given is not possible.
    """
    people = read_people(
        *paths,
        reader=reader,
        dates=dates,
        glucose_unit=glucose_unit,
        time_zone=time_zone,
        columns=columns,
        file_units=file_units,
        device=device,
        scans=scans,
    )
    if len(people) > 1:
        raise FileRefusal(
            [IN_MEMORY if isinstance(path, pl.DataFrame) else Path(path) for path in paths],
            Refusal(f"it is of {len(people)} people", "read them with read_people, which gives one record each"),
        )
    [record] = people.values()
    return record


def read_people(
    *paths: str | Path | pl.DataFrame,
    person_column: str | None = None,
    reader: str | None = None,
    dates: str | None = None,
    glucose_unit: str | None = None,
    time_zone: str | None = None,
    columns: Mapping[str, str] | str | None = None,
    file_units: Mapping[str, str] | str | None = None,
    device: str | None = None,
    scans: bool = False,
) -> dict[str, DeviceRecord]:
    """Read the records of several people from tables with a column that says whose each row is.

    Parameters
    ----------
    *paths : str, Path or polars.DataFrame
        Files or tables in which the people have the same names.
    person_column : str, optional
        Name of that column, where it cannot be seen.
    reader, dates, glucose_unit, time_zone, columns, file_units, device, scans
        As of `read_record`.

    Returns
    -------
    dict
        Record of each person by the name in the column, in the order of the file; under an empty name where no column
        tells of people.

    Raises
    ------
    FileRefusal
        As `read_record`, but not for several people.
    """
    from glucoloop.records.reading import read_files

    if not paths:
        raise Refusal("no file is given; give the path of one")
    named, said = (
        pairs_from_text(pairs, what, example) if isinstance(pairs, str) else dict(pairs or {})
        for pairs, what, example in (
            (columns, "columns", "time=Zeit,glucose_mg_dl=BZ"),
            (file_units, "file_units", "basal=mU/h,carbs=10g"),
        )
    )
    answers = Answers(
        dates=dates,
        glucose_unit=glucose_unit,
        time_zone=time_zone,
        columns=named,
        file_units=said,
        device=device,
        person_column=person_column,
        scans=scans,
    )
    return read_files([path if isinstance(path, pl.DataFrame) else Path(path) for path in paths], reader, answers)
