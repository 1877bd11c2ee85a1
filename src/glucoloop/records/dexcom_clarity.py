"""CSV of Dexcom Clarity, in any language, with points or commas.

Columns by place, in every language: index, time, type of the event, its subtype, patient, device, source device,
glucose, insulin, carbohydrate, duration, rate of change, time of the transmitter, its number. The first rows are about
the patient and the devices and have no time. Sensors read from 40 to 400 mg/dl.
"""

from __future__ import annotations

from typing import Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.devices import device_kinds, is_long_acting
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText, LocalisedTable
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of

_HEADERS: Final = (("Index", "Timestamp", "Event Type", "Glucose Value"), ("Index", "Zeitstempel", "Glukosewert"))
_NAMES: Final = {
    "time": ("Timestamp", "Zeitstempel"),
    "type": ("Event Type", "Ereignistyp", "Ereignisart"),
    "subtype": ("Event Subtype", "Ereignissubtyp", "Ereignisuntertyp"),
    "source": ("Source Device", "Quellger"),
    "glucose": ("Glucose Value", "Glukosewert"),
    "insulin": ("Insulin",),
    "carbs": ("Carb", "Kohlenhydrat"),
    "transmitter": ("Transmitter ID", "Transmitter-ID"),
}
_PLACES: Final = {
    "time": 1,
    "type": 2,
    "subtype": 3,
    "source": 6,
    "glucose": 7,
    "insulin": 8,
    "carbs": 9,
    "transmitter": 13,
}
"""Place of each column in a language whose words are not known here."""
_FEWEST_FIELDS: Final = 10
_TIME: Final = r"^\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ]\d{1,2}:\d{2}"
"""Form of a time, also as a spreadsheet writes it again."""
_READINGS: Final = ("EGV", "EGW")
_FAST: Final = ("fast-acting", "schnellwirkend", "schnell wirkend")
_SLOW: Final = ("long-acting", "langwirkend", "lang wirkend", "depotinsulin")
_INSULIN, _CARBS = ("Insulin",), ("Carbs", "Kohlenhydrate")
_KINDS: Final = {
    "Alert": "alerts",
    "Warnung": "alerts",
    "Calibration": "calibrations and finger pricks",
    "Kalibrierung": "calibrations and finger pricks",
    "Fasting Glucose": "calibrations and finger pricks",
    "Exercise": "events of exercise",
    "Activity": "events of exercise",
    "Health": "events of health",
    "Note": "notes",
}


def _place_by_form(content: FileText) -> tuple[int, str] | None:
    """Place of a header in any language: fields by place, the unit of glucose in the eighth, times in the second."""
    for place, fields in content.fields:
        if len(fields) < _FEWEST_FIELDS or not any(unit in fields[7] for unit in UNITS):
            continue
        if any(unit in text for unit in UNITS for text in fields[:7]):
            continue
        number, delimiter = place
        rows = [line.split(delimiter) for line in content.head[number + 1 :] if line.strip()]
        times = pl.Series([row[1].strip(' "') for row in rows if len(row) > 1 and row[0].strip(' "').isdecimal()])
        if len(times) and times.cast(pl.String).str.contains(_TIME).any():
            return place
    return None


_FORM: Final = LocalisedTable(
    _HEADERS, _NAMES, _PLACES, _place_by_form, "glucose", "Dexcom Clarity, Index, Timestamp, Event Type"
)


class DexcomClarity(ReaderComponent, name="dexcom-clarity"):
    """CSV that Dexcom Clarity exports."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the header of Clarity."""
        return _FORM.recognised(content)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of Clarity."""
        read = _FORM.rows(content)
        frame = read.frame
        times, notes = times_of(frame["time"], answers)
        readings: tuple[str, ...] = _READINGS
        insulins: tuple[str, ...] = _INSULIN
        carbs: tuple[str, ...] = _CARBS
        if not read.is_known:
            readings, insulins, carbs = (_types_with(frame, name) for name in ("glucose", "insulin", "carbs"))
            readings = readings[:1]  # finger pricks have glucose too, and are fewer
        insulin = pl.col("type").is_in(insulins)
        words = pl.col("subtype").str.to_lowercase()
        slow = words.is_in(_SLOW)
        fast = ~slow & (pl.col("subtype").is_null() | words.is_in(_FAST))
        if not read.is_known:
            slow, fast = _kinds_by_words(frame)
        head = pl.col("time").is_null() & ~pl.col("type").is_in((*readings, *insulins, *carbs))
        kind = (
            pl.when(head | pl.col("type").is_null())
            .then(pl.lit("rows about the patient and the devices"))
            .when(insulin & ~fast & ~slow)
            .then(pl.lit("doses of insulin of an unknown kind"))
            .when(~pl.col("type").is_in((*readings, *insulins, *carbs)))
            .then(pl.col("type").replace_strict(_KINDS, default="events of other types", return_dtype=pl.String))
        )
        return Extract(
            frame=extract_frame(
                frame,
                times,
                read.table.spoilt,
                glucose=pl.when(pl.col("type").is_in(readings)).then("glucose"),
                carbs=pl.when(pl.col("type").is_in(carbs)).then("carbs"),
                bolus=pl.when(insulin & fast).then("insulin"),
                long_acting=pl.when(insulin & slow).then("insulin"),
                device=pl.lit(device_kinds(frame["source"], "Dexcom")),
                source=pl.concat_str("source", "transmitter", separator="|", ignore_nulls=True),
                kind=kind,
            ),
            glucose_unit=read.glucose_unit,
            notes=(*read.notes, *notes),
        )


def _types_with(frame: pl.DataFrame, name: str) -> tuple[str, ...]:
    """Types of the events that have a value in a column and a time, the most frequent one first."""
    rows = frame.filter(pl.col(name).is_not_null(), pl.col("time").is_not_null(), pl.col("type").is_not_null())
    return tuple(rows.group_by("type").len().sort("len", "type", descending=[True, False])["type"].to_list())


def _kinds_by_words(frame: pl.DataFrame) -> tuple[pl.Expr, pl.Expr]:
    """Whether insulin is long-acting, or fast-acting, by the words of a language that is not known.

    No words are fast-acting insulin; what they say in other languages is looked for by their beginnings.
    """
    kinds = frame["subtype"].drop_nulls().unique().to_list()
    slow = [kind for kind in kinds if is_long_acting(kind) or any(word in kind.casefold() for word in _SLOW_WORDS)]
    fast = [kind for kind in kinds if kind not in slow and any(word in kind.casefold() for word in _FAST_WORDS)]
    subtype = pl.col("subtype")
    return subtype.is_in(slow), subtype.is_null() | subtype.is_in(fast)


_SLOW_WORDS: Final = ("lent", "long", "lang", "prolong", "długo", "lång", "pitkä", "basal", "dlouh", "hosszú", "uzun")
_FAST_WORDS: Final = ("rapid", "rápid", "snel", "szybk", "snabb", "hurtig", "rask", "nopea", "rychl", "gyors", "hızlı")
