"""Any table whose columns are named, or have the names of a record themselves."""

from __future__ import annotations

import difflib
import re
from typing import Final

import polars as pl

from glucoloop.records.answers import TARGETS, Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import from_utc, times_of
from glucoloop.refusal import Refusal

_UNITS: Final = {"glucose_mg_dl": "mg/dl", "glucose_mmol_l": "mmol/l"}
_MILLISECONDS: Final = 13
"""Number of digits of the milliseconds since 1970 of any time from 2001 to 2286; that of seconds is 10."""


class AnyTable(ReaderComponent, name="table"):
    """Any table whose columns are named, or have the names of a record."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the names of a record."""
        return any(content.header("time", name, whole=True) for name in _UNITS)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a table by the names of its columns."""
        names = dict(answers.columns) or _own_names(content)
        place = content.header(*names.values(), whole=True)
        if place is None:
            raise Refusal(
                f"no line of its beginning has all of the columns {', '.join(names.values())}; "
                f"{_likely(content, names)}"
            )
        table = content.table(place)
        by_text = {name.casefold(): name for name in reversed(table.frame.columns)}
        frame = table.frame.select(**{target: table.texts(by_text[name.casefold()]) for target, name in names.items()})
        epoch = frame["time"].drop_nulls()
        if len(epoch) and epoch.str.contains(rf"^(\d{{10}}|\d{{{_MILLISECONDS}}})$").all():
            digits = pl.col("time").str.pad_end(_MILLISECONDS, "0").cast(pl.Int64).cast(pl.Datetime("ms"))
            times, notes = from_utc(frame.select(digits).to_series(), None, answers)
        else:
            times, notes = times_of(frame["time"], answers)
        kept = {"glucose": "glucose_mg_dl", "carbs": "carbs_g", "bolus": "bolus_U", "basal": "basal_U_h"}
        if "glucose_mmol_l" in names:
            kept["glucose"] = "glucose_mmol_l"
        columns = {name: pl.col(target) for name, target in kept.items() if target in names}
        return Extract(
            frame=extract_frame(frame, times, table.spoilt, **columns),
            glucose_unit=_UNITS.get(kept["glucose"]),
            notes=(*table.notes, *notes),
        )


def _own_names(content: FileText) -> dict[str, str]:
    """Columns of a table that has the names of a record."""
    place = next((result for name in _UNITS if (result := content.header("time", name, whole=True))), None)
    if place is None:
        raise Refusal(
            "its columns have no names of a record", "name them, as columns='time=Zeit,glucose_mg_dl=BZ' (--columns)"
        )
    number, delimiter = place
    fields = [text.strip().strip('"').casefold() for text in content.head[number].split(delimiter)]
    return {target: target for target in TARGETS if target.casefold() in fields}


def _likely(content: FileText, names: dict[str, str]) -> str:
    """Names of the file that are like those that were given; nothing else of the file, which may name a person."""
    fields = {text.strip().strip('"') for line in content.head[:5] for text in re.split("[,;\t]", line)}
    near = [match for name in names.values() for match in difflib.get_close_matches(name, fields - {name}, n=1)]
    return f"did you mean {' and '.join(map(repr, near))}?" if near else "give the names as they stand in the file"
