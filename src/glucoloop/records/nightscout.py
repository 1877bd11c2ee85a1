"""JSON of Nightscout: entries, with the readings, treatments, with carbohydrate, boluses and rates, and profiles.

Entries come as CSV and as text too, and treatments as tables: see `nightscout_table`.

Times are instants in UTC, with the offset of the uploader's clock where it told one: an offset of 0 stands for an
unknown one too, since the server writes it beside each time that ends in Z. Readings are in mg/dl whatever the site
shows; 39 stands for low and 401 for high. Lists come as such, as the ``result`` of version 3 of the interface, and as
the lines of ``mongoexport``. Combo boluses tell their parts as AndroidAPS and Nightscout's careportal write
them, injections their insulins as xDrip does, percentages of the usual rate as a change (``percent``) or, from OpenAPS,
as the whole (``temp``: percent).
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC
from typing import Any, ClassVar, Final, NamedTuple

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.devices import device_kinds, is_long_acting
from glucoloop.records.extract import (
    BasalEvent,
    Extract,
    basal_rates,
    extract_frame,
    notes_on_spread,
    number_in,
    with_basal,
    with_doses,
)
from glucoloop.records.file_text import FileText, cells, json_of
from glucoloop.records.nightscout_profile import SWITCH, fixed_zone, profiles_of, usual_rates, zones_of
from glucoloop.records.nightscout_table import is_table, items_of
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.record import AUTOMATIC, MANUAL
from glucoloop.records.times import TIME, far_from_others, from_utc, times_of
from glucoloop.refusal import Refusal
from glucoloop.text import how_many
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H

_LOW_CODE, _HIGH_CODE = 39, 401
_KINDS: Final = {"mbg": "finger pricks", "cal": "calibrations"}
_TEMPORARY: Final = r"(?i)^temp(orary)? ?basal"
_COMBO: Final = "Combo Bolus"
_BY_THE_PERSON: Final = ("Meal Bolus", "Snack Bolus", "Bolus Wizard", _COMBO)
_SUSPEND: Final = re.compile(r"(?i)suspen|\bstop(ped)? (pump|insulin|delivery)|(pump|insulin|delivery) stop")
_RESUME: Final = re.compile(
    r"(?i)resum|unsuspen|\b(re)?start(ed)? (pump|insulin|delivery)|(pump|insulin|delivery) (re)?start"
)
_OF_INSULIN: Final = r"(?i)bolus|insulin|basal|suspen|resum|prim(e|ing)|dose|injection|pen\b"
_DELETED: Final = "entries that were deleted"
_PRIMING: Final = "insulin that fills a tube or a cannula, which nobody gets"
_SWITCHES: Final = "changes of the profile, which tell the usual basal rate"
_MS_PER_MIN: Final = 60_000.0
_MAX_OFFSET_MIN: Final = 840
_SECONDS: Final = (10**8, 10**11)
"""Numbers that are seconds since 1970, of 1973 to 5138; as milliseconds they would be of the first years alone."""


class Nightscout(ReaderComponent, name="nightscout"):
    """JSON of entries or treatments of Nightscout, and of its profiles beside them."""

    in_parts: ClassVar = True

    def recognised(self, content: FileText) -> bool:
        """Whether a file is a list of entries, treatments or profiles."""
        items = content.items
        if items is None:
            return is_table(content)
        if profiles_of(content):
            return True
        first = [item for item in items[:50] if isinstance(item, dict)]
        return any(
            "sgv" in item or "mbg" in item or ("eventType" in item and {"created_at", "date", "mills"} & item.keys())
            for item in first
        )

    def with_profiles(self, content: FileText, answers: Answers) -> Answers | None:
        """Answers with the profiles that a file holds; None for a file of entries or treatments."""
        profiles = profiles_of(content)
        return replace(answers, basal_profiles=(*answers.basal_profiles, *profiles)) if profiles else None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of entries or treatments."""
        items = _items(content)
        sources = cells(_source(item) for item in items)
        times, notes = _times(items, sources, answers)
        doses = [_doses(item) for item in items]
        source = pl.DataFrame(
            {
                "sgv": cells(_reading(item) for item in items),
                "type": cells(item.get("type") for item in items),
                "event": cells(item.get("eventType") for item in items),
                "bolus": cells(dose.bolus for dose in doses),
                "long_acting": cells(dose.long_acting for dose in doses),
                "grams": cells(None if _is_deleted(item) else item.get("carbs") for item in items),
                "bolus_type": cells(_bolus_type(item) for item in items),
                "named": cells(dose.named for dose in doses),
                "source": sources,
            }
        )
        code = pl.col("sgv").cast(pl.Float64, strict=False)
        kind = (
            pl.when(pl.col("named").is_not_null())
            .then("named")
            .when(pl.col("event").str.contains(_TEMPORARY))
            .then(pl.lit("temporary basal rates without a rate and a duration"))
            .when(pl.col("event") == SWITCH)
            .then(pl.lit(_SWITCHES))
            .when(pl.col("event").str.contains(_OF_INSULIN))
            .then(pl.lit("entries about insulin without a dose"))
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
            bolus=pl.col("bolus"),
            bolus_type=pl.col("bolus_type"),
            long_acting=pl.col("long_acting"),
            out_of_range=pl.when(code == _LOW_CODE).then(pl.lit("low")).when(code == _HIGH_CODE).then(pl.lit("high")),
            device=pl.when(pl.col("sgv").is_not_null()).then(pl.lit(device_kinds(source["source"], "other"))),
            source=pl.col("source"),
            kind=kind,
        )
        result = with_doses(result, [(row, *dose.extended) for row, dose in enumerate(doses) if dose.extended])
        for mark, number in (("low", _LOW_CODE), ("high", _HIGH_CODE)):
            count = result.filter(pl.col("out_of_range") == mark).height
            if count:
                text = how_many(count, f"reading of {number} stands", f"readings of {number} stand")
                notes.append(f"{text} for {mark}.")
        spread = sum(dose.extended is not None for dose in doses)
        notes += [*notes_on_spread(spread), *_notes_on_meals(items), *_notes_on_words(items, doses)]
        instants = times["time"].to_list()
        usual = _usual_events(items, instants, times, answers, notes)
        rates = basal_rates([*usual, *_basal_events(items, instants)])
        unknown = sum(math.isnan(rate) for _, _, rate in rates)
        if unknown:
            notes.append(
                f"The basal rate is not known from {unknown} times on: a temporary one ends or is a percentage, and "
                "the default one is not in the file; a file of profiles of Nightscout beside it tells that."
            )
        if usual:
            notes.append(
                f"The usual basal rate is that of the profiles of Nightscout; it changes {len(usual) - 1} times."
            )
        unit = answers.glucose_unit if content.items is None else None  # programs that make tables may convert it
        return Extract(frame=with_basal(result, rates), glucose_unit=unit or "mg/dl", notes=tuple(notes))


