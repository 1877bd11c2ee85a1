"""Tidy record of a person, and the one function that reads it, whatever file it comes from."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import polars as pl

from glucoloop.records.answers import Answers, columns_from_text
from glucoloop.refusal import Refusal

SCHEMA: Final = {
    "time": pl.Datetime("us"),
    "utc_offset_min": pl.Int32(),
    "glucose_mg_dl": pl.Float64(),
    "carbs_g": pl.Float64(),
    "bolus_U": pl.Float64(),
    "basal_U_h": pl.Float64(),
    "out_of_range": pl.String(),
    "device": pl.String(),
}
"""Columns of a record and their types."""
PARQUET: Final = b"PAR1"
"""Bytes with which a Parquet file begins."""
_METADATA: Final = "glucoloop_record"


class FileRefusal(Refusal):
    """A file, or several of one person, that cannot be read; `why` names none of them."""

    def __init__(self, paths: Sequence[Path], why: str) -> None:
        super().__init__(f"{', '.join(map(str, paths))}: {why}")
        self.paths, self.why = tuple(paths), why


@dataclass(frozen=True, kw_only=True)
class DeviceRecord:
    """Record that devices made of a person: one row for each reading, meal, bolus or change of the basal rate.

    The columns of ``frame``, in which null says that the row is about something else:

    ===================  ==============================================================================================
    ``time``             local time on the wall, without a zone; rows are sorted by it
    ``utc_offset_min``   minutes by which that time is ahead of UTC, null where it is not known
    ``glucose_mg_dl``    reading of the sensor [mg/dl]; the limit of its range where ``out_of_range`` says so
    ``carbs_g``          carbohydrate that was entered or eaten at this time [g]
    ``bolus_U``          bolus of rapid-acting insulin given at this time [U]
    ``basal_U_h``        basal rate from this time to the next row that has one [U/h]; NaN where it is not known from
                         here on, as after a temporary rate over an unknown usual one
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


def record_from_parquet(data: bytes) -> DeviceRecord:
    """Record from the bytes of a Parquet file that `DeviceRecord.parquet` made; Refusal for any other."""
    try:
        about = json.loads(pl.read_parquet_metadata(io.BytesIO(data))[_METADATA])
        frame = pl.read_parquet(io.BytesIO(data))
        if frame.schema != SCHEMA:
            raise ValueError
        return DeviceRecord(
            frame=frame, rows=about["rows"], left_out=dict(about["left_out"]), notes=tuple(about["notes"])
        )
    except (*(pl.exceptions.PolarsError, pl.exceptions.PanicException), KeyError, TypeError, ValueError, OSError):
        raise Refusal(
            "it is a Parquet file, but no whole record that glucoloop wrote; read the first file again"
        ) from None


def read_record(
    *paths: str | Path,
    reader: str | None = None,
    dates: str | None = None,
    glucose_unit: str | None = None,
    time_zone: str | None = None,
    columns: Mapping[str, str] | str | None = None,
    scans: bool = False,
) -> DeviceRecord:
    """Read the record of a person from one file or several, exported from a device, an app or a simulator.

    Which program wrote a file is seen from what it holds. Nothing is changed or left out in silence: the notes of the
    record say it with counts, and what a file leaves open is asked for.

    Parameters
    ----------
    *paths : str or Path
        Files of one person, such as entries and treatments of Nightscout, or a record that `DeviceRecord` wrote.
    reader : str, optional
        Name of the reader, where it cannot be seen; ``glucoloop list readers`` has all.
    dates : {"day-first", "month-first"}, optional
        Order of day and month, where all dates of a file could be either.
    glucose_unit : {"mg/dl", "mmol/l"}, optional
        Unit of glucose, where the file does not say it.
    time_zone : str, optional
        Time zone of the person, as ``Europe/Berlin``. Times that a file tells in UTC become local, and offsets become
        known where it tells local times.
    columns : mapping or str, optional
        Names of columns of any other table, as ``{"time": "Zeit", "glucose_mg_dl": "BZ"}`` or
        ``"time=Zeit,glucose_mg_dl=BZ"``.
    scans : bool
        Whether scans of a Libre are kept beside the readings that it stores by itself.

    Returns
    -------
    DeviceRecord
        The record, whose frame has the columns ``time``, ``utc_offset_min``, ``glucose_mg_dl``, ``carbs_g``,
        ``bolus_U``, ``basal_U_h``, ``out_of_range`` and ``device``.

    Raises
    ------
    FileRefusal
        If a file cannot be read, no reader or more than one takes it, or it leaves something open that matters.
    Refusal
        If what was given is not possible.
    """
    from glucoloop.records.reading import read_files

    if not paths:
        raise Refusal("no file is given; give the path of one")
    named = columns_from_text(columns) if isinstance(columns, str) else dict(columns or {})
    answers = Answers(dates=dates, glucose_unit=glucose_unit, time_zone=time_zone, columns=named, scans=scans)
    return read_files([Path(path) for path in paths], reader, answers)
