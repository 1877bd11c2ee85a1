"""CSV of CareLink as it was until 2017, of pumps of Medtronic, in any language.

Below some lines about the person and the devices stands one table of all events. Its names and its dates are in the
language of the account, but the columns stand in one order, and the kind of each event and its values are in English
everywhere: ``Raw-Type`` as ``BolusSquare`` and ``Raw-Values`` as ``AMOUNT=1.7, DURATION=3600000``. A row of a bolus has
what was delivered, and both parts of a dual bolus have a row each. A scheduled basal rate stands where it begins.
"""

from __future__ import annotations

import re
from typing import Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.devices import device_kinds
from glucoloop.records.extract import BasalEvent, Extract, basal_rates, extract_frame, number_in, with_basal
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of
from glucoloop.refusal import Refusal

_PLACES: Final = {
    "date": 1,
    "clock": 2,
    "changed": 4,
    "meter": 5,
    "temp": 7,
    "bolus": 12,
    "carbs": 23,
    "glucose": 30,
    "type": 33,
    "values": 34,
    "device": 38,
}
"""Place of each column, in every language."""
_FEWEST_FIELDS: Final = 35
_KNOWN: Final = re.compile(
    r"[,;\t]\"?(GlucoseSensorData|BolusNormal|BolusSquare|BasalProfileStart|ResultDailyTotal|BG[A-Z]\w+|Current[A-Z]\w+|"
    r"Change[A-Z]\w+|SensorCal\w+|CalBGForPH|UnabsorbedInsulin|Prime|Rewind|Alarm\w+)\"?[,;\t]"
)
_SENSOR, _SQUARE = "GlucoseSensorData", "BolusSquare"
_BOLUSES: Final = ("BolusNormal", _SQUARE)
_MEALS: Final = ("BolusWizardBolusEstimate", "JournalEntryMealMarker")
_MS_PER_MIN: Final = 60_000.0
_RUNNING: Final = ("normal", "auto_resume", "user_restart")
"""Beginnings of the state of a pump that delivers; ``null`` tells nothing, and any other state is a suspension."""


def notes_on_clock(frame: pl.DataFrame) -> list[str]:
    """Sentence on settings of the clock, which stand in the column ``changed``; none where there are none."""
    count = int(frame["changed"].is_not_null().sum())
    return [f"The clock of the device was set {count} times; times are as it showed them."] if count else []


def place_of_raw(content: FileText) -> tuple[int, str] | None:
    """Line and delimiter of the header of such a table; None if there is none."""
    for place, fields in content.fields:
        if len(fields) >= _FEWEST_FIELDS and all(
            any(unit in fields[_PLACES[name]] for unit in UNITS) for name in ("meter", "glucose")
        ):
            return place if _KNOWN.search("\n".join(content.head[place[0] + 1 :])) else None
    return None


