"""CSV files of Glooko, which exports a ZIP with one for each kind of data: sensor, boluses, basal rates, and so on.

The first line names the person, the second the columns. A reading of 1 mg/dl stands for low and one of 2001 for high.
Of boluses ``Insulin Delivered`` is the whole dose, of which ``Extended Delivery`` comes over a time that the file does
not tell. A basal row has a duration and a rate, or the insulin that was delivered in it, or the percentage of a
temporary one alone; a suspension has neither a rate nor insulin. Meals and injections that were entered by hand have
files of their own. Daily totals, finger pricks, medicines, exercise and alarms are named.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.devices import is_long_acting
from glucoloop.records.extract import BasalEvent, Extract, basal_rates, extract_frame, number_in, with_basal
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import Header, TableReaderComponent
from glucoloop.records.times import times_of
from glucoloop.text import how_many
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H

_SENSORS: Final = (("Timestamp", "CGM Glucose Value ("), ("Zeitstempel", "CGM-Glukosewert ("))
_BOLUSES: Final = (
    ("Timestamp", "Insulin Type", "Insulin Delivered (U)", "Carbs Input ("),
    ("Zeitstempel", "Insulin-Typ", "Abgegebenes Insulin (E)", "Kohlenhydrataufnahme ("),
)
_BASAL_RATES: Final = (
    ("Timestamp", "Insulin Type", "Duration (minutes)", "Rate"),
    ("Zeitstempel", "Insulin-Typ", "Dauer (Minuten)", "Rate"),
)
_INJECTIONS: Final = (("Timestamp", "Name", "Value", "Insulin Type"), ("Zeitstempel", "Name", "Wert", "Insulin-Typ"))
_MEALS: Final = (("Timestamp", "Carbs (g)"), ("Zeitstempel", "KH (g)"))
_OTHERS: Final = {
    ("Timestamp", "Total Bolus (U)", "Total Basal (U)"): "daily totals",
    ("Zeitstempel", "Bolus gesamt (U)", "Basal gesamt (U)"): "daily totals",
    ("Timestamp", "Glucose Value (", "Manual Reading"): "finger pricks",
    ("Zeitstempel", "Glukosewert (", "Manuelles Lesen"): "finger pricks",
    ("Timestamp", "Name", "Value", "Medication Type"): "medicines",
    ("Zeitstempel", "Name", "Wert", "Medikamententyp"): "medicines",
    ("Timestamp", "Name", "Intensity", "Duration (minutes)"): "events of exercise",
    ("Zeitstempel", "Name", "Intensität", "Dauer (Minuten)"): "events of exercise",
    ("Timestamp", "Alarm/Event"): "alarms",
    ("Zeitstempel", "Alarm/Ereignis"): "alarms",
}
_COLUMNS: Final = {
    "time": ("Timestamp", "Zeitstempel"),
    "glucose": ("CGM Glucose Value (", "CGM-Glukosewert ("),
    "carbs": ("Carbs Input (", "Kohlenhydrataufnahme (", "Carbs (g)", "KH (g)"),
    "bolus": ("Insulin Delivered (U)", "Abgegebenes Insulin (E)"),
    "extended": ("Extended Delivery (U)", "Verzögerte Abgabe (E)"),
    "rate": ("Rate",),
    "percentage": ("Percentage (", "Prozentsatz ("),
    "minutes": ("Duration (minutes)", "Dauer (Minuten)"),
    "name": ("Name",),
    "injected": ("Value", "Wert"),
    "type": ("Insulin Type", "Insulin-Typ"),
    "serial": ("Serial Number", "Seriennummer"),
}
"""Beginnings of the name of each column, in English and in German."""
_LOW_MG_DL, _HIGH_MG_DL = (0.5, 2.0), (2000.0, 2003.0)
"""Bounds of the codes 1 and 2001, also where they were brought to mmol/l and rounded."""
_SUSPENDED: Final = "(?i)suspend|ausgesetzt|unterbr|angehalten|gestoppt"
_SLOW: Final = ("long", "lang", "basal")
_FAST: Final = ("rapid", "fast", "short", "regular", "bolus", "schnell", "kurz", "normal")


class Glooko(TableReaderComponent, name="glooko"):
    """CSV files that Glooko exports in a ZIP, or that ZIP."""

    in_parts: ClassVar = True
    in_exports: ClassVar = True
    headers: ClassVar = (*_SENSORS, *_BOLUSES, *_BASAL_RATES, *_INJECTIONS, *_OTHERS, *_MEALS)
    whole: ClassVar = False

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of one of the files of an export."""
        header, table = self.table(content)
        glucose = table.column(*_COLUMNS["glucose"])
        unit = next((unit for unit in UNITS if unit in (glucose or "").casefold()), None)
        frame = table.frame.select(
            **{name: table.texts(table.column(*starts)) for name, starts in _COLUMNS.items()},
        )
        times, notes = times_of(frame["time"], answers)
        frame = frame.with_columns(out_of_range=_marks(frame["glucose"], unit))
        extended = sum((number_in(text) or 0.0) > 0.0 for text in frame["extended"])
        if extended:
            notes.append(
                f"{how_many(extended, 'bolus has', 'boluses have')} an extended part, over a time that the file does "
                "not tell; the whole dose stands at the beginning."
            )
        result = extract_frame(
            frame, times, table.spoilt, **_columns(header), kind=pl.lit(_OTHERS.get(header, _unused(header)))
        )
        for mark in ("low", "high"):
            count = result.filter(pl.col("out_of_range") == mark).height
            if count:
                code = 1 if mark == "low" else 2001
                notes.append(f"{how_many(count, f'reading of {code} stands', f'readings of {code} stand')} for {mark}.")
        if header in _BASAL_RATES:
            events = _basal_events(frame, result)
            unknown = sum(math.isnan(event.value) for event in events)
            if unknown:
                notes.append(
                    f"{how_many(unknown, 'row')} of basal insulin tell{'s' * (unknown == 1)} neither a rate nor the "
                    "insulin: the rate is not known there."
                )
            result = with_basal(result, basal_rates(events))
        return Extract(frame=result, glucose_unit=unit, notes=(*table.notes, *notes))


