"""JSON of Tidepool: a list of data of all devices, each with its type.

``time`` is in UTC, ``deviceTime`` on the clock of the device, and ``timezoneOffset`` the minutes between them. Glucose
is in mmol/l, unless its ``units`` say otherwise. Annotations mark readings beyond the range of the sensor. Basal rates
are segments with a rate and a duration in ms.
"""

from __future__ import annotations

from typing import Any, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.basal import BasalEvent, basal_rates
from glucoloop.records.devices import device_kinds
from glucoloop.records.extract import Extract, cells, extract_frame, finite, with_basal
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import TIME, from_utc, times_of
from glucoloop.units import MG_DL_PER_MMOL_L, S_PER_MIN

_TYPES: Final = ("cbg", "smbg", "basal", "bolus", "wizard", "food", "upload", "pumpSettings", "deviceEvent")
_KINDS: Final = {
    "smbg": "finger pricks",
    "wizard": "bolus calculations without carbohydrate",
    "food": "entries of food without carbohydrate",
    "basal": "basal rates without a rate and a duration",
    "upload": "entries about uploads",
    "pumpSettings": "settings of pumps",
    "deviceEvent": "events of devices",
}
_MS_PER_MIN: Final = 1000.0 * S_PER_MIN


class Tidepool(ReaderComponent, name="tidepool"):
    """JSON that Tidepool exports."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is a list of data of Tidepool."""
        items = content.json
        if not isinstance(items, list):
            return False
        first = [item for item in items[:50] if isinstance(item, dict)]
        return any(item.get("type") in _TYPES and "time" in item and "sgv" not in item for item in first)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of Tidepool."""
        items = [item if isinstance(item, dict) else {} for item in content.objects()]
        times, notes = _times(items, answers)
        source = pl.DataFrame(
            {
                "type": cells(item.get("type") for item in items),
                "value": cells(_glucose(item) if item.get("type") == "cbg" else None for item in items),
                "dose": cells(_dose(item) if item.get("type") == "bolus" else None for item in items),
                "grams": cells(_grams(item) for item in items),
                "mark": cells(_mark(item) if item.get("type") == "cbg" else None for item in items),
                "source": cells(item.get("deviceModel") or item.get("deviceId") for item in items),
            }
        )
        result = extract_frame(
            source,
            times,
            glucose=pl.col("value"),
            carbs=pl.col("grams"),
            bolus=pl.col("dose"),
            out_of_range=pl.when(pl.col("mark").is_in(("low", "high"))).then("mark"),
            device=pl.lit(device_kinds(source["source"], "other")),
            kind=pl.col("type").replace_strict(_KINDS, default="entries of other types", return_dtype=pl.String),
        )
        for mark in ("low", "high"):
            count = result.filter(pl.col("out_of_range") == mark).height
            if count:
                notes.append(f"{count} readings are marked as {mark}er than the sensor can read.")
        spread = sum(item.get("type") == "bolus" and bool(finite(item.get("extended"))) for item in items)
        if spread:
            notes.append(f"{spread} boluses were given over a time; their whole dose stands at their beginning.")
        events = _basal_events(items, result["time"].to_list())
        return Extract(frame=with_basal(result, basal_rates(events)), glucose_unit="mg/dl", notes=tuple(notes))


def _times(items: list[dict[str, Any]], answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Local time and offset: of the zone asked for, or as the clock of the device showed it."""
    with_zone, notes = times_of(cells(item.get("time") for item in items), answers)
    shown, _ = times_of(cells(item.get("deviceTime") for item in items), answers)
    instants = with_zone.select(
        pl.col("time") - pl.duration(minutes=pl.col("utc_offset_min").fill_null(0), time_unit="us")
    ).to_series()
    offsets = pl.Series([finite(item.get("timezoneOffset")) for item in items], dtype=pl.Float64)
    offsets = offsets.cast(pl.Int64, strict=False)
    between = (shown["time"] - instants).dt.total_minutes()
    known = pl.select(pl.coalesce(offsets, between).fill_null(0)).to_series()
    known = pl.select(pl.when(known.is_between(-840, 840)).then(known).otherwise(0)).to_series()
    times, more = from_utc(instants, known, answers)
    if answers.time_zone is None:
        times = times.with_columns(time=pl.coalesce(shown["time"], times["time"]).cast(TIME))
    return times, [*notes, *more]


def _glucose(item: dict[str, Any]) -> Any:
    """Reading in mg/dl; what is no number is passed on, and told later."""
    value = finite(item.get("value"))
    if value is None:
        return item.get("value")
    return value if "mg" in str(item.get("units", "mmol/L")).casefold() else value * MG_DL_PER_MMOL_L


def _mark(item: dict[str, Any]) -> Any:
    notes = item.get("annotations")
    for note in notes if isinstance(notes, list) else ():
        if isinstance(note, dict) and note.get("code") == "bg/out-of-range":
            return note.get("value")
    return None


def _dose(item: dict[str, Any]) -> Any:
    doses = [item[name] for name in ("normal", "extended") if item.get(name) is not None]
    numbers = [finite(dose) for dose in doses]
    if not doses or None in numbers:
        return doses[0] if doses else None
    return sum(number for number in numbers if number is not None)


def _grams(item: dict[str, Any]) -> Any:
    if item.get("type") == "wizard":
        return item.get("carbInput")
    value: Any = item.get("nutrition") if item.get("type") == "food" else None
    for key in ("carbohydrate", "net"):
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _basal_events(items: list[dict[str, Any]], times: list[Any]) -> list[BasalEvent]:
    events = []
    for row, (item, time) in enumerate(zip(items, times, strict=True)):
        if item.get("type") != "basal" or time is None:
            continue
        suspended = item.get("deliveryType") == "suspend"
        rate, duration = 0.0 if suspended else finite(item.get("rate")), finite(item.get("duration"))
        if rate is not None and duration is not None and duration >= 0.0:
            events.append(BasalEvent(row=row, time=time, what="absolute", value=rate, minutes=duration / _MS_PER_MIN))
    return events