class CareLinkRaw(ReaderComponent, name="carelink-raw"):
    """CSV that CareLink exported until 2017, with the raw events of pumps of Medtronic."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the header of such a table."""
        return place_of_raw(content) is not None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of all events."""
        place = place_of_raw(content)
        if place is None:
            raise Refusal("it has no table of CareLink with raw types and values; export it again")
        table = content.table(place)
        names = table.frame.columns
        frame = table.frame.select(
            **{name: table.texts(names[at] if at < len(names) else None) for name, at in _PLACES.items()}
        )
        times, notes = times_of(frame.select(pl.concat_str("date", "clock", separator=" ")).to_series(), answers)
        notes += notes_on_clock(frame)
        kind, in_grams = pl.col("type"), ~_value("CARB_UNITS").str.contains("(?i)exchange").fill_null(False)
        in_grams &= pl.lit("exchange" not in names[_PLACES["carbs"]].casefold())
        named = (
            pl.when(kind == "Prime")
            .then(pl.lit("insulin that fills a tube or a cannula, which nobody gets"))
            .when(kind.is_in(_MEALS) & ~in_grams)
            .then(pl.lit("meals in exchanges, not in grams"))
            .when(kind.is_in(_MEALS))
            .then(pl.lit("entries of the bolus calculator and of meals without carbohydrate"))
            .when(kind.str.contains("Cal"))
            .then(pl.lit("calibrations"))
            .when(kind.str.starts_with("BG"))
            .then(pl.lit("finger pricks"))
            .when(kind.str.starts_with("Alarm") | kind.str.starts_with("ClearAlarm"))
            .then(pl.lit("alarms"))
            .otherwise(pl.lit("entries about the device"))
        )
        carbs = pl.coalesce("carbs", _value("CARB_INPUT"))
        eaten = kind.is_in(_MEALS) & in_grams & (carbs.str.replace(",", ".").cast(pl.Float64, strict=False) != 0.0)
        of_sensor = kind.str.starts_with(_SENSOR)
        minutes = _value("DURATION").str.replace(",", ".").cast(pl.Float64, strict=False) / _MS_PER_MIN
        result = extract_frame(
            frame,
            times,
            table.spoilt,
            glucose=pl.when(kind == _SENSOR).then("glucose"),
            out_of_range=pl.when(of_sensor & (kind != _SENSOR)).then(kind.str.slice(len(_SENSOR)).str.to_lowercase()),
            carbs=pl.when(eaten).then(carbs),
            bolus=pl.when(kind.is_in(_BOLUSES)).then("bolus"),
            bolus_min=pl.when(kind == _SQUARE).then(minutes),
            source=pl.col("device"),
            device=pl.lit(device_kinds(frame["device"], "Medtronic")),
            kind=named,
        )
        marks = pl.when(pl.col("out_of_range").is_in(["low", "high"])).then("out_of_range")
        result = result.with_columns(out_of_range=marks)
        unit = next(unit for unit in UNITS if unit in names[_PLACES["glucose"]].casefold())
        rates = basal_rates(_basal_events(frame, result))
        return Extract(frame=with_basal(result, rates), glucose_unit=unit, notes=(*table.notes, *notes))


def _value(key: str) -> pl.Expr:
    """Value of a key among the raw values, which a decimal comma does not end."""
    return pl.col("values").str.extract(rf"\b{key}=([^,=]*(?:,\d+)?)")


def _basal_events(frame: pl.DataFrame, result: pl.DataFrame) -> list[BasalEvent]:
    """Scheduled and temporary basal rates and suspensions, in the order of the file."""
    keys = ("RATE", "PERCENT_OF_RATE", "DURATION", "ENABLE", "STATE")
    about = frame.select("type", "temp", **{key: _value(key) for key in keys}).with_columns(
        result["row"], result["time"]
    )
    about = about.filter(
        pl.col("time").is_not_null(), pl.col("type").str.contains("^(BasalProfileStart|ChangeTempBasal|ChangeSuspend)")
    )
    events: list[BasalEvent] = []
    for entry in about.iter_rows(named=True):
        at = {"row": entry["row"], "time": entry["time"]}
        rate, percent, span = (number_in(entry[key]) for key in keys[:3])
        minutes = (span or 0.0) / _MS_PER_MIN
        if entry["type"] == "BasalProfileStart":
            if rate is not None:
                events.append(BasalEvent(**at, what="usual", value=rate))
        elif entry["type"].startswith("ChangeSuspend"):
            state = (entry["ENABLE"] or entry["STATE"] or "null").strip().casefold()
            if state != "null":
                events.append(BasalEvent(**at, what="resume" if state.startswith(_RUNNING) else "suspend"))
        elif minutes <= 0.0:
            events.append(BasalEvent(**at, what="end"))
        elif percent is not None:
            events.append(BasalEvent(**at, what="percent", value=percent, minutes=minutes))
        else:
            amount = number_in(entry["temp"]) if rate is None else rate
            if amount is not None:
                events.append(BasalEvent(**at, what="absolute", value=amount, minutes=minutes))
    return events
