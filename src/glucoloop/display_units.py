"""Units in which results are shown to people: in words, tables, figures and pages.

Data stays in mg/dl and mU/min everywhere, in files for machines too, whose columns end in their units.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.units import OTHER_UNITS

OTHERS: Final = {"mg/dl": "mmol/l", "mU/min": "U/h"}
"""The other unit in which a quantity may be shown, by that in which it is computed."""
_CHOSEN: ContextVar[frozenset[str]] = ContextVar("units of what is shown", default=frozenset())
_NUMBER: Final = r"\d+(?:\.\d+)?"
_AMOUNT: Final = re.compile(
    rf"(?<![\w.])(?<!e[-+])(?P<numbers>{_NUMBER}(?:(?: to | ?– ?| and | or | → ){_NUMBER})?) (?P<unit>mg/dl|mU/min)"
    r"(?!²| per m[gU])(?: \((?P<same>[^()]* U/h)\))?"
)
"""One or two numbers with their unit; where the same stands behind it in U/h, with that."""
_UNIT: Final = re.compile(r"(?<!per )(mg/dl|mU/min)(?!\)?²| per m[gU])")


@contextlib.contextmanager
def showing(units: str) -> Iterator[None]:
    """Show what is drawn and printed within a block in other units: ``with gl.showing("mmol/l, U/h"): ...``.

    Parameters
    ----------
    units : str
        Units, parted by commas: mg/dl or mmol/l for glucose, mU/min or U/h for rates of insulin.

    Raises
    ------
    ValueError
        For an unknown unit, or two of one quantity.
    """
    names = [name.strip() for name in units.split(",")]
    known = {name: house for house, other in OTHERS.items() for name in (house, other)}
    for name in names:
        if name not in known:
            raise Refusal(
                f"results cannot be shown in {name!r}; give one or two of {', '.join(known)}, like mmol/l,U/h"
            )
    if len({known[name] for name in names}) < len(names):
        raise Refusal(f"{units!r} names two units of one quantity; give one for glucose and one for insulin")
    token = _CHOSEN.set(frozenset(names))
    try:
        yield
    finally:
        _CHOSEN.reset(token)


@contextlib.contextmanager
def rates_as_pumps_show(subcutaneous: bool) -> Iterator[None]:
    """Show rates of insulin in U/h within a block where it is subcutaneous, unless a unit was chosen for them."""
    chosen = _CHOSEN.get()
    of_pumps = subcutaneous and not chosen & {"mU/min", "U/h"}
    token = _CHOSEN.set(chosen | {"U/h"} if of_pumps else chosen)
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def shown_unit(unit: str) -> str:
    """Unit in which a quantity is shown, by that in which it is computed."""
    other = OTHERS.get(unit, unit)
    return other if other in _CHOSEN.get() else unit


def units_shown() -> str:
    """The units that are shown, as `showing` takes them."""
    return ",".join(map(shown_unit, OTHERS))


def other_value(value: float, unit: str) -> float:
    """A value in the other unit of its quantity."""
    return value / OTHER_UNITS[unit][OTHERS[unit]]


def other_number(text: str, value: float | None, unit: str) -> str:
    """Text of a value in the other unit, with a digit more than its text has; a text that is no number stays.

    Without the value, that of its text is taken.
    """
    result = re.fullmatch(r"([-+]?\d+(?:\.(\d+))?)(\+?)", text)
    if result is None:
        return text
    other = other_value(float(result[1]) if value is None else value, unit)
    sign = "+" if result[1].startswith("+") else ""
    return f"{other:{sign}z.{len(result[2] or '') + 1}f}{result[3]}"


def in_both_units(text: str) -> Iterator[tuple[str, str, str]]:
    """Parts of a text: the unit of an amount, its text, and its text in the other unit; elsewhere the unit is empty."""
    place = 0
    for match in _AMOUNT.finditer(text):
        unit = match["unit"]

        def other(number: re.Match[str], unit: str = unit) -> str:
            value, digits = other_value(float(number[0]), unit), len(number[0].partition(".")[2]) + 1
            return f"{value:.{min(2, digits)}f}" if unit == "mg/dl" and value >= 1.0 else f"{value:.3g}"

        yield "", text[place : match.start()], ""
        yield unit, match[0], match["same"] or f"{re.sub(_NUMBER, other, match['numbers'])} {OTHERS[unit]}"
        place = match.end()
    yield "", text[place:], ""


def in_shown_units(text: str) -> str:
    """A text with its amounts in the units in which they are shown."""
    return "".join(other if unit != shown_unit(unit) else same for unit, same, other in in_both_units(text))


def heading_shown(text: str) -> str:
    """A heading, such as ``Glucose (mg/dl)``, with the unit in which the quantity is shown."""
    return _UNIT.sub(lambda result: shown_unit(result[0]), in_shown_units(text))


def headings_in_both(text: str) -> tuple[str, str]:
    """A heading in the units in which numbers are computed, and in the others."""
    amounts = "".join(other if unit else same for unit, same, other in in_both_units(text))
    return text, _UNIT.sub(lambda result: OTHERS[result[0]], amounts)
