"""CSV of t:connect and Tandem Source, of pumps of Tandem: sections of readings, finger pricks, basal rates and boluses.

The first lines are about the pump and the person; each section begins with a header and ends with an empty line. Times
are on the clock of the pump, readings in mg/dl unless a header says otherwise. Where a bolus has an extended part,
``BolexInsulinDelivered`` of it is given over ``Duration`` in minutes, which is a part of ``InsulinDelivered`` or comes
beside it, whichever makes the bolus that was requested. Rows of boluses have more fields than their header, behind all
that are read. A basal rate holds until the next one; newer exports have none.
"""

from __future__ import annotations

import csv
from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.extract import (
    Extract,
    bolus_types,
    extended_boluses,
    extract_frame,
    notes_on_spread,
    number_in,
    with_doses,
)
from glucoloop.records.file_text import FileText, table_of
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal

_COLUMNS: Final = {
    "type": ("Type",),
    "time": ("EventDateTime", "CompletionDateTime"),
    "glucose": ("Readings (",),
    "finger": ("BG",),
    "bolus": ("InsulinDelivered",),
    "bolus_type": ("BolusType",),
    "extended": ("BolexInsulinDelivered",),
    "minutes": ("Duration",),
    "requested": ("ActualTotalBolusRequested",),
    "carbs": ("CarbSize",),
    "basal": ("BasalRate",),
    "serial": ("SerialNumber",),
}
_MAX_SECTIONS: Final = 100


class Tandem(TableReaderComponent, name="tandem"):
    """CSV that t:connect and Tandem Source export of pumps of Tandem."""

    headers: ClassVar = (
        ("DeviceType", "EventDateTime", "Readings ("),
        ("Type", "BolusType", "CompletionDateTime", "InsulinDelivered", "CarbSize"),
        ("Type", "EventDateTime", "BasalRate"),
    )
    whole: ClassVar = False

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of all sections of an export."""
        self.table(content)  # refuses a file without any of them
        tables = [table_of(section, ",") for section in _sections(content.text)]
        if not tables:
            raise Refusal("its sections are not divided by commas; export it again")
        headers = [(table.column("Readings (") or "").casefold() for table in tables]
        units = {unit for unit in UNITS for header in headers if unit in header}
        if len(units) > 1:
            raise Refusal("its sections have glucose in mg/dl and in mmol/l; export it again in one unit")
        frame = pl.concat(
            table.frame.select(**{name: table.texts(table.column(*starts)) for name, starts in _COLUMNS.items()})
            for table in tables
        )
        times, notes = times_of(frame["time"], answers)
        extended = extended_boluses(frame)
        notes += notes_on_spread(len(extended))
        at_once = [_at_once(*doses) for doses in frame.select("bolus", "extended", "requested").iter_rows()]
        if not frame["basal"].is_not_null().any():
            notes.append("The file has no basal rates.")
        result = extract_frame(
            frame,
            times,
            pl.concat([table.spoilt for table in tables]),
            glucose=pl.col("glucose"),
            carbs=pl.col("carbs"),
            bolus=pl.lit(pl.Series(at_once, dtype=pl.String)),
            bolus_type=bolus_types(pl.col("bolus_type"), "automatic"),
            basal=pl.col("basal"),
            device=pl.lit("Tandem"),
            source=pl.col("serial"),
            kind=pl.when(pl.col("type").str.to_lowercase() == "bolus")
            .then(pl.lit("boluses without a dose"))
            .when(pl.col("type").str.to_lowercase() == "iob")
            .then(pl.lit("entries of insulin on board"))
            .when(pl.col("finger").is_not_null())
            .then(pl.lit("finger pricks"))
            .otherwise(pl.lit("rows without a reading, a meal or insulin")),
        )
        return Extract(
            frame=with_doses(result, extended),
            glucose_unit=next(iter(units), "mg/dl"),
            notes=(*(note for table in tables for note in table.notes), *notes),
        )


def _at_once(delivered: str | None, extended: str | None, requested: str | None) -> str | None:
    """Insulin of a bolus without its extended part [U]."""
    whole, later, wanted = number_in(delivered), number_in(extended), number_in(requested)
    if not whole or not later or wanted is None or abs(whole - wanted) >= abs(whole + later - wanted):
        return delivered
    return str(round(whole - later, 6))


def _sections(text: str) -> list[str]:
    """Text of each section, which begins with its header; the header has as many fields as the first row.

    One that ends in the file ends with a line end.
    """
    result: list[list[str]] = []
    inside = False
    for line in text.split("\n"):
        if not line.strip(' ",;\t'):
            if inside:
                result[-1].append("")
            inside = False
        elif line.lstrip('"').startswith(("DeviceType,", "Type,", 'DeviceType"', 'Type"')) and "DateTime" in line:
            if len(result) == _MAX_SECTIONS:
                raise Refusal(f"it has more than {_MAX_SECTIONS} sections; divide it")
            result.append([line])
            inside = True
        elif inside:
            if len(result[-1]) == 1:
                more = len(next(csv.reader([line]))) - result[-1][0].count(",") - 1
                result[-1][0] += "," * max(0, more)
            result[-1].append(line)
    return ["\n".join(lines) for lines in result]
