"""Changes of a therapy that are tried beside it, from texts: ``basal, +10%, 0h-6h`` and ``bolus, 15 min earlier``.

A change is one of a number of the therapy, as in `situations.therapy_text`, of the time of the boluses for meals, or of
the counted carbohydrate.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
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
from glucoloop.component.number_text import NUMBER, UNITS_OF_TIME
from glucoloop.limits import LONGEST_AHEAD_MIN
from glucoloop.refusal import Refusal
from glucoloop.situations.option import Option
from glucoloop.situations.therapy_text import NUMBERS, change_text, parse_change, plain_number
from glucoloop.therapy import TARGET, TherapyChange

if TYPE_CHECKING:
    from glucoloop.situations.run import FedSituation

S = TypeVar("S", bound="FedSituation")
_BOLUS: Final = "bolus"
_CARBS: Final = "carbs"
_USED_BY: Final = {"basal_mU_min": PROFILE, "carb_ratio_g_U": CARB_RATIO, "correction_mg_dl_U": CORRECTION}
"""Need of a controller that doses by each number of the profile."""
_LEAST_PCT, _MOST_PCT = 10.0, 200.0
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
    if match[1][0] in "+-" or percent == 100.0 or not _LEAST_PCT <= percent <= _MOST_PCT:
        raise Refusal(
            f"{text!r} counts {percent:g} % of the carbohydrate; give up to {100.0 - _LEAST_PCT:g}% too low or "
            f"{_MOST_PCT - 100.0:g}% too high"
        )
    return CarbCount(percent)


def text_of_change(change: Change) -> str:
    """Text from which the same change is read."""
    if isinstance(change, BolusShift):
        when = "earlier" if change.earlier_min > 0.0 else "later"
        return f"{_BOLUS}, {plain_number(abs(change.earlier_min))} min {when}"
    if isinstance(change, CarbCount):
        error = change.percent - 100.0
        return f"{_CARBS}, {plain_number(abs(error))}% too {'high' if error > 0.0 else 'low'}"
    return change_text(change)


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
