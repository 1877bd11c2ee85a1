"""Texts of a therapy by the clock: ``basal, +10%, 0h-6h``, a target like ``110@22h``, and profiles in files.

A text names a number of the therapy, an amount and hours. The amount is a value, in the unit in which people know the
number, or a part of what holds without it: ``+10%``, ``-20%`` or ``90%``. The hours are ``0h-6h``, ``22:00-06:00``,
``from 22h`` until midnight, a meal of the day, or, where they are left out, all day.

Of the changes that are tried beside a therapy one is of a number of it, or of the time of the boluses for meals
(``bolus, 15 min earlier``), or of the counted carbohydrate (``carbs, 20% too low``).
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from glucoloop.component.effects import (
    AHEAD,
    ANNOUNCEMENTS,
    CARB_RATIO,
    CORRECTION,
    MEALS,
    MEALS_ANNOUNCED,
    PROFILE,
    READINGS,
    Need,
)
from glucoloop.component.setting import Option, known_names
from glucoloop.refusal import Refusal
from glucoloop.situations.toml import read_toml, text_of_file
from glucoloop.therapy import TARGET, TherapyChange
from glucoloop.units import LONGEST_AHEAD_MIN, MG_DL_PER_MMOL_L, MIN_PER_DAY, MU_MIN_PER_U_H, NUMBER, UNITS_OF_TIME

if TYPE_CHECKING:
    from glucoloop.situations.run import FedSituation


class _Number(NamedTuple):
    """A number of a therapy that a text can name."""

    field: str
    scale: float
    """Factor from the unit of texts to that of the field."""
    least: float
    most: float
    unit: str


NUMBERS: Final = {
    "basal": _Number("basal_mU_min", MU_MIN_PER_U_H, 0.0, 30.0, "U/h"),
    "carb_ratio": _Number("carb_ratio_g_U", 1.0, 1.0, 200.0, "g/U"),
    "correction": _Number("correction_mg_dl_U", 1.0, 2.0, 1000.0, "mg/dl/U"),
    "target": _Number(TARGET, 1.0, 60.0, 300.0, "mg/dl"),
}
"""Numbers by the names that texts have for them."""
_ALSO: Final = {"correction_factor": "correction"}
"""Other names of numbers."""
MEAL_HOURS: Final = {"breakfast": (300.0, 660.0), "lunch": (660.0, 960.0), "dinner": (960.0, 1320.0)}
"""Hours of the day that stand for a meal: 5 to 11 h, 11 to 16 h and 16 to 22 h."""
_KEYS: Final = {f"{name}_{number.unit.replace('/', '_')}": name for name, number in NUMBERS.items()}
"""Keys of a profile in TOML, which have their units: ``basal_U_h``."""
_TEMPORARY: Final = "temporary"
"""Last piece of the text of a target that is temporary, as of an override."""
_LEAST_PCT, _MOST_PCT = 10.0, 1000.0
_CLOCK: Final = rf"(?:[0-9]{{1,2}}:[0-5][0-9]|{NUMBER}\s*(?:min|m|h))"
_HOURS: Final = re.compile(rf"({_CLOCK})\s*-\s*({_CLOCK})", re.ASCII)
_FROM: Final = re.compile(rf"from\s+({_CLOCK})", re.ASCII)
_AMOUNT: Final = re.compile(rf"({NUMBER})\s*(%|[A-Za-z][A-Za-z/]*)?", re.ASCII)


def parse_change(text: str) -> TherapyChange:
    """Change of a number of a therapy from its text, like ``basal, +10%, 0h-6h``; Refusal for another text."""
    name, amount, hours, temporary = _pieces(text)
    name = _ALSO.get(name, name)
    number = NUMBERS.get(name)
    if number is None:
        raise Refusal(f"{name!r} in {text!r} is no number of a therapy; {known_names(name, NUMBERS)}")
    from_min, to_min = _parse_hours(hours)
    if temporary and number.field != TARGET:
        raise Refusal(f"{text!r} is temporary, which a target can be alone; leave it out")
    match = _AMOUNT.fullmatch(amount)
    if match is None:
        raise Refusal(f"{amount!r} in {text!r} is no amount; write a value in {number.unit}, or a part like +10%")
    if match[2] == "%":
        return TherapyChange(number.field, from_min, to_min, factor=_parse_percent(amount) / 100.0)
    unit, scale = match[2] or number.unit, 1.0
    if unit in ("mmol/l", "mmol/L", "mmol/l/U", "mmol/L/U") and number.unit.startswith("mg/dl"):
        scale = MG_DL_PER_MMOL_L
    elif unit.lower() != number.unit.lower():
        raise Refusal(f"{unit!r} in {text!r} is no unit of {name}; give it in {number.unit}")
    value = float(match[1]) * scale
    if match[1][0] in "+-" or not number.least <= value <= number.most:
        raise Refusal(
            f"{amount!r} in {text!r} is no {name}; give one from {number.least:g} to {number.most:g} {number.unit}, "
            "or a part like +10%"
        )
    return TherapyChange(number.field, from_min, to_min, value=value * number.scale, temporary=temporary)


def _pieces(text: str) -> tuple[str, str, str, bool]:
    """Name, amount and hours of a text, and whether it ends with `_TEMPORARY`."""
    pieces = [piece.strip() for piece in text.split(",")]
    temporary = len(pieces) > 2 and pieces[-1] == _TEMPORARY
    pieces = pieces[:-1] if temporary else pieces
    if not 2 <= len(pieces) <= 3 or not all(pieces):
        raise Refusal(f"{text!r} is no change of a therapy; write it like 'basal, +10%, 0h-6h' or 'carb_ratio, 8'")
    name, amount, hours = (*pieces, "")[:3]
    return name, amount, hours, temporary


def _parse_percent(text: str) -> float:
    """Percent of what holds otherwise: 110 for ``+10%`` and ``110%``, 80 for ``-20%``."""
    match = re.fullmatch(rf"({NUMBER})\s*%", text.strip(), re.ASCII)
    percent = math.nan if match is None else float(match[1]) + (100.0 if match[1][0] in "+-" else 0.0)
    if not _LEAST_PCT <= percent <= _MOST_PCT:
        raise Refusal(
            f"{text!r} is no part of a number; give {_LEAST_PCT:g}% to {_MOST_PCT:g}% of it, or a difference like +10%"
        )
    return percent


def _parse_clock(text: str) -> float:
    """Minutes after midnight of ``22h``, ``22:30`` or ``90min``, up to 1440."""
    hours, colon, minutes = text.partition(":")
    if colon:
        result = float(hours) * UNITS_OF_TIME["h"] + float(minutes)
    else:
        match = re.fullmatch(rf"({NUMBER})\s*(min|m|h)", text.strip(), re.ASCII)
        result = math.nan if match is None else float(match[1]) * UNITS_OF_TIME[match[2]]
    if not 0.0 <= result <= MIN_PER_DAY:
        raise Refusal(f"{text!r} is no time of day; write it like 22h or 22:30, from 0h to 24h")
    return result


def _parse_hours(text: str) -> tuple[float, float]:
    """Time of day at which hours begin and end; all day for an empty text."""
    text = text.strip()
    if not text:
        return 0.0, MIN_PER_DAY
    if text in MEAL_HOURS:
        return MEAL_HOURS[text]
    between, since = _HOURS.fullmatch(text), _FROM.fullmatch(text)
    if between is not None:
        first, last = _parse_clock(between[1]), _parse_clock(between[2])
    elif since is not None:
        first, last = _parse_clock(since[1]), MIN_PER_DAY
    else:
        raise Refusal(
            f"{text!r} are no hours of the day; write them like 0h-6h, 22:00-06:00 or from 22h, "
            f"or {', '.join(MEAL_HOURS)}"
        )
    if first in (last, MIN_PER_DAY):
        raise Refusal(f"the hours {text!r} are empty; give two different times, and 0h-24h for all day")
    return first, last


def change_text(change: TherapyChange) -> str:
    """Text from which the same change is read."""
    name = next(name for name, number in NUMBERS.items() if number.field == change.field)
    amount = (
        f"{plain_number(change.factor * 100.0)}%"
        if change.value is None
        else plain_number(change.value / NUMBERS[name].scale)
    )
    hours = f"{plain_number(change.from_min)}min-{plain_number(change.to_min)}min"
    return ", ".join((name, amount, hours, *((_TEMPORARY,) if change.temporary else ())))


def plain_number(value: float) -> str:
    """A number in as few digits as tell it exactly."""
    return repr(float(value)).removesuffix(".0")


def target_change(text: str) -> TherapyChange:
    """Change of the target from a text like ``110@22h`` or ``150@17h-19h``."""
    value, at, hours = (piece.strip() for piece in text.partition("@"))
    if not at or not value or not hours:
        raise Refusal(f"{text!r} is no target by the clock; write it like 110@22h or 150@17h-19h")
    return parse_change(f"target, {value}, {hours if '-' in hours else f'from {hours}'}")


def target_texts(items: Iterable[str]) -> tuple[str, ...]:
    """Texts of targets by the clock, each of which is one."""
    texts = tuple(items)
    for text in texts:
        target_change(text)
    return texts


def profile_texts(items: Iterable[str]) -> tuple[str, ...]:
    """Texts of changes of a profile: those that are given, and those of each file that is named.

    A file that ends in ``.toml`` has keys like ``basal_U_h``, each a number or a table of times of day; one in
    ``.json`` is a profile as Nightscout exports it.
    """
    result: list[str] = []
    for item in items:
        suffix = Path(item.strip()).suffix
        if suffix in (".toml", ".json"):
            text = text_of_file(item.strip(), "a profile")
            read = _of_toml if suffix == ".toml" else _of_nightscout
            result += [change_text(change) for change in read(text, item.strip())]
        else:
            result.append(change_text(parse_change(item)))
    return tuple(result)


def _of_toml(text: str, path: str) -> list[TherapyChange]:
    """Changes of a profile in TOML."""
    keys = read_toml(text, path).keys
    unknown = next((key for key in keys if key not in _KEYS), None)
    if unknown is not None:
        raise Refusal(f"{path}: a profile has no {unknown!r}; {known_names(unknown, _KEYS)}")
    changes: list[TherapyChange] = []
    for key, value in keys.items():
        table = value if isinstance(value, dict) else {"00:00": value}
        if not table:
            raise Refusal(f"{path}: {key} is empty; give a number, or times of day with a number each")
        segments = [(_parse_clock(time), str(amount)) for time, amount in table.items()]
        changes += _segments(_KEYS[key], segments)
    return changes


def _of_nightscout(text: str, path: str) -> list[TherapyChange]:
    """Changes of a profile of Nightscout: of the newest document, the default schedule."""
    from glucoloop.records.file_text import json_of
    from glucoloop.records.nightscout_profile import segments_of

    segments = segments_of(json_of(text))
    if segments is None:
        raise Refusal(f"{path} is no profile of Nightscout; give one as its API exports it (api/v1/profile.json)")
    changes: list[TherapyChange] = []
    for name, values in segments.items():
        changes += _segments(name, [(minute, repr(value)) for minute, value in values])
    return changes


def _segments(name: str, segments: list[tuple[float, str]]) -> Iterable[TherapyChange]:
    """Changes of a number from each time of day until the next, the last one until the first of the next day."""
    ordered = sorted(segments)
    times = [time for time, _ in ordered]
    if len(set(times)) < len(times) or times[-1] >= MIN_PER_DAY:
        raise Refusal(
            f"the times of {name} are {', '.join(f'{time:g} min' for time in times)}; give each once, below 24h"
        )
    for (start, amount), end in zip(ordered, [*times[1:], times[0]], strict=True):
        whole = start == end
        change = parse_change(f"{name}, {amount}")
        yield change._replace(from_min=0.0 if whole else start, to_min=MIN_PER_DAY if whole else end)


S = TypeVar("S", bound="FedSituation")
_BOLUS: Final = "bolus"
_CARBS: Final = "carbs"
_USED_BY: Final = {"basal_mU_min": PROFILE, "carb_ratio_g_U": CARB_RATIO, "correction_mg_dl_U": CORRECTION}
"""Need of a controller that doses by each number of the profile."""
_MIN_COUNT_PCT, _MAX_COUNT_PCT = 10.0, 200.0
_SHIFT: Final = re.compile(rf"({NUMBER})\s*(min|m|h)\s+(earlier|later)", re.ASCII)
_COUNT: Final = re.compile(rf"({NUMBER})\s*%\s*too\s+(low|high)", re.ASCII)


class BolusShift(NamedTuple):
    """Boluses for meals at another time."""

    earlier_min: float
    """Time by which they come earlier; below 0 they come later."""


class CarbCount(NamedTuple):
    """Carbohydrate that is counted otherwise."""

    percent: float
    """Counted carbohydrate, in percent of what is counted without the change."""


Change = TherapyChange | BolusShift | CarbCount
"""Change of a number of the therapy, of the time of boluses, or of the counted carbohydrate."""


def read_change(text: str) -> Change:
    """Change from its text; Refusal for another text."""
    name, _, amount = (piece.strip() for piece in text.partition(","))
    if name == _BOLUS:
        return _bolus_shift(text, amount)
    if name == _CARBS:
        return _carb_count(text, amount)
    try:
        return parse_change(text)
    except Refusal as error:
        if name in NUMBERS or "," not in text:
            raise
        raise error.with_remedy(f"write a change of {_BOLUS} or {_CARBS}, like 'bolus, 15 min earlier'") from None


def _bolus_shift(text: str, amount: str) -> BolusShift:
    match = _SHIFT.fullmatch(amount)
    if match is None:
        _refuse_hours(text, amount, _SHIFT, "the boluses of all meals move alike")
        raise Refusal(
            f"{text!r} tells no time of boluses; write it like 'bolus, 15 min earlier' or 'bolus, 10 min later', "
            "and another size of boluses like 'carb_ratio, -10%'"
        )
    minutes = float(match[1]) * UNITS_OF_TIME[match[2]]
    if not 0.0 < minutes <= LONGEST_AHEAD_MIN:
        raise Refusal(
            f"{text!r} moves boluses by {minutes:g} min; give more than 0 and up to {LONGEST_AHEAD_MIN:g} min"
        )
    return BolusShift(minutes if match[3] == "earlier" else -minutes)


def _refuse_hours(text: str, amount: str, of: re.Pattern[str], alike: str) -> None:
    """Refuse a change that is one but for its hours."""
    without, _, hours = (piece.strip() for piece in amount.partition(","))
    if hours and of.fullmatch(without):
        name = text.partition(",")[0].strip()
        raise Refusal(
            f"{text!r} has the hours {hours!r}, and {alike}; leave them out, like '{name}, {without}', or change the "
            f"ratio of some hours, like 'carb_ratio, -10%, breakfast'"
        )


def _carb_count(text: str, amount: str) -> CarbCount:
    match = _COUNT.fullmatch(amount)
    if match is None:
        _refuse_hours(text, amount, _COUNT, "the carbohydrate of all meals is counted alike")
        raise Refusal(
            f"{text!r} tells no error of counted carbohydrate; write it like 'carbs, 20% too low' or 'carbs, 30% too "
            "high'"
        )
    percent = 100.0 + float(match[1]) * (1.0 if match[2] == "high" else -1.0)
    if match[1][0] in "+-" or percent == 100.0 or not _MIN_COUNT_PCT <= percent <= _MAX_COUNT_PCT:
        raise Refusal(
            f"{text!r} counts {percent:g} % of the carbohydrate; give up to {100.0 - _MIN_COUNT_PCT:g}% too low or "
            f"{_MAX_COUNT_PCT - 100.0:g}% too high"
        )
    return CarbCount(percent)


def _texts(items: Iterable[str]) -> tuple[str, ...]:
    """Texts of changes, each of which is one, as they are written."""
    texts = tuple(" ".join(text.split()) for text in items)
    for number, text in enumerate(texts):
        read_change(text)
        if text in texts[:number]:
            raise Refusal(f"the change {text!r} is given twice; leave one out")
    return texts


_WORDS: Final = (
    "like 'basal, +10%, 0h-6h', 'carb_ratio, 8, breakfast' (5 to 11 h; lunch to 16 h, dinner to 22 h), "
    "'correction_factor, -10%', 'target, 120, 22h-7h', 'bolus, 15 min earlier' or 'carbs, 20% too low'; repeat it for "
    "more."
)


def changes_option(what: str, panel: str) -> Any:
    """Setting of changes, whose help begins with a clause on what they do."""
    return Option(f"{what}, {_WORDS}", flag="--change", metavar="TEXT", panel=panel, reads=_texts)


def by_clock(change: Change) -> bool:
    """Whether a change concerns some hours of the day alone."""
    return isinstance(change, TherapyChange) and not change.all_day


def needs_of(change: Change, controller: Any) -> tuple[Need, ...]:
    """Needs without which a change has no effect under the settings of a controller."""
    if isinstance(change, BolusShift):
        return (MEALS, ANNOUNCEMENTS, *((AHEAD,) if change.earlier_min > 0.0 else ()), MEALS_ANNOUNCED)
    if isinstance(change, CarbCount):
        return (MEALS, ANNOUNCEMENTS, MEALS_ANNOUNCED)
    if change.field == TARGET:
        return (READINGS,)
    own = controller.settings().get(change.field)
    return (_USED_BY[change.field], *(() if own is None else own.about.needs))


def with_changes(situation: S, changes: Iterable[Change]) -> S:
    """A situation under changes, each of which acts on what the ones before leave."""
    for change in changes:
        if isinstance(change, BolusShift):
            situation = _with_shift(situation, change.earlier_min)
        elif isinstance(change, CarbCount):
            bias_pct = (100.0 + situation.carb_bias_pct) * change.percent / 100.0 - 100.0
            situation = dataclasses.replace(situation, carb_bias_pct=bias_pct)
        else:
            schedule = tuple(map(change_text, (*situation.schedule.changes, change)))
            situation = dataclasses.replace(situation, therapy=schedule, targets=(), overrides=())
    return situation


def _with_shift(situation: S, earlier_min: float) -> S:
    """A situation whose meals are announced earlier, or later than eating begins."""
    from glucoloop.meals.habits import AnnouncedLate

    before_min = situation.announce_before_min + earlier_min
    if before_min > LONGEST_AHEAD_MIN:
        raise Refusal(
            f"meals would be announced {before_min:g} min before eating, {situation.announce_before_min:g} min of them "
            f"without the change; give at most {LONGEST_AHEAD_MIN:g} min in all"
        )
    late = () if before_min >= 0.0 else (AnnouncedLate(minutes=-before_min),)
    return dataclasses.replace(situation, announce_before_min=max(before_min, 0.0), habits=(*situation.habits, *late))
