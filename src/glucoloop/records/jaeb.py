"""Tables of trials that the Jaeb Center for Health Research publishes: readings, boluses and basal rates of all people.

Fields are divided by bars, ``PtID`` says whose a row is. Times are on the wall (``DeviceDtTm`` and ``DataDtTm``, of
which ``DataDtTm_adjusted`` corrects some; without a clock at midnight), in UTC (``UTCDtTm``), or days since enrolment
beside a clock. Glucose is in mg/dl unless ``Units`` says otherwise; 39 and 401 stand for low and high, and so does
``HighLowIndicator`` beside a 0; a ``RecordType`` other than CGM is a finger prick or a calibration. Boluses of Tidepool
have a normal and an extended part with a duration in ms, or in minutes where it came by Diasend; those of PEDAP a
``Later`` part that stands at its end. A suspended pump has no rate.

References
----------
Public datasets of the Jaeb Center for Health Research, https://public.jaeb.org/datasets/diabetes: REPLACE-BG, Loop,
DCLP3, DCLP5, PEDAP and others; columns as the project babelbetes describes them.
"""

from __future__ import annotations

from typing import ClassVar, Final

import polars as pl

from glucoloop.records.answers import MONTH_FIRST, Answers
from glucoloop.records.any_table import table_times
from glucoloop.records.extract import Extract, extract_frame, notes_on_spread, with_doses
from glucoloop.records.file_text import FileText
from glucoloop.records.reader import TableReaderComponent
from glucoloop.records.times import from_utc, times_of
from glucoloop.units import MG_DL_PER_MMOL_L

_DAYS: Final = "DeviceDtTmDaysFromEnroll"
_TIMES: Final = (_DAYS, "UTCDtTm", "DataDtTm", "DeviceDtTm")
_VALUES: Final = {
    "glucose": ("GlucoseValue", "CGMValue", "CGMVal"),
    "bolus": ("BolusAmount", "Normal"),
    "basal": ("CommandedBasalRate", "BasalRate", "Rate"),
    "carbs": ("CarbAmount", "CarbInput"),
}
_OTHERS: Final = {
    "utc": "UTCDtTm",
    "days": _DAYS,
    "clock": "DeviceTm",
    "adjusted": "DataDtTm_adjusted",
    "record": "RecordType",
    "units": "Units",
    "beyond": "HighLowIndicator",
    "extended": "Extended",
    "duration": "Duration",
    "portion": "ExtendedBolusPortion",
    "basal_type": "BasalType",
    "bolus_type": "BolusType",
    "person": "PtID",
}
_LEAST_MS: Final = 1000.0
"""Least duration that is in milliseconds; shorter ones are in minutes."""


class Jaeb(TableReaderComponent, name="jaeb"):
    """Tables of trials that the Jaeb Center for Health Research publishes."""

    in_parts: ClassVar = True
    in_exports: ClassVar = True
    headers: ClassVar = tuple(
        ("PtID", time, value) for time in _TIMES for values in _VALUES.values() for value in values
    )

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of one of the tables of a trial."""
        _, table = self.table(content)
        own = {name.casefold(): name for name in reversed(table.frame.columns)}
        columns = {
            name: next((own[text.casefold()] for text in texts if text.casefold() in own), None)
            for name, texts in _VALUES.items()
        }
        columns |= {name: own.get(text.casefold()) for name, text in _OTHERS.items()}
        columns["time"] = next(
            (own[text.casefold()] for text in ("DataDtTm", "DeviceDtTm") if text.casefold() in own), None
        )
        frame = table.frame.select(**{name: table.texts(column) for name, column in columns.items()})
        frame = frame.with_columns(time=pl.coalesce("adjusted", "time"))
        times, notes = _times(frame, answers)
        number = pl.col("glucose").cast(pl.Float64, strict=False)
        mmol = pl.col("units").str.to_lowercase().str.contains("mmol").fill_null(False)
        sensor = pl.col("record").is_null() | pl.col("record").str.to_lowercase().str.contains("cgm")
        beyond = (
            pl.when(pl.col("beyond") == "1").then(pl.lit("high")).when(pl.col("beyond") == "2").then(pl.lit("low"))
            .when(number == 39.0).then(pl.lit("low")).when(number == 401.0).then(pl.lit("high"))
        )  # fmt: skip
        minutes = pl.col("duration").cast(pl.Float64, strict=False)
        if columns["extended"] is not None:
            minutes = pl.when(minutes >= _LEAST_MS).then(minutes / 60_000.0).otherwise(minutes)
        frame = frame.with_columns(
            _minutes=minutes,
            _later=(pl.col("portion").str.to_lowercase() == "later").fill_null(False) & (minutes > 0),
            _beyond=pl.when(sensor & number.is_not_null()).then(beyond),
        )
        shift = pl.when(frame["_later"]).then(frame["_minutes"] * 60e6).otherwise(0.0)
        times = times.with_columns(time=pl.col("time") - pl.duration(microseconds=shift, time_unit="us"))
        whole = frame.filter(
            pl.col("bolus_type").str.to_lowercase().str.contains("extended"), pl.col("_minutes").is_null()
        )
        if whole.height and columns["extended"] is None:
            notes.append(
                f"{whole.height} extended boluses stand whole at the time of the file, which tells no duration."
            )
        suspended = pl.col("basal_type").str.to_lowercase().str.contains("suspend").fill_null(False)
        basal = pl.when(pl.col("basal").is_not_null()).then("basal").when(suspended).then(pl.lit("0"))
        if columns["basal"] is not None:
            basal = basal.when(pl.col("basal_type").is_not_null()).then(pl.lit("?"))
        result = extract_frame(
            frame,
            times,
            table.spoilt,
            glucose=pl.when(sensor & pl.col("_beyond").is_null() & (number.is_null() | (number > 0.0)))
            .then(pl.when(mmol).then((number * MG_DL_PER_MMOL_L).cast(pl.String)).otherwise("glucose")),
            out_of_range=pl.col("_beyond"),
            carbs=pl.col("carbs"),
            bolus=pl.col("bolus"),
            bolus_min=pl.when("_later").then("_minutes"),
            basal=basal,
            kind=pl.when(pl.col("glucose").is_not_null() & ~sensor)
            .then(pl.lit("finger pricks and calibrations"))
            .otherwise(pl.lit("rows without a reading, a meal or insulin")),
            person=pl.col("person"),
        )  # fmt: skip
        spread = frame.with_row_index("_row").select(
            pl.col("_row").cast(pl.Int64), pl.col("extended").cast(pl.Float64, strict=False), "_minutes"
        )
        doses = list(spread.filter(pl.col("extended") > 0, pl.col("_minutes") > 0).iter_rows())
        notes += notes_on_spread(len(doses))
        return Extract(frame=with_doses(result, doses), glucose_unit="mg/dl", notes=(*table.notes, *notes))


def _times(frame: pl.DataFrame, answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Times of a table, by the best of the columns that it has."""
    if frame["days"].is_not_null().any():
        return table_times(frame.select(date="days", time="clock"), answers)
    on_wall = frame["time"].is_not_null().any()
    texts = frame["time"] if on_wall else frame["utc"]
    at_midnight = pl.when(texts.str.contains(":")).then(texts).otherwise(texts + " 00:00:00")
    times, notes = times_of(pl.select(at_midnight).to_series(), answers, usual=MONTH_FIRST)
    return (times, notes) if on_wall else (from_utc(times["time"]), notes)