def _columns(header: Header) -> dict[str, pl.Expr]:
    """Columns of an extract that a file with a header tells."""
    if header in _SENSORS:
        value = pl.when(pl.col("out_of_range").is_null()).then("glucose")
        return {"glucose": value, "out_of_range": pl.col("out_of_range"), "source": pl.col("serial")}
    if header in _BOLUSES:
        return {"bolus": pl.col("bolus"), "carbs": pl.col("carbs")}
    if header in _MEALS:
        return {"carbs": pl.col("carbs")}
    if header in _INJECTIONS:
        words = pl.concat_str("type", "name", separator=" ", ignore_nulls=True)
        slow = words.map_elements(_is_slow, return_dtype=pl.Boolean)
        fast = ~slow & pl.col("type").str.to_lowercase().str.contains_any(list(_FAST))
        return {
            "bolus": pl.when(fast).then("injected"),
            "long_acting": pl.when(slow).then("injected"),
        }
    return {}


def _unused(header: Header) -> str:
    """Words for the rows of a file of which no value is used."""
    return "doses of insulin of an unknown kind" if header in _INJECTIONS else "rows without a value"


def _is_slow(words: str) -> bool:
    """Whether an injection is of long-acting insulin, by its type and name."""
    return is_long_acting(words) or any(word in words.casefold() for word in _SLOW)


def _marks(glucose: pl.Series, unit: str | None) -> pl.Series:
    """Low and high for readings that are codes; null for others."""
    value = glucose.str.replace(",", ".").cast(pl.Float64, strict=False) * (
        MG_DL_PER_MMOL_L if unit == "mmol/l" else 1.0
    )
    low, high = (pl.lit(value).is_between(*ends) for ends in (_LOW_MG_DL, _HIGH_MG_DL))
    marks = pl.when(low).then(pl.lit("low")).when(high).then(pl.lit("high")).otherwise(pl.lit(None, pl.String))
    return glucose.to_frame().select(marks.alias("out_of_range")).to_series()


def _basal_events(frame: pl.DataFrame, result: pl.DataFrame) -> list[BasalEvent]:
    """Rate of each row over its duration; NaN where it tells neither a rate nor the insulin."""
    about = frame.select("rate", "minutes", "bolus", stopped=pl.col("type").str.contains(_SUSPENDED).fill_null(False))
    about = about.with_columns(result["row"], result["time"])
    events: list[BasalEvent] = []
    for entry in about.iter_rows(named=True):
        rate, minutes, insulin = (number_in(entry[name]) for name in ("rate", "minutes", "bolus"))
        if entry["time"] is None:
            continue
        if rate is None and entry["stopped"]:
            rate = 0.0
        if rate is None and insulin is not None and minutes:
            rate = insulin * MIN_PER_H / minutes
        at = {"row": entry["row"], "time": entry["time"]}
        value = math.nan if rate is None else rate
        if minutes is None:
            events.append(BasalEvent(**at, what="usual", value=value))
        elif minutes > 0.0:
            events.append(BasalEvent(**at, what="absolute", value=value, minutes=minutes))
    return events
