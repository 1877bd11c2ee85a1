"""CSV of LibreView, of sensors FreeStyle Libre, in English or German.

The first line is about the export, the second names the columns. A record type of 0 is a reading that the sensor stores
every 5 or 15 min, 1 a scan, 2 a strip, 4 insulin, 5 food, 6 anything else. Dates have the day or the month first,
depending on the country of the account. Sensors read from 40 to 500 mg/dl.
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

_HEADERS: Final = (
    ("Device Timestamp", "Record Type", "Historic Glucose"),
    ("Gerätezeitstempel", "Aufzeichnungstyp", "Glukosewert-Verlauf"),
)
_HISTORIC, _SCAN, _INSULIN, _FOOD = "0", "1", "4", "5"
_KINDS: Final = {"2": "strips", "3": "entries of other kinds", "6": "notes and other entries"}


class LibreView(ReaderComponent, name="libreview"):
    """CSV that LibreView exports of a FreeStyle Libre."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the header of LibreView."""
        return any(content.header(*names) for names in _HEADERS)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of LibreView."""
        place = next((result for names in _HEADERS if (result := content.header(*names))), None)
        if place is None:
            raise Refusal("it has no header of LibreView, Device Timestamp, Record Type and so on; export it again")
        table = content.table(place)
        historic = table.column("Historic Glucose", "Glukosewert-Verlauf")
        unit = next((unit for unit in ("mmol/l", "mg/dl") if historic and unit in historic.casefold()), None)
        frame = table.frame.select(
            device=table.texts(table.column("Device", "Gerät")),
            time=table.texts(table.column("Device Timestamp", "Gerätezeitstempel")),
            type=table.texts(table.column("Record Type", "Aufzeichnungstyp")),
            historic=table.texts(historic),
            scan=table.texts(table.column("Scan Glucose", "Glukose-Scan")),
            rapid=table.texts(table.column("Rapid-Acting Insulin (", "Schnellwirkendes Insulin (")),
            slow=table.texts(table.column("Long-Acting Insulin Value", "Long-Acting Insulin (", "Depotinsulin (")),
            carbs=table.texts(table.column("Carbohydrates (grams)", "Kohlenhydrate (Gramm)")),
        )
        times, notes = times_of(frame["time"], answers)
        kind = pl.col("type")
        keep_scans = answers.scans or not frame.filter(kind == _HISTORIC)["historic"].is_not_null().any()
        no_value = (
            pl.when((kind == _SCAN) & (not keep_scans))
            .then(pl.lit("scans, beside the readings that the sensor stores"))
            .when((kind == _INSULIN) & pl.col("slow").is_not_null())
            .then(pl.lit("doses of long-acting insulin"))
            .when(kind == _INSULIN)
            .then(pl.lit("doses of insulin without a number"))
            .when(kind == _FOOD)
            .then(pl.lit("meals without grams of carbohydrate"))
            .when(~kind.is_in((_HISTORIC, _SCAN)))
            .then(kind.replace_strict(_KINDS, default="rows of an unknown type", return_dtype=pl.String))
            .when((kind == _SCAN) & keep_scans)
            .then(pl.lit("scans without a reading"))
        )
        both = frame.filter((kind == _INSULIN) & pl.col("rapid").is_not_null() & pl.col("slow").is_not_null()).height
        if both:
            notes.append(f"{both} rows have rapid-acting and long-acting insulin; the long-acting dose was not used.")
        glucose = pl.when(kind == _HISTORIC).then("historic").when((kind == _SCAN) & keep_scans).then("scan")
        return Extract(
            frame=extract_frame(
                frame,
                times,
                table.spoilt,
                glucose=glucose,
                carbs=pl.when(kind == _FOOD).then("carbs"),
                bolus=pl.when(kind == _INSULIN).then("rapid"),
                device=pl.lit(device_kinds(frame["device"], "FreeStyle Libre")),
                kind=no_value,
            ),
            glucose_unit=unit,
            notes=(*table.notes, *notes),
            limits_mg_dl=(40.0, 500.0),
        )
