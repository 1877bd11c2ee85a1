"""JSON of Nightscout: entries, with the readings, treatments, with carbohydrate, boluses and rates, and profiles.

Times are instants in UTC, with the offset of the uploader's clock where it told one. Readings are in mg/dl whatever the
site shows; 39 stands for low and 401 for high.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import replace
from datetime import UTC
from typing import Any, Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.basal import BasalEvent, basal_rates
from glucoloop.records.devices import device_kinds
from glucoloop.records.extract import Extract, cells, extract_frame, finite, with_basal
from glucoloop.records.file_text import FileText
from glucoloop.records.nightscout_profile import SWITCH, profiles_of, usual_rates
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import TIME, from_utc, times_of

_LOW_CODE, _HIGH_CODE = 39, 401
_KINDS: Final = {"mbg": "finger pricks", "cal": "calibrations"}
_TEMPORARY: Final = "Temp Basal"


class Nightscout(ReaderComponent, name="nightscout"):
    """JSON of entries or treatments of Nightscout, and of its profiles beside them."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is a list of entries, treatments or profiles."""
        items = content.json
        if not isinstance(items, list):
            return False
        if profiles_of(content):
            return True
        first = [item for item in items[:50] if isinstance(item, dict)]
        return any("sgv" in item or "mbg" in item or ("eventType" in item and "created_at" in item) for item in first)

    def with_profiles(self, content: FileText, answers: Answers) -> Answers | None:
        """Answers with the profiles that a file holds; None for a file of entries or treatments."""
        profiles = profiles_of(content)
        return replace(answers, basal_profiles=(*answers.basal_profiles, *profiles)) if profiles else None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of entries or treatments."""
        items = [item if isinstance(item, dict) else {} for item in content.objects()]
        instants, offsets, notes = _instants(items, answers)
        times, more = from_utc(instants, offsets, answers)
        source = pl.DataFrame(
            {
                "sgv": cells(item.get("sgv") if item.get("type", "sgv") == "sgv" else None for item in items),
                "type": cells(item.get("type") for item in items),
                "event": cells(item.get("eventType") for item in items),
                "insulin": cells(item.get("insulin") for item in items),
                "grams": cells(item.get("carbs") for item in items),
                "source": cells(item.get("device", item.get("enteredBy")) for item in items),
            }
        )
        code = pl.col("sgv").cast(pl.Float64, strict=False)
        kind = (
            pl.when(pl.col("event") == _TEMPORARY)
            .then(pl.lit("temporary basal rates without a rate and a duration"))
            .when(pl.col("event").is_not_null())
            .then(pl.lit("treatments without carbohydrate or insulin"))
            .when(pl.col("type").is_not_null() & (pl.col("type") != "sgv"))
            .then(pl.col("type").replace_strict(_KINDS, default="entries of other types", return_dtype=pl.String))
        )
        result = extract_frame(
            source,
            times,
            glucose=pl.col("sgv"),
            carbs=pl.col("grams"),
            bolus=pl.col("insulin"),
            out_of_range=pl.when(code == _LOW_CODE).then(pl.lit("low")).when(code == _HIGH_CODE).then(pl.lit("high")),
            device=pl.when(pl.col("sgv").is_not_null()).then(pl.lit(device_kinds(source["source"], "other"))),
            kind=kind,
        )
        for mark, number in (("low", _LOW_CODE), ("high", _HIGH_CODE)):
            count = result.filter(pl.col("out_of_range") == mark).height
            if count:
                more.append(f"{count} readings of {number} stand for {mark}.")
        spread = sum(item.get("eventType") == "Combo Bolus" for item in items)
        if spread:
            more.append(f"{spread} combo boluses count with the insulin that they name, at their beginning.")
        places = result["time"].to_list()
        usual = _usual_events(items, instants.to_list(), places, answers)
        rates = basal_rates([*usual, *_basal_events(items, places)])
        unknown = sum(math.isnan(rate) for _, _, rate in rates)
        if unknown:
            more.append(
                f"The basal rate is not known from {unknown} times on: a temporary one ends or is a percentage, and "
                "the default one is not in the file; a file of profiles of Nightscout beside it tells that."
            )
        if usual:
            more.append(
                f"The usual basal rate is that of the profiles of Nightscout; it changes {len(usual) - 1} times."
            )
        return Extract(frame=with_basal(result, rates), glucose_unit="mg/dl", notes=(*notes, *more))


def _instants(items: list[dict[str, Any]], answers: Answers) -> tuple[pl.Series, pl.Series, list[str]]:
    """Instant in UTC and offset [min] of each item, from its number of milliseconds or its text."""
    numbers = [_whole(item.get("date", item.get("mills"))) for item in items]
    instants = pl.Series(numbers, dtype=pl.Int64).cast(pl.Datetime("ms")).cast(TIME)
    texts = cells(item.get("created_at") or item.get("dateString") or item.get("timestamp") for item in items)
    read, notes = times_of(texts, answers)
    shift = pl.duration(minutes=pl.col("utc_offset_min").fill_null(0), time_unit="us")
    with_zone = read.select(pl.col("time") - shift).to_series()
    offsets = pl.Series([_whole(item.get("utcOffset")) for item in items], dtype=pl.Int64)
    offsets = pl.select(pl.when(offsets.is_between(-840, 840) & (offsets != 0)).then(offsets)).to_series()
    table = pl.DataFrame({"number": instants, "told": with_zone, "own": offsets, "text": read["utc_offset_min"]})
    return (
        table.select(pl.coalesce("number", "told")).to_series(),
        table.select(pl.coalesce("own", "text").fill_null(0)).to_series(),
        notes,
    )


def _whole(value: object) -> int | None:
    """A number of JSON as a whole one, in the range of times; None for anything else."""
    number = finite(value)
    return int(number) if number is not None and abs(number) < 1e14 else None


def _usual_events(
    items: list[dict[str, Any]], instants: list[Any], times: list[Any], answers: Answers
) -> list[BasalEvent]:
    """Changes of the usual basal rate in the span of the treatments; each belongs to the row before it."""
    with_zone = (
        item.get("eventType") in (_TEMPORARY, SWITCH) or item.get("insulin") or item.get("carbs") for item in items
    )
    rows = sorted(
        (at, row)
        for row, (at, time, use) in enumerate(zip(instants, times, with_zone, strict=True))
        if at and time and use
    )
    if not answers.basal_profiles or not rows:
        return []
    switches = [(at.replace(tzinfo=UTC), items[row]) for at, row in rows if items[row].get("eventType") == SWITCH]
    first, last = (at.replace(tzinfo=UTC) for at in (rows[0][0], rows[-1][0]))
    events: list[BasalEvent] = []
    for moment, rate in usual_rates(answers.basal_profiles, switches, first, last, answers.time_zone):
        if math.isnan(rate) and not events:
            continue
        at = moment.replace(tzinfo=None)
        before, row = rows[bisect_right(rows, at, key=lambda pair: pair[0]) - 1]
        events.append(BasalEvent(row=row, time=times[row] + (at - before), what="usual", value=rate))
    return events


def _basal_events(items: list[dict[str, Any]], times: list[Any]) -> list[BasalEvent]:
    """Temporary basal rates of the treatments; a duration of 0 ends one."""
    events = []
    for row, (item, time) in enumerate(zip(items, times, strict=True)):
        if item.get("eventType") != _TEMPORARY or time is None:
            continue
        minutes, absolute, percent = (finite(item.get(name)) for name in ("duration", "absolute", "percent"))
        absolute = finite(item.get("rate")) if absolute is None else absolute
        if minutes is not None and minutes <= 0.0:
            events.append(BasalEvent(row=row, time=time, what="end"))
        elif minutes is not None and absolute is not None:
            events.append(BasalEvent(row=row, time=time, what="absolute", value=absolute, minutes=minutes))
        elif minutes is not None and percent is not None:
            events.append(BasalEvent(row=row, time=time, what="percent", value=100.0 + percent, minutes=minutes))
    return events