def _items(content: FileText) -> list[dict[str, Any]]:
    """Entries or treatments of a file; an empty one for each that is none."""
    if content.items is None and is_table(content):
        return items_of(content)
    return [item if isinstance(item, dict) else {} for item in content.objects()]


def _notes_on_meals(items: list[dict[str, Any]]) -> list[str]:
    """Sentences on carbohydrate that is not eaten at once, or was not eaten as such."""
    meals = [item for item in items if (number_in(item.get("carbs")) or 0.0) > 0.0 and not _is_deleted(item)]
    spread = sum((_minutes(item) or 0.0) > 0.0 and item.get("eventType") != _COMBO for item in meals)
    equivalent = sum(item.get("isFPU") is True for item in meals)
    notes = []
    if spread:
        entries = how_many(spread, "entry", "entries")
        notes.append(f"{entries} of carbohydrate over a time: the whole stands at the beginning.")
    if equivalent:
        entries = how_many(equivalent, "entry", "entries")
        notes.append(f"{entries} of carbohydrate that an app counts for fat and protein: used as carbohydrate.")
    return notes


def _notes_on_words(items: list[dict[str, Any]], doses: Sequence[_Doses]) -> list[str]:
    """Sentence on boluses of which a note names a long-acting insulin, for which some programs have no other place."""
    named = sum(
        (number_in(dose.bolus) or 0.0) > 0.0 and is_long_acting(str(item.get("notes") or ""))
        for item, dose in zip(items, doses, strict=True)
    )
    if not named:
        return []
    return [
        f"{how_many(named, 'bolus has', 'boluses have')} the name of a long-acting insulin in the note, and "
        f"count{'s' * (named == 1)} as rapid-acting all the same: nothing but the note tells it."
    ]


