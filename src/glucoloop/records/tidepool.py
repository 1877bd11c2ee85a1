"""JSON of Tidepool, a list of data of all devices with their types; its workbooks and CSV are tables of the same.

``time`` is in UTC, ``deviceTime`` on the clock of the device, and ``timezoneOffset`` the minutes between them. Glucose
is in mmol/l, unless its ``units`` say otherwise. Annotations mark readings beyond the range of the sensor. Basal rates
are segments with a rate and a duration in ms. Tables have a column for each of these values; durations there are in
minutes, and ``Zulu Time`` is the time in UTC.
"""

from __future__ import annotations

from typing import Any, ClassVar, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.devices import device_kinds, is_long_acting
from glucoloop.records.extract import (
    BasalEvent,
    Extract,
    basal_rates,
    extract_frame,
    finite,
    notes_on_spread,
    number_in,
    with_basal,
    with_doses,
)
from glucoloop.records.file_text import CellTable, FileText, cells, json_of
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.record import AUTOMATIC, MANUAL
from glucoloop.records.times import from_utc, times_of
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
    "deleted": "entries that were deleted",
}
_MS_PER_MIN: Final = 1000.0 * S_PER_MIN


_TABLES: Final = (
    ("Zulu Time", "Local Time", "Tidepool Data Type"),
    ("Zulu Time", "Local Time", "Tidepool Wizard Type"),
    ("time", "deviceTime", "type", "uploadId"),
)
_NAMES: Final = {"zulu time": "time", "tidepool data type": "type", "tidepool wizard type": "type"}
"""Names of values in a table that are not those of the data in words."""
_NUMBERS: Final = ("value", "rate", "percent", "normal", "extended", "duration", "timezoneOffset", "carbInput")
_VALUES_IN_JSON: Final = ("nutrition", "annotations", "dose", "formulation")


class Tidepool(TableReaderComponent, name="tidepool"):
    """JSON, workbooks and CSV that Tidepool exports."""

    headers: ClassVar = _TABLES

    def recognised(self, content: FileText) -> bool:
        """Whether a file is a list of data of Tidepool, or a table of them."""
        items = content.items
        if items is None:
            return super().recognised(content)
        first = [item for item in items[:50] if isinstance(item, dict)]
        return any(item.get("type") in _TYPES and "time" in item and "sgv" not in item for item in first)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of Tidepool."""
        spoilt, told = None, tuple[str, ...]()
        if content.items is None and super().recognised(content):
            _, table = self.table(content)
            items, spoilt, told = _items_of(table), table.spoilt, table.notes
        else:
            items = [item if isinstance(item, dict) else {} for item in content.objects()]
        items = [{**item, "type": "deleted"} if item.get("deletedTime") else item for item in items]
        times, notes = _times(items, answers)
        source = pl.DataFrame(
            {
                "type": cells(item.get("type") for item in items),
                "value": cells(_glucose(item) if item.get("type") == "cbg" else None for item in items),
                "bolus": cells(
                    item.get("normal") if item.get("type") == "bolus" else _injected(item, long=False) for item in items
                ),
                "long_acting": cells(_injected(item, long=True) for item in items),
                "grams": cells(_grams(item) for item in items),
                "bolus_type": cells(_bolus_types(items)),
                "named": cells(_named(item) for item in items),
                "mark": cells(_mark(item) if item.get("type") == "cbg" else None for item in items),
                "device": cells(item.get("deviceModel") or item.get("deviceId") for item in items),
                "source": cells(_source(item) for item in items),
            }
        )
        result = extract_frame(
            source,
            times,
            spoilt,
            glucose=pl.col("value"),
            carbs=pl.col("grams"),
            bolus=pl.col("bolus"),
            bolus_type=pl.col("bolus_type"),
            long_acting=pl.col("long_acting"),
            out_of_range=pl.when(pl.col("mark").is_in(("low", "high"))).then("mark"),
            device=pl.lit(device_kinds(source["device"], "other")),
            source=pl.col("source"),
            kind=pl.coalesce(
                "named",
                pl.col("type").replace_strict(_KINDS, default="entries of other types", return_dtype=pl.String),
            ),
        )
        extended = [(row, *dose) for row, item in enumerate(items) if (dose := _extended(item)) is not None]
        result = with_doses(result, extended)
        for mark in ("low", "high"):
            count = result.filter(pl.col("out_of_range") == mark).height
            if count:
                notes.append(f"{count} readings are marked as {mark}er than the sensor can read.")
        notes += notes_on_spread(len(extended))
        events = _basal_events(items, times["time"].to_list())
        zones = dict.fromkeys(
            str(item["timezone"]) for item in items if item.get("type") == "upload" and item.get("timezone")
        )
        return Extract(
            frame=with_basal(result, basal_rates(events)),
            glucose_unit="mg/dl",
            notes=(*told, *notes),
            zones=tuple(zones) if len(zones) == 1 else (),
        )


def _items_of(table: CellTable) -> list[dict[str, Any]]:
    """Data of Tidepool from the rows of a table, as they stand in its JSON."""
    keys = [_key(name) for name in table.frame.columns]
    rows = table.frame.select(table.texts(name) for name in table.frame.columns)
    items: list[dict[str, Any]] = []
    for row in rows.iter_rows():
        item: dict[str, Any] = {key: cell for key, cell in zip(keys, row, strict=True) if cell is not None}
        for key in _NUMBERS:
            if key in item:
                number = number_in(item[key])
                item[key] = item[key] if number is None else number
        if isinstance(item.get("duration"), float):
            item["duration"] *= _MS_PER_MIN
        if "suppressed.rate" in item:
            item["suppressed"] = {"rate": number_in(item["suppressed.rate"])}
        for key in _VALUES_IN_JSON:
            if key in item:
                item[key] = json_of(item[key])
        items.append(item)
    return items


def _key(name: str) -> str:
    """Name of a value in the JSON of Tidepool, of its name at the head of a column."""
    words = name.partition(" (")[0]
    if words.casefold() in _NAMES or " " not in words:
        return _NAMES.get(words.casefold(), words[:1].lower() + words[1:])
    first, *others = words.split()
    divider = "." if first == "Suppressed" else ""
    key = "".join(other.capitalize() for other in others)
    return first.lower() + divider + (key[:1].lower() + key[1:] if divider else key)


def _times(items: list[dict[str, Any]], answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Instant in UTC of each datum, and the offset of the clock on the wall, from either of the two that tell it."""
    instants, notes = times_of(cells(item.get("time") for item in items), answers)
    shown, _ = times_of(cells(item.get("deviceTime") for item in items), answers)
    offsets = pl.Series([finite(item.get("timezoneOffset")) for item in items], dtype=pl.Float64)
    between = (shown["time"] - instants["time"]).dt.total_minutes()
    known = pl.select(pl.coalesce(offsets.cast(pl.Int64, strict=False), between)).to_series()
    known = pl.select(pl.when(known.is_between(-840, 840)).then(known)).to_series()
    return from_utc(instants["time"], known), notes


