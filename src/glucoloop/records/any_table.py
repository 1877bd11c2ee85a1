"""Any table whose columns are named, or have the names of a record themselves."""

from __future__ import annotations

import datetime as dt
import difflib
import re
from collections.abc import Mapping
from typing import Final

import polars as pl

from glucoloop.records.answers import TARGETS, Answers
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import DELIMITERS, FileText, fields_of
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.record import AUTOMATIC, MANUAL
from glucoloop.records.times import from_utc, times_of
from glucoloop.refusal import Refusal
from glucoloop.text import how_many, the_first
from glucoloop.units import MIN_PER_DAY, S_PER_MIN

_UNITS: Final = {"glucose_mg_dl": "mg/dl", "glucose_mmol_l": "mmol/l"}
_VALUES: Final = {
    "glucose": "glucose_mg_dl",
    "carbs": "carbs_g",
    "bolus": "bolus_U",
    "bolus_min": "bolus_min",
    "bolus_type": "bolus_type",
    "long_acting": "long_acting_U",
    "basal": "basal_U_h",
    "glucagon": "glucagon_ug",
}
_MILLISECONDS: Final = 13
"""Number of digits of the milliseconds since 1970 of any time from 2001 to 2286; that of seconds is 10."""
_EPOCH: Final = rf"^(\d{{10}}(\.\d+)?|\d{{{_MILLISECONDS}}}(\d{{3}}){{0,2}})$"
_SERIAL: Final = r"^[2-7]\d{4}([.,]\d+)?$"
"""Days since the end of 1899, as a spreadsheet counts them; those of 1954 to 2119."""
_DAYS: Final = r"^-?\d{1,5}$"
"""Days since the beginning of a study, by which it hides the dates."""
_DAY_0: Final = dt.date(2000, 1, 1)
_SERIAL_0: Final = dt.datetime(1899, 12, 30)
_FRACTION: Final = r"^0?([.,]\d+)?$"
"""Part of a day, as a spreadsheet has a clock."""
_MILLIUNITS: Final = re.compile(r"(?<![A-Za-z])m(I?U|IE|UI)(?![a-z])(\s*/\s*\w+)?")
_EXCHANGES: Final = re.compile(r"\b(1[0-9] ?g|BE|KE|KHE|[Ee]xchanges?|[Pp]ortions?|[Ss]ervings?|Broteinheit(en)?)\b")
_MILLIGRAMS: Final = re.compile(r"(?i)(?<![a-z])mg(?![a-z])")
_WITHOUT_TIME: Final = re.compile(r"(?i)(?<=[ (\[_])(i?u|ie?|ui|e|units?)(?=[)\]]*$)")
_PER_MINUTE: Final = re.compile(r"(?i)(?<![a-z])(i?u|ie|ui)\s*(/|per)\s*(\d+\s*)?min")
_PER_DAY: Final = re.compile(
    r"(?i)(?<![a-z])(i?u|ie?|ui|e|units?)\s*(/|per|pro|par)\s*(d|day|tag|jour|día|giorno|dag|24\s*h)(?![a-z])"
    r"|\b(daily|tdd|total|tagesdosis|per day|pro tag|par jour|24\s*h)\b"
)
_WORDS: Final = {
    "glucose": r"glu[ck]o|glyc|glic|zucker|(?<![a-z])(bg|bz|sgv|egv|cgm)(?![a-z])",
    "carbs_g": r"carb|kohlenh|koolh|glucid|hidrat|kolhyd|(?<![a-z])(kh|ke|cho)(?![a-z])|\(be\)",
    "bolus_U": r"bolus|bolo",
    "basal_U_h": r"basal",
    "glucagon_ug": r"glu[ck]agon",
}
"""Words in the names of columns that hold a quantity of a record."""
_OF_VALUES: Final = re.compile(rf"(?i)insulin|{'|'.join(_WORDS.values())}")
_OF_TIMES: Final = re.compile(
    r"(?i)^(date.?time|time.?stamp|local.?time|time|ts|zeit(punkt|stempel)?|uhrzeit|heure|hora|ora|tijd|tid|godzina|čas"
    r"|date (and|&) time|datum (und|/) (uhr)?zeit|date et heure|fecha y hora|data e ora)\b(?!.*zone)"
)
_OF_DATES: Final = re.compile(r"(?i)^(date|datum|jour|fecha|giorno|dato|data)$")
_PLAIN: Final = re.compile(
    "time|timestamp|date|datetime|local|event|ts|zeit|uhrzeit|zeitpunkt|zeitstempel|datum|heure|hora|ora|tijd|tid|godzina"
    "|fecha|data|jour|giorno|dato|and|und|et|y|e|of|by|per|glu[ck]os[eao]|glucosio|gly[ck]ose|gl[iy]c[aeé]+mi[ae]|glucemia"
    "|blood|sugar|zucker|blutzucker|glu[ck]osewert|bg|bz|sgv?|egv|cgm|sensor|meter|historic|readings?|values?|level|wert"
    "|carbs?|carbohydrates?|kohlenhydrate?|koolhydraten|glucides|hidratos|carboidrati|kolhydrater|kh|ke|be|cho"
    "|insulin[ea]?|bolus|basale?|basaal|basalrate|rates?|doses?|amount|size|input|delivered|total|daily|meal|food|correction"
    "|extended|normal|temporary|long|acting|rapid|glu[ck]agon|mg|dl|mmol|l|g|grams?|m?u|iu|ie|ui|units?|h|hr|hour|min|d|day|ug"
)
"""Words of which the name of a column may consist that is told: with any other it may name a person."""
_CLOCK: Final = r"(?i)^\s*\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?\s*([ap]\.?m\.?)?\s*$"