class _Doses(NamedTuple):
    """Insulin of a treatment."""

    bolus: Any = None
    """Insulin at once [U], still as it stands there."""
    extended: tuple[float, float] | None = None
    """Insulin over a time [U], and that time [min]."""
    long_acting: Any = None
    named: str | None = None
    """Words for an entry whose insulin nobody gets."""


def _is_deleted(item: dict[str, Any]) -> bool:
    """Whether an entry was deleted; some programs write words or numbers for true and false."""
    valid = item.get("isValid")
    gone = [str(item.get(name) or "").casefold() for name in ("isDeleted", "deleted")]
    return (valid is not None and str(valid).casefold() in ("false", "0")) or any(
        word in ("true", "1") for word in gone
    )


def _source(item: dict[str, Any]) -> str | None:
    """Device or app that made an entry."""
    told = [item.get(name) for name in ("device", "enteredBy", "app")]
    return "|".join(str(name) for name in told if name) or None


def _reading(item: dict[str, Any]) -> Any:
    if item.get("type", "sgv") != "sgv" or _is_deleted(item):
        return None
    value = item.get("sgv")
    if str(item.get("units", "")).casefold().startswith("mmol"):
        number = number_in(value)
        return value if number is None else number * MG_DL_PER_MMOL_L
    return value


def _minutes(item: dict[str, Any]) -> float | None:
    """Duration of a treatment."""
    milliseconds = number_in(item.get("durationInMilliseconds"))
    return number_in(item.get("duration")) if milliseconds is None else milliseconds / _MS_PER_MIN


def _doses(item: dict[str, Any]) -> _Doses:
    """Insulin of an entry, each part of it."""
    if _is_deleted(item):
        return _Doses(named=_DELETED)
    event, insulin = str(item.get("eventType", "")), item.get("insulin")
    if str(item.get("type", "")).upper() == "PRIMING" or re.search(r"(?i)\bprim(e|ing)\b", event):
        return _Doses(named=_PRIMING if number_in(insulin) else None)
    injections = _injections(item.get("insulinInjections"))
    if injections is not None:
        fast, slow = (sum(units for units, long in injections if long is which) for which in (False, True))
        return _Doses(bolus=fast or None, long_acting=slow or None)
    named = next((item[name] for name in ("insulinType", "insulinName", "insulin_name") if item.get(name)), event)
    if insulin is not None and is_long_acting(str(named)):
        return _Doses(long_acting=insulin)
    minutes = _minutes(item)
    if event != _COMBO or minutes is None or minutes <= 0.0:
        entered = item.get("enteredinsulin") if insulin is None and event == _COMBO else None
        return _Doses(bolus=insulin if entered is None else entered)
    now, extended = _parts(item, minutes)
    return _Doses(bolus=insulin if now is None else now or None, extended=(extended, minutes) if extended else None)


def _bolus_type(item: dict[str, Any]) -> str | None:
    """Type of a bolus: AndroidAPS and Loop tell whether it is automatic, and an entry of the person has a name."""
    event = item.get("eventType")
    told = [item.get("isSMB"), item.get("automatic")]
    if True in told or "SMB" in (event, item.get("type")):
        return AUTOMATIC
    return MANUAL if False in told or event in _BY_THE_PERSON else None


