"""CSV of CareLink, of pumps and sensors of Medtronic, in any language.

The file has a section for each device, which begins with a line of dashes and a header. Numbers have a point or a
comma. A bolus is logged twice, as it was selected and as it was delivered; the delivered dose counts. Sensors read from
40 to 400 mg/dl. Where the words of a header are not known, columns are taken by their place.

Under automation a pump logs its insulin in one of two ways. A 780G has one row for each day, at midnight, with the sum
of the automatic insulin of that day (``CLOSED_LOOP_AUTO_INSULIN``), which is no bolus: it is given here as a basal rate
over that day. A 670G has micro-boluses every 5 min, which take the place of the basal rate until one is logged again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import Final, NamedTuple

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.carelink_raw import notes_on_clock, place_of_raw
from glucoloop.records.devices import kind_of
from glucoloop.records.extract import (
    BasalEvent,
    Extract,
    basal_rates,
    bolus_types,
    extract_frame,
    number_in,
    with_basal,
)
from glucoloop.records.file_text import CellTable, FileText, table_of
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, S_PER_MIN, number_of

_HEADER: Final = ("Index", "Date", "Time", "Sensor Glucose (")
_RULE: Final = "-------"
_MAX_SECTIONS: Final = 100
_COLUMNS: Final = {
    "date": "Date",
    "clock": "Time",
    "glucose": "Sensor Glucose (",
    "meter": "BG Reading (",
    "basal": "Basal Rate (",
    "temp": "Temp Basal Amount",
    "temp_type": "Temp Basal Type",
    "temp_duration": "Temp Basal Duration",
    "selected": "Bolus Volume Selected",
    "bolus": "Bolus Volume Delivered",
    "bolus_type": "Bolus Type",
    "bolus_duration": "Bolus Duration",
    "bolus_source": "Bolus Source",
    "prime": "Prime Volume Delivered",
    "carbs": "BWZ Carb Input (grams",
    "exchanges": "BWZ Carb Input (exchanges",
    "suspend": "Suspend",
    "alarm": "Alarm",
    "marker": "Event Marker",
    "changed": "New Device Time",
}
_PLACES: Final = {
    "date": 1,
    "clock": 2,
    "changed": 3,
    "meter": 4,
    "basal": 6,
    "temp": 7,
    "temp_type": 8,
    "temp_duration": 9,
    "bolus_type": 10,
    "selected": 11,
    "bolus": 12,
    "bolus_duration": 13,
    "prime": 15,
    "alarm": 16,
    "suspend": 17,
    "carbs": 24,
    "glucose": 31,
    "marker": 33,
}
"""Place of each column in a language whose words are not known here."""
_FEWEST_FIELDS: Final = 34
_RUNNING: Final = (
    *("NORMAL", "RESUM", "REPRIS", "REPRE", "REANUD", "RIPRES", "RIPRIST", "HERVAT", "RETOM", "WZNOW", "ÅTERUPP"),
    *("FORTGES", "FORTSAT", "GJENOPP", "GENOPT", "OBNOV", "JATK"),
)
"""Beginnings of words of the state of a pump that delivers again."""
_PERCENT: Final = ("percent", "prozent", "pourcent", "porcent", "percentu", "procent", "prosent", "prosentt", "%")
_DAY_SUM, _MICRO_BOLUS = "AUTO_INSULIN", "MICRO_BOLUS"
"""Parts of the sources of boluses under automation."""
_SQUARE: Final = ("square", "carr", "cuadrad", "quadra", "vierkant", "blok", "verzög", "prostok", "fyrkant", "firkant")


class CareLink(ReaderComponent, name="carelink"):
    """CSV that CareLink exports of pumps and sensors of Medtronic."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has a header of CareLink."""
        known = content.header(*_HEADER) or _place_by_form(content)
        return known is not None and place_of_raw(content) is None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of all sections of an export of CareLink."""
        by_words = content.header(*_HEADER)
        place = by_words or _place_by_form(content)
        if place is None:
            raise Refusal("it has no header of CareLink, Index, Date, Time and so on; export it again")
        sections = _sections(content.text, *place)
        columns = [_columns(table, by_words is not None) for _, table in sections]
        units = {unit for names in columns for unit in UNITS if unit in (names["glucose"] or "").casefold()}
        if len(units) > 1:
            raise Refusal("its sections have glucose in mg/dl and in mmol/l; export it again in one unit")
        parts = [
            table.frame.select(device=pl.lit(device), **{name: table.texts(column) for name, column in names.items()})
            for (device, table), names in zip(sections, columns, strict=True)
        ]
        frame = pl.concat(parts).with_columns(
            pl.when(~pl.col(name).str.starts_with(_RULE)).then(name) for name in _COLUMNS if name != "device"
        )
        spoilt = pl.concat([table.spoilt for _, table in sections])
        times, notes = times_of(frame.select(pl.concat_str("date", "clock", separator=" ")).to_series(), answers)
        if by_words is None:
            notes.append("Its language is not known here: its columns were taken by their place, as in all languages.")
        meal = pl.col("marker").str.extract(r"(?i)^Meal: *([0-9.,]+) *g")
        others = "other event markers" if by_words else "event markers in a language that is not known"
        known = pl.col("marker").str.extract(r"(?i)^(Insulin|Meal|Exercise|BG)\b").str.to_lowercase()
        words = {
            "insulin": "event markers of insulin of an unknown kind",
            "meal": "event markers of meals without grams",
        }
        kind = (
            pl.when(pl.col("meter").is_not_null())
            .then(pl.lit("finger pricks"))
            .when(pl.col("prime").is_not_null())
            .then(pl.lit("insulin that fills a tube or a cannula, which nobody gets"))
            .when(pl.col("selected").is_not_null())
            .then(pl.lit("boluses as they were selected, before their delivery"))
            .when(pl.col("exchanges").is_not_null())
            .then(pl.lit("meals in exchanges, not in grams"))
            .when(pl.col("marker").is_not_null())
            .then(known.replace_strict(words, default=others, return_dtype=pl.String))
            .when(pl.col("alarm").is_not_null())
            .then(pl.lit("alarms"))
            .otherwise(pl.lit("entries about the device"))
        )
        notes += notes_on_clock(frame)
        of_day = pl.col("bolus_source").str.contains(_DAY_SUM).fill_null(False)
        result = extract_frame(
            frame,
            times,
            spoilt,
            glucose=pl.col("glucose"),
            carbs=pl.coalesce("carbs", meal),
            bolus=pl.when(~of_day).then("bolus"),
            bolus_min=pl.lit(_bolus_minutes(frame)),
            bolus_type=bolus_types(pl.col("bolus_source"), "AUTO|MICRO"),
            source=pl.col("device"),
            device=pl.col("device"),
            kind=kind,
        )
        events, unreadable = _basal_events(frame, result)
        sums = _day_sums(frame, result)
        if sums:
            events = _with_day_sums(events, sums, notes)
        if unreadable:
            notes.append(f"{unreadable} entries of basal rates hold no number.")
        unit = next(iter(units), None)
        tables = tuple(note for _, table in sections for note in table.notes)
        return Extract(frame=with_basal(result, basal_rates(events)), glucose_unit=unit, notes=(*tables, *notes))


def _place_by_form(content: FileText) -> tuple[int, str] | None:
    """Place of a header in any language, by the units of meter, basal rate, boluses and sensor in their columns."""
    for place, fields in content.fields:
        if (
            len(fields) >= _FEWEST_FIELDS
            and all(any(unit in fields[at] for unit in UNITS) for at in (_PLACES["meter"], _PLACES["glucose"]))
            and "/" in fields[_PLACES["basal"]]
            and "(" in fields[_PLACES["bolus"]]
        ):
            return place
    return None


def _sections(text: str, header: int, delimiter: str) -> list[tuple[str, CellTable]]:
    """Kind of device and table of each section; the lines before the first one are about the person."""
    result: list[tuple[str, CellTable]] = []
    device, lines = "Medtronic", list[str]()
    every = text.split("\n")
    first = every[header].partition(delimiter)[0]
    for number, line in enumerate([*every, _RULE]):
        if line.lstrip('"').startswith(_RULE):
            if len(result) == _MAX_SECTIONS:
                raise Refusal(f"it has more than {_MAX_SECTIONS} sections of devices; divide it")
            if lines:
                end = "\n" if number < len(every) else ""  # the last section may be cut off
                result.append((device, table_of("\n".join(lines) + end, delimiter)))
            device, lines = kind_of(line, "Medtronic"), []
        elif lines or line.startswith(f"{first}{delimiter}"):
            lines.append(line)
    return result


def _columns(table: CellTable, known: bool) -> dict[str, str | None]:
    """Names of the columns of a section, by their words or by their place."""
    if known:
        return {name: table.column(start) for name, start in _COLUMNS.items()}
    columns = table.frame.columns
    at = {name: _PLACES.get(name, len(columns)) for name in _COLUMNS}
    return {name: columns[place] if place < len(columns) else None for name, place in at.items()}


def _basal_events(frame: pl.DataFrame, result: pl.DataFrame) -> tuple[list[BasalEvent], int]:
    """Entries about the basal rate, and the number of those that cannot be read."""
    about = ("basal", "temp", "temp_type", "temp_duration", "suspend")
    micro = pl.col("bolus_source").str.contains(_MICRO_BOLUS).fill_null(False) & pl.col("bolus").is_not_null()
    logged = frame.select(*about, micro=micro).with_columns(result["row"], result["time"]).reverse()
    logged = logged.filter(
        (pl.any_horizontal(pl.col("basal", "temp", "suspend").is_not_null()) | pl.col("micro"))
        & pl.col("time").is_not_null()
    )
    events: list[BasalEvent] = []
    unreadable = 0
    for entry in logged.iter_rows(named=True):
        at = {"row": entry["row"], "time": entry["time"]}
        if entry["micro"]:
            events.append(BasalEvent(**at, what="usual", value=0.0))
        try:
            if entry["suspend"] is not None:
                events.append(
                    BasalEvent(
                        **at, what="resume" if any(word in entry["suspend"].upper() for word in _RUNNING) else "suspend"
                    )
                )
            if entry["basal"] is not None:
                events.append(BasalEvent(**at, what="usual", value=_number(entry["basal"])))
            if entry["temp"] is not None:
                percent = any(word in (entry["temp_type"] or "").casefold() for word in _PERCENT)
                events.append(
                    BasalEvent(
                        **at,
                        what="percent" if percent else "absolute",
                        value=_number(entry["temp"]),
                        minutes=_minutes(entry["temp_duration"]),
                    )
                )
        except ValueError:
            unreadable += 1
    return events, unreadable


class _DaySum(NamedTuple):
    """Automatic insulin of one day."""

    row: int
    day: datetime
    """Midnight at which the day begins."""
    insulin_U: float
    minutes: float
    """Time over which it was given: the day, or of the last one the part that the file has."""


def _day_sums(frame: pl.DataFrame, result: pl.DataFrame) -> list[_DaySum]:
    """Sums of the automatic insulin of each day, in the order of time; the last one of a day that has several."""
    last = result["time"].max()
    sums = frame.select("bolus_source", "bolus").with_columns(result["row"], result["time"])
    sums = sums.filter(pl.col("bolus_source").str.contains(_DAY_SUM), pl.col("time").is_not_null()).sort("time")
    days: dict[datetime, _DaySum] = {}
    for entry in sums.iter_rows(named=True):
        day = entry["time"].replace(hour=0, minute=0, second=0, microsecond=0)
        insulin = number_in(entry["bolus"])
        if insulin is None or not isinstance(last, datetime):
            continue
        minutes = min((last - day).total_seconds() / S_PER_MIN, MIN_PER_DAY)
        days[day] = _DaySum(entry["row"], day, insulin, minutes if minutes > 0.0 else MIN_PER_DAY)
    return list(days.values())


def _with_day_sums(events: Sequence[BasalEvent], sums: Sequence[_DaySum], notes: list[str]) -> list[BasalEvent]:
    """Entries about the basal rate of which, on a day with a sum of automatic insulin, that sum alone counts."""
    days = {own.day.date() for own in sums}
    inside = [event for event in events if event.time.date() in days]
    kept = [event for event in events if event.time.date() not in days]
    given = [
        BasalEvent(
            row=own.row,
            time=own.day,
            what="absolute",
            value=own.insulin_U * MIN_PER_H / own.minutes,
            minutes=own.minutes,
        )
        for own in sums
    ]
    notes.append(
        f"{how_many(len(sums), 'day has', 'days have')} a sum of the insulin that automation gave, basal and automatic "
        "corrections, and not its times: it is spread evenly over the day as a basal rate."
    )
    own_rates = {
        event.time.date() for event in inside if event.what in ("usual", "absolute", "percent") and event.value
    }
    if own_rates:
        notes.append(
            f"{how_many(len(own_rates), 'of these days has', 'of these days have')} basal rates of the pump too, and "
            "nothing tells how long they ran beside automation: they were not used there."
        )
    # What holds after the last of these days is the rate that the pump logged last in them, if any.
    after = [event for event in inside if event.what == "usual" and event.value]
    after = after or [BasalEvent(row=sums[0].row, time=sums[0].day, what="usual", value=math.nan)]
    return [*kept, *given, *after]


def _bolus_minutes(frame: pl.DataFrame) -> pl.Series:
    """Time over which each bolus is given, where its type is square or the square part of a dual one [min]."""
    parts = frame["bolus_duration"].str.extract_groups(r"^(\d+):(\d{2}):(\d{2})$").struct.unnest()
    hours, minutes, seconds = (pl.col(name).cast(pl.Float64, strict=False) for name in parts.columns)
    square = frame["bolus_type"].str.to_lowercase().str.contains_any(list(_SQUARE))
    return parts.select(pl.when(square).then(60.0 * hours + minutes + seconds / 60.0)).to_series()


def _number(text: str) -> float:
    return number_of(text.replace(",", "."))


def _minutes(text: str | None) -> float:
    """Minutes of a duration like 1:30:00."""
    hours, minutes, seconds = (text or "").split(":")
    return 60.0 * number_of(hours) + number_of(minutes) + number_of(seconds) / 60.0
