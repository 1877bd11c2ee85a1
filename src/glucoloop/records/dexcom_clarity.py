"""CSV of Dexcom Clarity, in English or German, with points or commas.

Columns by place: index, time, event type, subtype, patient, device, source device, glucose, insulin, carbohydrate. The
first rows are about the patient and the devices and have no time. Sensors read from 40 to 400 mg/dl.
"""

from __future__ import annotations

from typing import Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.devices import device_kinds
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal

_HEADERS: Final = (("Index", "Timestamp", "Event Type", "Glucose Value"), ("Index", "Zeitstempel", "Glukosewert"))
_READINGS: Final = ("EGV", "EGW")
_FAST: Final = ("fast-acting", "schnellwirkend", "schnell wirkend")
_CARBS: Final = ("Carbs", "Kohlenhydrate")
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


class DexcomClarity(ReaderComponent, name="dexcom-clarity"):
    """CSV that Dexcom Clarity exports."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the header of Clarity."""
        return any(content.header(*names) for names in _HEADERS)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of Clarity."""
        place = next((result for names in _HEADERS if (result := content.header(*names))), None)
        if place is None:
            raise Refusal("it has no header of Dexcom Clarity, Index, Timestamp, Event Type and so on; export it again")
        table = content.table(place)
        glucose = table.column("Glucose Value", "Glukosewert")
        unit = next((unit for unit in ("mmol/l", "mg/dl") if glucose and unit in glucose.casefold()), None)
        frame = table.frame.select(
            time=table.texts(table.column("Timestamp", "Zeitstempel")),
            type=table.texts(table.column("Event Type", "Ereignistyp", "Ereignisart")),
            subtype=table.texts(table.column("Event Subtype", "Ereignissubtyp", "Ereignisuntertyp")),
            source=table.texts(table.column("Source Device", "Quellger")),
            glucose=table.texts(glucose),
            insulin=table.texts(table.column("Insulin")),
            carbs=table.texts(table.column("Carb", "Kohlenhydrat")),
        )
        times, notes = times_of(frame["time"], answers)
        insulin = pl.col("type") == "Insulin"
        fast = pl.col("subtype").is_null() | pl.col("subtype").str.to_lowercase().is_in(_FAST)
        head = pl.col("time").is_null() & ~pl.col("type").is_in((*_READINGS, "Insulin", *_CARBS))
        kind = (
            pl.when(head | pl.col("type").is_null())
            .then(pl.lit("rows about the patient and the devices"))
            .when(insulin & ~fast)
            .then(pl.lit("doses of insulin that is not fast-acting"))
            .when(~pl.col("type").is_in((*_READINGS, "Insulin", *_CARBS)))
            .then(pl.col("type").replace_strict(_KINDS, default="events of other types", return_dtype=pl.String))
        )
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=pl.when(pl.col("type").is_in(_READINGS)).then("glucose"),
                carbs=pl.when(pl.col("type").is_in(_CARBS)).then("carbs"),
                bolus=pl.when(insulin & fast).then("insulin"),
                device=pl.lit(device_kinds(frame["source"], "Dexcom")),
                kind=kind,
            ),
            glucose_unit=unit,
            notes=(*table.notes, *notes),
        )