def _parts(item: dict[str, Any], minutes: float) -> tuple[float | None, float | None]:
    """Insulin at once and over the duration of a combo bolus [U]; None where it does not tell."""
    entered, insulin, rate = (number_in(item.get(name)) for name in ("enteredinsulin", "insulin", "relative"))
    share_now, share_later = (number_in(item.get(name)) for name in ("splitNow", "splitExt"))
    if share_later is None and share_now is not None:
        share_later = 100.0 - share_now
    if entered is not None and share_later is not None and 0.0 <= share_later <= 100.0:
        later = entered * share_later / 100.0
        return entered - later if insulin is None else insulin, later
    if entered is not None and insulin is not None and entered >= insulin:
        return insulin, entered - insulin
    if rate is not None:
        return insulin or 0.0, rate * minutes / MIN_PER_H
    return entered if insulin is None else insulin, None


def _injections(text: Any) -> list[tuple[float, bool]] | None:
    """Units of each insulin of an entry of xDrip, and whether it is long-acting; None if it has none."""
    items = json_of(text) if isinstance(text, str) and text else text
    if not isinstance(items, list) or not items:
        return None
    result = [
        (number_in(item.get("units")) or 0.0, is_long_acting(str(item.get("insulin", ""))))
        for item in items
        if isinstance(item, dict)
    ]
    return result if any(units for units, _ in result) else None


