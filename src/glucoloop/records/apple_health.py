"""XML that Apple's Health app exports (``export.xml``), of which glucose, insulin and carbohydrate are read.

Every record has a time with its offset from UTC, the app that wrote it, and a unit. An entry of its metadata tells
whether insulin is basal or a bolus. Basal insulin over a time is a rate, as Loop writes it, and basal insulin at once
an injection of a pen. Glucose that a person entered by hand is a finger prick.
"""

from __future__ import annotations

import html
import re
from typing import Any, Final, NamedTuple

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.devices import device_kinds
from glucoloop.records.extract import (
    BasalEvent,
    Extract,
    basal_rates,
    extract_frame,
    notes_on_spread,
    number_in,
    with_basal,
)
from glucoloop.records.file_text import MAX_ROWS, FileText, bounded, cells
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, S_PER_MIN

_TAG: Final = r'(?:[^>"]|"[^"]*")*+'
"""Attributes of an element, in whose texts there may be the sign that ends it."""
_RECORD: Final = re.compile(
    rf'<Record\s+type="HKQuantityTypeIdentifier(BloodGlucose|InsulinDelivery|DietaryCarbohydrates)"({_TAG})>'
    rf"((?:\s*<MetadataEntry{_TAG}>)*)"
)
_ATTRIBUTE: Final = re.compile(r'(\w+)="([^"]*)"')
_ENTRY: Final = re.compile(r'<MetadataEntry\s+key="([^"]*)"\s+value="([^"]*)"')
_GLUCOSE, _INSULIN, _CARBS = "BloodGlucose", "InsulinDelivery", "DietaryCarbohydrates"
_BASAL, _BOLUS = "1", "2"
_SPREAD_MIN: Final = 10.0
"""Time from which a bolus counts as one over a time; a pump takes some minutes for any."""
_ROOT: Final = "<HealthData"
_END: Final = "</HealthData>"


class _Record(NamedTuple):
    """One record of the export."""

    kind: str
    about: dict[str, str]
    """Attributes, and entries of metadata, by name."""

    def value_in(self, unit: str) -> Any:
        """Value where it is in a unit; a text that is no number where it is in another one."""
        return self.about.get("value") if self.about.get("unit", "").casefold() == unit else "?"

    @property
    def glucose_mg_dl(self) -> Any:
        """Reading that no person entered by hand; None for other records."""
        if self.kind != _GLUCOSE or self.about.get("HKWasUserEntered") == "1":
            return None
        number = number_in(self.about.get("value"))
        if self.about.get("unit", "").casefold().startswith("mmol") and number is not None:
            return number * MG_DL_PER_MMOL_L
        return self.value_in("mg/dl")


class AppleHealth(ReaderComponent, name="apple-health"):
    """XML that Apple's Health app exports."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is such an export."""
        begin = "\n".join(content.head)
        return content.text.lstrip().startswith("<") and (_ROOT in begin or "<!DOCTYPE HealthData" in begin)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of the records of glucose, insulin and carbohydrate."""
        if not content.text.rstrip().endswith(_END):
            raise Refusal("its XML breaks off or is damaged; give the whole file")
        bounded(content.text.count("<Record"), 20 * MAX_ROWS, "records")
        records = [
            _Record(
                kind,
                {
                    name: html.unescape(text)
                    for name, text in (*_ATTRIBUTE.findall(attributes), *_ENTRY.findall(entries))
                },
            )
            for kind, attributes, entries in _RECORD.findall(content.text)
        ]
        bounded(len(records), MAX_ROWS, "records of glucose, insulin and carbohydrate")
        begins, notes = times_of(cells(one.about.get("startDate") for one in records), answers)
        ends, _ = times_of(cells(one.about.get("endDate") for one in records), answers)
        minutes = ((ends["time"] - begins["time"]).dt.total_seconds() / S_PER_MIN).fill_null(0.0).to_list()
        names = cells(one.about.get("sourceName") for one in records)
        source = pl.DataFrame(
            {
                "glucose": cells(one.glucose_mg_dl for one in records),
                "carbs": cells(one.value_in("g") if one.kind == _CARBS else None for one in records),
                "bolus": cells(_dose(one, _BOLUS) for one in records),
                "long_acting": cells(
                    _dose(one, _BASAL) if span <= 0.0 else None for one, span in zip(records, minutes, strict=True)
                ),
                "spread": pl.Series([span if span > _SPREAD_MIN else None for span in minutes], dtype=pl.Float64),
                "device": cells(f"{one.about.get('sourceName')} {one.about.get('device', '')}" for one in records),
                "source": names,
                "kind": cells(_words(one) for one in records),
            }
        )
        result = extract_frame(
            source,
            begins,
            glucose=pl.col("glucose"),
            carbs=pl.col("carbs"),
            bolus=pl.col("bolus"),
            bolus_min=pl.when(pl.col("bolus").is_not_null()).then("spread"),
            long_acting=pl.col("long_acting"),
            device=pl.when(pl.col("glucose").is_not_null()).then(pl.lit(device_kinds(source["device"], "other"))),
            source=pl.col("source"),
            kind=pl.col("kind"),
        )
        notes += notes_on_spread(int(result["bolus_min"].is_not_null().sum()))
        events = [
            BasalEvent(row=row, time=time, what="absolute", value=units * MIN_PER_H / span, minutes=span)
            for row, (one, time, span) in enumerate(zip(records, begins["time"].to_list(), minutes, strict=True))
            if time is not None and span > 0.0 and (units := number_in(_dose(one, _BASAL))) is not None
        ]
        return Extract(frame=with_basal(result, basal_rates(events)), glucose_unit="mg/dl", notes=tuple(notes))


def _dose(record: _Record, reason: str) -> Any:
    """Insulin of a record that was given for a reason [U]; None for other records."""
    if record.kind != _INSULIN or record.about.get("HKInsulinDeliveryReason") != reason:
        return None
    return record.value_in("iu")


def _words(record: _Record) -> str:
    """Words for a record of which no value is used."""
    return {
        _GLUCOSE: "finger pricks, which a person entered",
        _INSULIN: "doses of insulin of an unknown kind",
    }.get(record.kind, "meals without carbohydrate")
