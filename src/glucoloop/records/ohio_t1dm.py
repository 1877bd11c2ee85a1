"""XML of the data set OhioT1DM (C. Marling, R. Bunescu, KDH 2018 and 2020): one list of events for each kind.

Glucose in mg/dl every 5 min, basal rates in U/h, temporary ones with beginning and end, boluses in U, and meals in g as
the person told them. Days come first in dates.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Final

import polars as pl

from glucoloop.records.answers import DAY_FIRST, Answers
from glucoloop.records.extract import (
    BasalEvent,
    Extract,
    basal_rates,
    extract_frame,
    notes_on_spread,
    with_basal,
)
from glucoloop.records.file_text import FileText, cells, xml_of
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.units import S_PER_MIN, number_of

_KINDS: Final = {
    "glucose_level": "readings without a value",
    "finger_stick": "finger pricks",
    "basal": "basal rates without a rate",
    "temp_basal": "temporary basal rates without a rate and times",
    "bolus": "boluses without a dose",
    "meal": "meals without carbohydrate",
    "exercise": "events of exercise",
    "sleep": "times of sleep",
    "work": "times of work",
}


class OhioT1DM(ReaderComponent, name="ohio-t1dm"):
    """XML of the data set OhioT1DM."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is XML with the lists of the data set."""
        return content.text.lstrip().startswith("<") and "<glucose_level" in content.text

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of all lists of events."""
        root = xml_of(content.text)
        events: list[tuple[str, dict[str, str]]] = [
            (child.tag, event.attrib) for child in root for event in child if event.tag == "event"
        ]
        begun = cells(about.get("ts_begin", about.get("ts", about.get("tbegin"))) for _, about in events)
        times, notes = times_of(begun, answers, usual=DAY_FIRST)
        ends, _ = times_of(cells(about.get("ts_end") for _, about in events), answers, usual=DAY_FIRST)
        source = pl.DataFrame(
            {
                "tag": cells(tag for tag, _ in events),
                "value": _of(events, "glucose_level", "value"),
                "dose": _of(events, "bolus", "dose"),
                "grams": _of(events, "meal", "carbs"),
            }
        )
        result = extract_frame(
            source,
            times,
            glucose=pl.col("value"),
            carbs=pl.col("grams"),
            bolus=pl.col("dose"),
            bolus_min=pl.lit(_durations(events, times["time"].to_list(), ends["time"].to_list())),
            device=pl.when(pl.col("tag") == "glucose_level").then(pl.lit("Medtronic")),
            kind=pl.col("tag").replace_strict(_KINDS, default="events of other kinds", return_dtype=pl.String),
        )
        spread = int(result["bolus_min"].is_not_null().sum())
        notes += notes_on_spread(spread)
        counted = sum(
            _number(about.get("bwz_carb_input")) not in (None, 0.0) for tag, about in events if tag == "bolus"
        )
        if counted:
            notes.append(f"{counted} boluses name carbohydrate too; it was not used, for the meals have it.")
        rates = basal_rates(_basal_events(events, times["time"].to_list(), ends["time"].to_list()))
        return Extract(frame=with_basal(result, rates), glucose_unit="mg/dl", notes=tuple(notes))


def _durations(
    events: list[tuple[str, dict[str, str]]], begun: list[datetime | None], ends: list[datetime | None]
) -> pl.Series:
    """Time over which each bolus is given [min]; null for one at once, as the normal part of a dual one."""
    minutes = [
        (end - time).total_seconds() / S_PER_MIN
        if tag == "bolus" and "square" in about.get("type", "") and time is not None and end is not None and end > time
        else None
        for (tag, about), time, end in zip(events, begun, ends, strict=True)
    ]
    return pl.Series(minutes, dtype=pl.Float64)


def _of(events: list[tuple[str, dict[str, str]]], tag: str, key: str) -> pl.Series:
    """Attribute of the events of one list, null for the others."""
    return cells(about.get(key) if name == tag else None for name, about in events)


def _basal_events(
    events: list[tuple[str, dict[str, str]]], begun: list[datetime | None], ends: list[datetime | None]
) -> list[BasalEvent]:
    result: list[BasalEvent] = []
    for row, ((tag, about), time, end) in enumerate(zip(events, begun, ends, strict=True)):
        value = _number(about.get("value"))
        if time is None or value is None:
            continue
        if tag == "basal":
            result.append(BasalEvent(row=row, time=time, what="usual", value=value))
        elif tag == "temp_basal" and end is not None and end >= time:
            minutes = (end - time).total_seconds() / S_PER_MIN
            result.append(BasalEvent(row=row, time=time, what="absolute", value=value, minutes=minutes))
    return result


def _number(text: Any) -> float | None:
    try:
        return number_of(text)
    except (ValueError, AttributeError):
        return None
