"""CSV of CareLink, of pumps and sensors of Medtronic.

The file has a section for each device, which begins with a line of dashes and a header. Numbers have a point or a
comma. A bolus is logged twice, as it was selected and as it was delivered; the delivered dose counts. Sensors read from
40 to 400 mg/dl.
"""

from __future__ import annotations

from typing import Final

import polars as pl

from glucoloop.component.number_text import number_of
from glucoloop.records.answers import Answers
from glucoloop.records.basal import BasalEvent, basal_rates
from glucoloop.records.devices import kind_of
from glucoloop.records.extract import Extract, extract_frame, with_basal
from glucoloop.records.file_text import CellTable, FileText, table_of
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal

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
    "prime": "Prime Volume Delivered",
    "carbs": "BWZ Carb Input (grams",
    "exchanges": "BWZ Carb Input (exchanges",
    "suspend": "Suspend",
    "alarm": "Alarm",
    "marker": "Event Marker",
    "changed": "New Device Time",
}
_RUNNING: Final = ("NORMAL", "RESUM")
"""Words of the state of a pump that delivers again."""


class CareLink(ReaderComponent, name="carelink"):
    """CSV that CareLink exports of pumps and sensors of Medtronic."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has a header of CareLink."""
        return content.header(*_HEADER) is not None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of all sections of an export of CareLink."""
        place = content.header(*_HEADER)
        if place is None:
            raise Refusal("it has no header of CareLink, Index, Date, Time and so on; export it again")
        delimiter = place[1]
        sections = _sections(content.text, delimiter)
        units = {unit for _, table in sections for unit in _units(table)}
        if len(units) > 1:
            raise Refusal("its sections have glucose in mg/dl and in mmol/l; export it again in one unit")
        parts = [
            table.frame.select(
                device=pl.lit(device), **{name: table.texts(table.column(start)) for name, start in _COLUMNS.items()}
            )
            for device, table in sections
        ]
        frame = pl.concat(parts).with_columns(
            pl.when(~pl.col(name).str.starts_with(_RULE)).then(name) for name in _COLUMNS if name != "device"
        )
        spoilt = pl.concat([table.spoilt for _, table in sections])
        frame = frame.with_columns(pl.when(pl.lit(spoilt).is_null()).then(name) for name in _COLUMNS)
        times, notes = times_of(frame.select(pl.concat_str("date", "clock", separator=" ")).to_series(), answers)
        meal = pl.col("marker").str.extract(r"(?i)^Meal: *([0-9.,]+) *g")
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
            .then(known.replace_strict(words, default="other event markers", return_dtype=pl.String))
            .when(pl.col("alarm").is_not_null())
            .then(pl.lit("alarms"))
            .otherwise(pl.lit("entries about the device"))
        )
        if frame["changed"].is_not_null().any():
            count = int(frame["changed"].is_not_null().sum())
            notes.append(f"The clock of the device was set {count} times; times are as it showed them.")
        result = extract_frame(
            frame,
            times,
            spoilt,
            glucose=pl.col("glucose"),
            carbs=pl.coalesce("carbs", meal),
            bolus=pl.col("bolus"),
            bolus_min=pl.lit(_bolus_minutes(frame)),
            source=pl.col("device"),
            device=pl.col("device"),
            kind=kind,
        )
        events, unreadable = _basal_events(frame, result)
        if unreadable:
            notes.append(f"{unreadable} entries of basal rates hold no number.")
        unit = next(iter(units), None)
        tables = tuple(note for _, table in sections for note in table.notes)
        return Extract(frame=with_basal(result, basal_rates(events)), glucose_unit=unit, notes=(*tables, *notes))


def _sections(text: str, delimiter: str) -> list[tuple[str, CellTable]]:
    """Kind of device and table of each section; the lines before the first one are about the person."""
    result: list[tuple[str, CellTable]] = []
    device, lines = "Medtronic", list[str]()
    for line in [*text.split("\n"), _RULE]:
        if line.lstrip('"').startswith(_RULE):
            if len(result) == _MAX_SECTIONS:
                raise Refusal(f"it has more than {_MAX_SECTIONS} sections of devices; divide it")
            if lines:
                result.append((device, table_of("\n".join(lines), delimiter)))
            device, lines = kind_of(line, "Medtronic"), []
        elif lines or line.lstrip('"').startswith("Index"):
            lines.append(line)
    return result


def _units(table: CellTable) -> list[str]:
    column = (table.column("Sensor Glucose (") or "").casefold()
    return [unit for unit in ("mg/dl", "mmol/l") if unit in column]


def _basal_events(frame: pl.DataFrame, result: pl.DataFrame) -> tuple[list[BasalEvent], int]:
    """Entries about the basal rate, and the number of those that cannot be read."""
    about = ("basal", "temp", "temp_type", "temp_duration", "suspend")
    logged = frame.select(*about).with_columns(result["row"], result["time"]).reverse()
    logged = logged.filter(
        pl.any_horizontal(pl.col("basal", "temp", "suspend").is_not_null()) & pl.col("time").is_not_null()
    )
    events: list[BasalEvent] = []
    unreadable = 0
    for entry in logged.iter_rows(named=True):
        at = {"row": entry["row"], "time": entry["time"]}
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
                percent = "percent" in (entry["temp_type"] or "").casefold()
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


def _bolus_minutes(frame: pl.DataFrame) -> pl.Series:
    """Time over which each bolus is given, where its type is square or the square part of a dual one [min]."""
    parts = frame["bolus_duration"].str.extract_groups(r"^(\d+):(\d{2}):(\d{2})$").struct.unnest()
    hours, minutes, seconds = (pl.col(name).cast(pl.Float64, strict=False) for name in parts.columns)
    square = frame["bolus_type"].str.to_lowercase().str.contains("square")
    return parts.select(pl.when(square).then(60.0 * hours + minutes + seconds / 60.0)).to_series()


def _number(text: str) -> float:
    return number_of(text.replace(",", "."))


def _minutes(text: str | None) -> float:
    """Minutes of a duration like 1:30:00."""
    hours, minutes, seconds = (text or "").split(":")
    return 60.0 * number_of(hours) + number_of(minutes) + number_of(seconds) / 60.0
