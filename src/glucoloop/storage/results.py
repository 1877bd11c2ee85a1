"""Results of a study, plain values and tables, and tables of a run, written whole and read back whole.

Whatever is printed or drawn later follows from the plain values, so that nothing is computed or worded again.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.schema.tables import ColumnForm, TableBounds, read_table
from glucoloop.spreadsheet import text_cell
from glucoloop.storage import disk
from glucoloop.storage.files import json_text, read_text, stored_json, with_version
from glucoloop.text import one_line, the_first
from glucoloop.units import number_of

if TYPE_CHECKING:
    from glucoloop.identification import Record
    from glucoloop.simulation import Trace


RECORD_COLUMNS: Final = ("t_min", "insulin_mU_min", "glucose_mg_dl")
_SHOWN_COLUMNS: Final = 8
"""Largest number of columns that a message names."""
_MEAL_COLUMN: Final = "carbs_g"
"""Optional column of meals in a record."""


def minute_table(trace: Trace) -> pl.DataFrame:
    """Table of noise-free glucose on the grid of one minute: columns ``t_min`` and ``glucose_mg_dl``."""
    return pl.DataFrame({"t_min": np.asarray(trace.fine_t_min), "glucose_mg_dl": np.asarray(trace.fine_glucose_mg_dl)})


def record_table(record: Record) -> pl.DataFrame:
    """Table of a record with one row per reading; the last row repeats the insulin rate of the row before.

    It has a column of meals only if they are known.
    """
    insulin, glucose = np.asarray(record.insulin_mU_min), np.asarray(record.glucose_mg_dl)
    meals = {} if record.carbs_g is None else {_MEAL_COLUMN: np.append(np.asarray(record.carbs_g), 0.0)}
    return pl.DataFrame(
        {
            "t_min": record.sample_time_min * np.arange(glucose.size),
            "insulin_mU_min": np.append(insulin, insulin[-1]),
            "glucose_mg_dl": glucose,
            **meals,
        }
    )


def stacked(tables: Mapping[str, pl.DataFrame]) -> pl.DataFrame:
    """Tables of several cases in one, whose first column is the case; a column that a case does not have is null."""
    labelled = [table.select(pl.lit(label).alias("case"), pl.all()) for label, table in tables.items()]
    return pl.concat(labelled, how="diagonal")


def parquet(table: pl.DataFrame) -> bytes:
    """A table as a Parquet file."""
    buffer = io.BytesIO()
    table.write_parquet(buffer)
    return buffer.getvalue()


def read_parquet(place: Path, bounds: TableBounds, columns: Mapping[str, ColumnForm] | None = None) -> pl.DataFrame:
    """Read a table that this program wrote, see `read_table`; Refusal if it is not as it is declared."""
    return parquet_table(place, disk.read_bytes(place, bounds.most_bytes), bounds, columns)


def parquet_table(
    place: Path | str, data: bytes, bounds: TableBounds, columns: Mapping[str, ColumnForm] | None = None
) -> pl.DataFrame:
    """The table of the contents of a file that this program wrote; Refusal if it is not as it is declared."""
    try:
        return read_table(data, bounds, columns)
    except Refusal as error:
        raise Refusal(f"{place} is damaged: {error}") from None


@contextlib.contextmanager
def refusing_damage(place: Path) -> Iterator[None]:
    """Refuse a table that this program wrote as damaged, for an error in the block."""
    try:
        yield
    except (
        *(pl.exceptions.PolarsError, pl.exceptions.PanicException),
        *(KeyError, IndexError, TypeError, ValueError),
    ) as error:
        raise Refusal(f"{place} is damaged: {one_line(error)}") from None


def csv(table: pl.DataFrame) -> bytes:
    """A table as a CSV file: numbers exact, lists as texts, and texts as cells that no spreadsheet computes."""
    buffer = io.BytesIO()
    flat = [_flat(column) for column in table]
    pl.DataFrame([column.alias(text_cell(column.name)) for column in flat]).write_csv(buffer)
    return buffer.getvalue()


def _flat(column: pl.Series) -> pl.Series:
    """A column that a CSV file can hold; a list of numbers is none of the texts in which a formula could stand."""
    if isinstance(column.dtype, pl.List):
        joined = column.list.eval(pl.element().cast(pl.String)).list.join(" ")
        return joined if column.dtype.inner.is_numeric() else _safe(joined)
    return column if column.dtype.is_numeric() or column.dtype.is_temporal() else _safe(column.cast(pl.String))


def _safe(texts: pl.Series) -> pl.Series:
    cells = [None if text is None else text_cell(text) for text in texts]
    return pl.Series(texts.name, cells, pl.String)


def _line_too_long(text: str) -> str | None:
    """Sentence on the first line with more fields than the first one names; None where fields may be quoted."""
    lines = text.splitlines()
    counts = [line.count(",") + 1 for line in lines]
    number = next((number for number, count in enumerate(counts) if count > counts[0]), None)
    if number is None or '"' in text:
        return None
    return (
        f"its line {number + 1} has {counts[number]} fields, but its first line, which has to name the columns, "
        f"{counts[0]}; give all lines as many, separated by commas"
    )


def read_record_columns(path: Path) -> tuple[dict[str, list[object]], list[int]]:
    """Columns of a record from a CSV file, with numbers as floats and meals last, if there are any, and rows' numbers.

    Further columns are left out, and so are empty rows, whose place the numbers of the others keep, counted from 0; a
    ValueError tells what is no table, or which column is missing.
    """
    text = "\n".join(re.split(r"\r\n?|\n", read_text(path, "a record")))
    first = next(iter(text.splitlines()), "")
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in first and "," not in first:
            raise Refusal(f"{path} separates its columns by {name}; separate them by commas, with points in numbers")
    try:
        table = pl.read_csv(io.BytesIO(text.encode()), infer_schema=False)
        table = table.rename({name: name.strip() for name in table.columns})
    except pl.exceptions.PolarsError as error:
        why = _line_too_long(text) or next(iter(str(error).splitlines()), "it is damaged")
        raise Refusal(f"{path} is not a CSV table: {why}") from None
    for column in (*RECORD_COLUMNS, _MEAL_COLUMN):
        if f"{column}_duplicated_0" in table.columns:  # as the reader calls a second one
            raise Refusal(f"{path} has the column {column!r} twice; leave one out")
        if column not in table.columns and column != _MEAL_COLUMN:
            raise Refusal(
                f"{path} has no column {column!r}, only {the_first(table.columns, _SHOWN_COLUMNS)}; "
                f"its first line must name {', '.join(RECORD_COLUMNS)}"
            )
    columns = (*RECORD_COLUMNS, *({_MEAL_COLUMN} & set(table.columns)))
    filled = ~table.select(pl.all_horizontal(pl.col(columns).is_null())).to_series()
    rows = filled.arg_true().to_list()
    return {column: [_number(text) for text in table[column].filter(filled).to_list()] for column in columns}, rows


def _number(text: str | None) -> object:
    """A number, NaN for an empty cell, or the text itself, which is refused later with its row."""
    if text is None or not text.strip():
        return float("nan")
    try:
        return number_of(text)
    except ValueError:
        return text


_MEND: Final = "move it away and run the same command again"


@dataclass(frozen=True)
class Results:
    """Results of a study."""

    values: Mapping[str, Any]
    """Everything as the study computes it, of which `plain` is made."""
    tables: Mapping[str, pl.DataFrame] = field(default_factory=dict)
    """Tables by the name of their file, which ends in ``.csv`` or ``.parquet``; they are not read back."""

    extra: Any = None
    """Further results from which figures and pages are drawn; they are not kept."""

    @functools.cached_property
    def plain(self) -> dict[str, Any]:
        """Everything as plain values: JSON prints it, and a finished folder gives it back.

        A number that is not finite is None, and a tuple is a list, as they will be read back.
        """
        return dict(json.loads(json_text(self.values)))

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows among the plain values, one for each cell of the study."""
        rows: list[dict[str, Any]] = self.plain["rows"]
        return rows

    def text(self) -> str:
        """The plain values as a JSON text."""
        return json_text(with_version(self.plain)) + "\n"

    def files(self, summary: str) -> dict[str, bytes]:
        """The tables, and the plain values as JSON in the file `summary`."""
        tables = {name: csv(table) if name.endswith(".csv") else parquet(table) for name, table in self.tables.items()}
        return {**tables, summary: self.text().encode()}

    place: Path | None = None
    """File from which they were read back; None for what was computed just now."""

    @classmethod
    def read(cls, place: Path) -> Results:
        """Read earlier results from the JSON file that holds them."""
        plain = stored_json(place, _MEND, dict[str, Any])
        return cls({key: value for key, value in plain.items() if key != "version"}, place=place)

    @contextlib.contextmanager
    def refusing_damage(self) -> Iterator[None]:
        """Refuse results that were read back and are not those of the study that shows them in the block.

        Their form is what the columns and sentences of the study ask for, and is written nowhere else.
        """
        try:
            yield
        except (
            LookupError,
            TypeError,
            ValueError,
            AttributeError,
            ArithmeticError,
            pl.exceptions.PolarsError,
        ) as error:
            if self.place is None or isinstance(error, Refusal):
                raise
            raise Refusal(f"{self.place} does not hold what this study finds; {_MEND}") from error