class AnyTable(ReaderComponent, name="table"):
    """Any table whose columns are named, or have the names of a record."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the names of a record."""
        begins = content.beginning_as_table
        return any(begins.header("time", name, whole=True) for name in (*_VALUES.values(), "glucose_mmol_l"))

    def has_columns(self, content: FileText, columns: Mapping[str, str]) -> bool:
        """Whether a file has the time and one more of the columns that are named."""
        return bool(self._present(content.beginning_as_table, columns))

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a table by the names of its columns."""
        content = content.as_table
        names = dict(answers.columns) or _own_names(content)
        present = self._present(content, names)
        missing = tuple(text for name, text in names.items() if name not in present)
        several = any("|" in text for text in names.values())
        place = content.header(*present.values(), whole=True) if present else None
        if place is None or (missing and not several):
            raise Refusal(
                f"no line of its beginning has all of the columns {', '.join(names.values())}; "
                f"{_likely(content, names)}"
            )
        _refuse_other_units(present, answers)
        table = content.table(place)
        by_text = {name.casefold(): name for name in reversed(table.frame.columns)}
        columns = {target: by_text[name.casefold()] for target, name in present.items()}
        frame = table.frame.select(**{target: table.texts(name) for target, name in columns.items()})
        times, notes = table_times(frame, answers)
        who = person_column(table.frame, set(columns.values()), times["time"], answers)
        kept = {name: target for name, target in _VALUES.items() if target in present}
        if "glucose_mmol_l" in present:
            kept["glucose"] = "glucose_mmol_l"
        values = {name: pl.col(target) for name, target in kept.items()}
        if "bolus_min" in values:
            values["bolus_min"] = values["bolus_min"].str.replace(",", ".").cast(pl.Float64, strict=False)
        if "bolus_type" in values:
            values["bolus_type"] = values["bolus_type"].str.strip_chars().str.to_lowercase()
            values["bolus_type"] = pl.when(values["bolus_type"].is_in([AUTOMATIC, MANUAL])).then(values["bolus_type"])
        person = table.frame.select(table.texts(who)).to_series() if who else None
        if who:
            notes.append("The table has a column that says whose each row is.")
        notes += _on_unused(table.frame, set(columns.values()))
        return Extract(
            frame=extract_frame(frame, times, table.spoilt, **values, person=pl.lit(person)),
            glucose_unit=_UNITS.get(kept.get("glucose", "")),
            notes=(*table.notes, *notes),
            missing=missing,
        )

    @staticmethod
    def _present(content: FileText, columns: Mapping[str, str]) -> dict[str, str]:
        """The columns that are named and stand in one header; none if that has no time or nothing else."""
        choices = {target: [one.strip() for one in text.split("|")] for target, text in columns.items()}
        for time in choices.get("time", []):
            place = content.header(time, whole=True)
            if place is None:
                continue
            result = {"time": time}
            for target, texts in choices.items():
                there = [one for one in texts if content.header(time, one, whole=True)]
                if there and target != "time":
                    result[target] = there[0]
            if len(result.keys() - {"date"}) > 1:
                return result
        return {}


def proposed_columns(content: FileText) -> str:
    """Columns of a table of another kind by the words in their names, as the answer ``columns``; empty if none say so.

    Nothing else of the file is told, which may name a person.
    """
    for (number, delimiter), _ in content.beginning_as_table.fields:
        names = [
            " ".join(text.strip().strip('"').split())
            for text in fields_of(content.beginning_as_table.head[number], delimiter)
        ]
        names = [name for name in names if _is_plain(name) and not set(name) & set(",=|'")]
        times = [name for name in names if _OF_TIMES.search(name)]
        dates = [name for name in names if _OF_DATES.search(name)]
        values = {
            target: [name for name in names if re.search(f"(?i){words}", name)] for target, words in _WORDS.items()
        }
        if not times + dates or not any(values.values()):
            continue
        result = {"time": (times or dates)[0]}
        if times and dates:
            result["date"] = dates[0]
        for target, of_target in values.items():
            for name in of_target[:1]:
                unit = "mmol_l" if "mmol" in name.lower() else "mg_dl"
                result[f"{target}_{unit}" if target == "glucose" else target] = name
        return ",".join(f"{target}={name}" for target, name in result.items())
    return ""


def _on_unused(frame: pl.DataFrame, used: set[str]) -> list[str]:
    """Sentence on columns with values that are not used, and whose names say insulin, carbohydrate or glucose."""
    names = [name for name in frame.columns if name not in used and _OF_VALUES.search(name)]
    filled = [name for name in names if frame[name].str.strip_chars().replace("", None).drop_nulls().len()]
    if not filled:
        return []
    told = [repr(name) for name in filled if _is_plain(name)]
    others = len(filled) - len(told)
    told += [how_many(others, "with other words in its name", "with other words in their names")] if others else []
    return [f"Not used, for they are not named: the columns {the_first(told)}."]


def _is_plain(name: str) -> bool:
    """Whether the name of a column has words and only such as name what it holds, its unit or its time."""
    words = re.findall(r"[^\W\d_]+", name.casefold())
    return bool(words) and all(map(_PLAIN.fullmatch, words))


def _refuse_other_units(columns: Mapping[str, str], answers: Answers) -> None:
    """Refuse a column of amounts whose own name has another unit than the record, and no answer says which."""
    exchanges = _EXCHANGES.search(columns.get("carbs_g", ""))
    if exchanges is not None and "carbs" not in answers.file_units:
        raise Refusal(
            f"the column {columns['carbs_g']!r} is taken as g, and its name has {exchanges[0]!r}",
            "say its unit, as file_units='carbs=10g' (--file-units), which is 1g where it has grams",
        )
    units = {
        "bolus_U": ("bolus", "U"),
        "long_acting_U": ("long_acting", "U"),
        "basal_U_h": ("basal", "U/h"),
        "glucagon_ug": ("glucagon", "ug"),
    }
    for target, (name, unit) in units.items():
        text = columns.get(target, "")
        other = (_MILLIGRAMS if target == "glucagon_ug" else _MILLIUNITS).search(text)
        other = other or (_PER_MINUTE.search(text) if target == "basal_U_h" else None)
        of_day = _PER_DAY.search(text) if target == "basal_U_h" and other is None else None
        of_sample = _WITHOUT_TIME.search(text) if target == "basal_U_h" and other is None and of_day is None else None
        if of_sample is not None and name not in answers.file_units:
            raise Refusal(
                f"the column {text!r} is taken as {unit}, and its name has {of_sample[0]!r} without a time",
                f"say its unit, as file_units='{name}=U/5min' (--file-units) for the insulin of five minutes, or "
                f"{name}=U/h",
            )
        if of_day is not None and name not in answers.file_units:
            raise Refusal(
                f"the column {text!r} is taken as {unit}, and its name has {of_day[0]!r}",
                f"say its unit, as file_units='{name}=U/day' (--file-units) for the insulin of a day, or {name}=U/h",
            )
        if other is not None and name not in answers.file_units:
            own = other[0].replace(" ", "")
            raise Refusal(
                f"the column {text!r} is taken as {unit}, and its name has {own!r}",
                f"say its unit, as file_units='{name}={own}' (--file-units)",
            )


def table_times(frame: pl.DataFrame, answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Times of a table: seconds or milliseconds since 1970, texts, or a clock beside the date."""
    epoch = frame["time"].drop_nulls()
    if len(epoch) and epoch.str.contains(_EPOCH).all():
        digits = pl.col("time").str.slice(0, _MILLISECONDS).str.replace(r"\..*$", "").str.pad_end(_MILLISECONDS, "0")
        return from_utc(frame.select(digits.cast(pl.Int64).cast(pl.Datetime("ms"))).to_series()), []
    if "date" in frame.columns and frame["date"].drop_nulls().str.contains(_DAYS).all():
        days = pl.col("date").cast(pl.Int64, strict=False)
        dates = (pl.lit(_DAY_0) + pl.duration(days=days)).dt.to_string("%Y-%m-%d")
        times, notes = times_of(frame.select(pl.concat_str(dates, "time", separator=" ")).to_series(), answers)
        return times, [*notes, f"Its dates are numbers of days; day 0 was taken for {_DAY_0:%Y-%m-%d}."]
    if "date" in frame.columns:
        day = pl.col("date").str.replace(r"[T ]+0?0:00(:00)?(\.0+)?$", "")
        since = pl.col("time").str.replace(r"^(\d{4}-\d{2}-\d{2}[T ]|0 days? )", "")
        if len(epoch) and epoch.str.contains(_FRACTION).all():
            seconds = (pl.col("time").str.replace(",", ".").cast(pl.Float64) * MIN_PER_DAY * S_PER_MIN).round()
            since = (pl.lit(_SERIAL_0) + pl.duration(seconds=seconds.cast(pl.Int64))).dt.to_string("%H:%M:%S")
        return _readable(frame.select(pl.concat_str(day, since, separator=" ")).to_series(), answers)
    if len(epoch) and epoch.str.contains(_SERIAL).all():
        serial = pl.col("time").str.replace(",", ".", literal=True).cast(pl.Float64)
        seconds = (serial * MIN_PER_DAY * S_PER_MIN).round().cast(pl.Int64)
        texts = (pl.lit(_SERIAL_0) + pl.duration(seconds=seconds)).dt.to_string("%Y-%m-%d %H:%M:%S")
        times, notes = times_of(frame.select(texts).to_series(), answers)
        return times, [*notes, "Its times are numbers of days, as of a spreadsheet."]
    if len(epoch) and epoch.str.contains(_CLOCK).all():
        raise Refusal(
            "its times have no date", "name the column of dates too, as columns='date=Datum,time=Zeit,...' (--columns)"
        )
    return _readable(frame["time"], answers)