def _times(items: list[dict[str, Any]], sources: pl.Series, answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Instant in UTC of each item, from its number of milliseconds or its text, and the offset that it tells.

    Refusal for texts without an offset from UTC, where no zone is known.
    """
    numbers = [_milliseconds(item.get("date", item.get("mills"))) for item in items]
    instants = pl.Series(numbers, dtype=pl.Int64).cast(pl.Datetime("ms")).cast(TIME)
    texts = cells(
        item.get("created_at") or item.get("dateString") or item.get("sysTime") or item.get("timestamp")
        for item in items
    )
    read, notes = times_of(texts, answers)
    offsets = pl.Series([_whole(item.get("utcOffset")) for item in items], dtype=pl.Int64)
    table = read.with_columns(number=instants, own=offsets, source=sources)
    on_the_wall = ~pl.col("in_utc") & pl.col("time").is_not_null() & pl.col("number").is_null()
    if table.select(on_the_wall.any()).item():
        zone = answers.time_zone or next(iter(zones_of(answers.basal_profiles)), None)
        if zone is None:
            raise Refusal(
                "its times tell no offset from UTC",
                "say the time zone of their clock with time_zone (--time-zone), which is UTC where the program left it "
                "so",
            )
        there = pl.col("time").dt.replace_time_zone(zone, ambiguous="earliest", non_existent="null")
        table = table.with_columns(
            time=pl.when(on_the_wall)
            .then(there.dt.convert_time_zone("UTC").dt.replace_time_zone(None))
            .otherwise("time")
        )
    table = table.select(
        "source",
        instant=pl.coalesce("number", "time"),
        offset=pl.coalesce(
            pl.col("utc_offset_min").cast(pl.Int64), pl.when(pl.col("own").abs() <= _MAX_OFFSET_MIN).then("own")
        ),
    )
    return from_utc(table["instant"], _offsets_meant(table)), notes


def _offsets_meant(table: pl.DataFrame) -> pl.Series:
    """Offsets that are meant: one of 0 is where its source tells others of up to an hour, for times of the year."""
    if not (table["offset"].fill_null(0) != 0).any():
        return pl.Series([None] * table.height, dtype=pl.Int64)
    in_order = table.with_row_index("place").filter(pl.col("offset").is_not_null()).sort("instant")
    per_source = in_order.group_by("source").agg(
        far=(pl.col("offset").abs() > MIN_PER_H).any(),
        changes=(pl.col("offset").diff().fill_null(0) != 0).sum(),
        days=(pl.col("instant").max() - pl.col("instant").min()).dt.total_days(),
        others=(pl.col("offset") != 0).any(),
    )
    meant = per_source.filter(pl.col("others"), ~pl.col("far"), pl.col("changes") <= 2 + pl.col("days") / 60)["source"]
    zero = pl.when(pl.col("source").fill_null("").is_in(meant.fill_null("").implode())).then(0)
    return table.select(pl.when(pl.col("offset") == 0).then(zero).otherwise("offset")).to_series()


def _whole(value: object) -> int | None:
    """A number of JSON as a whole one, in the range of times; None for anything else."""
    number = number_in(value)
    return int(number) if number is not None and abs(number) < 1e14 else None


def _milliseconds(value: object) -> int | None:
    """Milliseconds since 1970 of a number of JSON; some programs write seconds."""
    number = _whole(value)
    return number * 1000 if number is not None and _SECONDS[0] <= number < _SECONDS[1] else number


def _usual_events(
    items: list[dict[str, Any]], instants: list[Any], times: pl.DataFrame, answers: Answers, notes: list[str]
) -> list[BasalEvent]:
    """Changes of the usual basal rate in the span of the treatments; each belongs to the row before it."""
    about_doses = (
        item.get("eventType") and not _is_deleted(item) and (item.get("eventType") != "Note") for item in items
    )
    far = far_from_others(times["time"])  # else the rates of decades would stand between them and the others
    rows = sorted(
        (at, row)
        for row, (at, use, alone) in enumerate(zip(instants, about_doses, far, strict=True))
        if at and use and not alone
    )
    if not answers.basal_profiles or not rows:
        return []
    zone = answers.time_zone or next(iter(zones_of(answers.basal_profiles)), None) or fixed_zone(times)
    if zone is None:
        notes.append("The profile names no time zone that is known; its rates are taken by the clock in UTC.")
    switches = [(at.replace(tzinfo=UTC), items[row]) for at, row in rows if items[row].get("eventType") == SWITCH]
    first, last = (at.replace(tzinfo=UTC) for at in (rows[0][0], rows[-1][0]))
    events: list[BasalEvent] = []
    for moment, rate in usual_rates(answers.basal_profiles, switches, first, last, zone):
        if math.isnan(rate) and not events:
            continue
        at = moment.replace(tzinfo=None)
        _, row = rows[bisect_right(rows, at, key=lambda pair: pair[0]) - 1]
        events.append(BasalEvent(row=row, time=at, what="usual", value=rate))
    return events


def _basal_events(items: list[dict[str, Any]], times: list[Any]) -> list[BasalEvent]:
    """Temporary basal rates of the treatments, a duration of 0 ends one, and suspensions of the pump."""
    events = []
    for row, (item, time) in enumerate(zip(items, times, strict=True)):
        event = str(item.get("eventType", ""))
        if time is None or _is_deleted(item):
            continue
        minutes = _minutes(item)
        if re.search(_TEMPORARY, event):
            ends = minutes is None and event.casefold().endswith("end")
            events += _temporary(item, row, time, 0.0 if ends else minutes)
        elif _SUSPEND.search(event) and not _RESUME.search(event):
            if minutes:
                events.append(BasalEvent(row=row, time=time, what="absolute", value=0.0, minutes=minutes))
            else:
                events.append(BasalEvent(row=row, time=time, what="suspend"))
        elif _RESUME.search(event):
            events.append(BasalEvent(row=row, time=time, what="resume"))
    return events


def _temporary(item: dict[str, Any], row: int, time: Any, minutes: float | None) -> list[BasalEvent]:
    """Temporary rate of a treatment; none if it tells no rate or no duration."""
    absolute, percent, rate = (number_in(item.get(name)) for name in ("absolute", "percent", "rate"))
    if minutes is None:
        return []
    if minutes <= 0.0:
        return [BasalEvent(row=row, time=time, what="end")]
    relative = str(item.get("isAbsolute")).casefold() == "false"
    if item.get("temp") == "percent" or (relative and absolute is None):
        change = None if percent is None else 100.0 + percent
        whole = change if rate is None or (relative and change is not None) else rate
        return [] if whole is None else [BasalEvent(row=row, time=time, what="percent", value=whole, minutes=minutes)]
    absolute = rate if absolute is None else absolute
    if absolute is not None:
        return [BasalEvent(row=row, time=time, what="absolute", value=absolute, minutes=minutes)]
    if percent is not None:
        return [BasalEvent(row=row, time=time, what="percent", value=100.0 + percent, minutes=minutes)]
    return []