def _source(item: dict[str, Any]) -> str | None:
    """Device or app that made a datum; a bolus wizard is another source than food."""
    device = item.get("deviceId") or item.get("deviceModel")
    kind = item.get("type") if item.get("type") in ("wizard", "food") else ""
    return f"{kind}|{device}" if device or kind else None


def _named(item: dict[str, Any]) -> str | None:
    """Words for a datum whose insulin is no dose; None for others."""
    if item.get("type") == "deviceEvent":
        kind = item.get("subType")
        if kind == "prime":
            return "insulin that fills a tube or a cannula, which nobody gets"
        if kind == "status":
            return "suspensions and resumptions of the pump, which its basal rates tell"
    return "doses of insulin without a number" if item.get("type") in ("bolus", "insulin") else None


def _injected(item: dict[str, Any], *, long: bool) -> Any:
    """Dose of a pen, of long-acting insulin or of another one."""
    dose, of = item.get("dose"), item.get("formulation")
    if item.get("type") != "insulin" or not isinstance(dose, dict):
        return None
    kind = of.get("simple") if isinstance(of, dict) else None
    words = f"{kind.get('actingType')} {kind.get('brand')}" if isinstance(kind, dict) else str(of)
    return dose.get("total") if (words.startswith(("long", "intermediate")) or is_long_acting(words)) is long else None


def _bolus_types(items: list[dict[str, Any]]) -> list[str | None]:
    """Type of each bolus; those that are not automatic are of the person where a device tells automatic ones apart."""
    automatic = [item.get("type") == "bolus" and item.get("subType") == "automated" for item in items]
    other = MANUAL if any(automatic) else None
    return [AUTOMATIC if one else other for one in automatic]


def _extended(item: dict[str, Any]) -> tuple[float, float] | None:
    """Insulin that a bolus gives over a time [U], and that time [min]; None if it gives none so."""
    if item.get("type") != "bolus":
        return None
    dose, duration = number_in(item.get("extended")), number_in(item.get("duration"))
    return (dose, (duration or 0.0) / _MS_PER_MIN) if dose else None


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


def _grams(item: dict[str, Any]) -> Any:
    if item.get("type") == "wizard":
        return item.get("carbInput")
    value: Any = item.get("nutrition") if item.get("type") == "food" else None
    for key in ("carbohydrate", "net"):
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _rate(item: dict[str, Any]) -> float | None:
    """Basal rate of a segment [U/h], also of one that tells a share of the rate that it takes the place of."""
    rate, share, instead = finite(item.get("rate")), finite(item.get("percent")), item.get("suppressed")
    if rate is None and share is not None and isinstance(instead, dict):
        usual = _rate(instead)
        return None if usual is None else share * usual
    return rate


def _basal_events(items: list[dict[str, Any]], times: list[Any]) -> list[BasalEvent]:
    events = []
    for row, (item, time) in enumerate(zip(items, times, strict=True)):
        if item.get("type") != "basal" or time is None:
            continue
        suspended = item.get("deliveryType") == "suspend"
        rate, duration = 0.0 if suspended else _rate(item), finite(item.get("duration"))
        if rate is not None and duration is not None and duration >= 0.0:
            events.append(BasalEvent(row=row, time=time, what="absolute", value=rate, minutes=duration / _MS_PER_MIN))
    return events