def _readable(texts: pl.Series, answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Times of texts; Refusal with the form of the first one where none can be read."""
    times, notes = times_of(texts, answers)
    there = texts.drop_nulls()
    if len(there) and times["time"].null_count() == times.height:
        form = re.sub(r"[^\W\d_]", "a", re.sub(r"\d", "9", there[0][:40]))
        raise Refusal(f"none of its times can be read; they look like {form!r}", "write them as 2024-03-13 08:05:00")
    return times, notes


def _own_names(content: FileText) -> dict[str, str]:
    """Columns of a table that has the names of a record."""
    place = next(
        (result for name in (*_UNITS, *_VALUES.values()) if (result := content.header("time", name, whole=True))), None
    )
    if place is None:
        raise Refusal(
            "its columns have no names of a record", "name them, as columns='time=Zeit,glucose_mg_dl=BZ' (--columns)"
        )
    number, delimiter = place
    fields = [text.strip().strip('"').casefold() for text in fields_of(content.head[number], delimiter)]
    return {target: target for target in TARGETS if target.casefold() in fields}


def _likely(content: FileText, names: dict[str, str]) -> str:
    """Names of the file that are like those that were given; nothing else of the file, which may name a person."""
    fields = {
        text.strip().strip('"')
        for line in content.head[:5]
        for delimiter in DELIMITERS
        for text in fields_of(line, delimiter)
    }
    near = [match for name in names.values() for match in difflib.get_close_matches(name, fields - {name}, n=1)]
    return f"did you mean {' and '.join(map(repr, near))}?" if near else "give the names as they stand in the file"


_NAME: Final = re.compile(
    r"(?i)^((pt|pat|patient|subj|subject|usubj|participant|person|people|proband|deident|anon\w*"
    r"|patienten?|paciente?|paziente|patiënt|pacjent|sujeto|sujet|soggetto|participante?|probandin|versuchsperson)"
    r"([ _.-]*(id|no|nr|number|code|key|nummer))?"
    r"|id[ _.-]*(pt|pat|patient|subj|subject|participant|person|proband)"
    r"|((user|case|study|record)[ _.-]*)?id|pid|uid|kennung)s?$"
)
_MOST_ALIKE: Final = 0.05
"""Largest share of times that a table of one person has more than once with other readings."""
_FEW: Final = 10


def person_column(frame: pl.DataFrame, used: set[str], times: pl.Series, answers: Answers) -> str | None:
    """Name of the column that says whose each row is; None for a table of one person.

    It is the one that is named, or one whose name says so and that has several values, each for many rows. Refusal
    where times stand there more than once as in a table of people, and no name of a column says so.
    """
    if answers.person_column is not None:
        by_text = {name.casefold(): name for name in reversed(frame.columns)}
        name = by_text.get(answers.person_column.strip().casefold())
        if name is None:
            raise Refusal(
                f"it has no column {answers.person_column!r}", "give person_column (--person-column) as it stands"
            )
        return name
    free = [name for name in frame.columns if name not in used]
    named = [name for name in free if _NAME.match(name.strip())]
    likely = [name for name in named if _of_people(frame[name])]
    if likely:
        return max(likely, key=lambda name: (_repeats(times, frame[name]) == 0, -frame[name].n_unique()))
    if _repeats(times, None) <= max(_FEW, _MOST_ALIKE * frame.height):
        return None
    telling = [
        name
        for name in free
        if _of_people(frame[name]) and _repeats(times, frame[name]) <= max(_FEW, _MOST_ALIKE * frame.height)
    ]
    if telling:
        raise Refusal(
            "it has the same times more than once, as a table of several people has",
            f"name the column that says whose each row is with person_column (--person-column), as {telling[0]!r}",
            "write each person's record with `glucoloop records --person-column`",
        )
    return None


def _of_people(column: pl.Series) -> bool:
    """Whether a column has several values, each for several rows."""
    cells = column.drop_nulls()
    kinds = cells.n_unique()
    return 1 < kinds and 2 * kinds <= len(cells)


def _repeats(times: pl.Series, column: pl.Series | None) -> int:
    """Number of rows whose time, for the same value of a column, stands in an earlier row too."""
    table = times.to_frame("time") if column is None else pl.DataFrame({"time": times, "who": column})
    table = table.filter(pl.col("time").is_not_null())
    return table.height - table.n_unique()
