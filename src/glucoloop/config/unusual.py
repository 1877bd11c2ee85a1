"""Questions about values of a configuration that are possible but probably not meant.

The plausible range of a key stands in its type, beside its bounds; that of a setting of a controller, a guard or a
fault stands in the catalogue. `allow_unusual` in a file, or the option, confirms all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from glucoloop.config.key import quantities
from glucoloop.parts.part import Part
from glucoloop.patients import Patient
from glucoloop.plausible import CONFIRM_OPTION, LARGEST_RATE, LEAST_RATE, MEAL, Quantity, ask
from glucoloop.refusal import Refusal
from glucoloop.situations.meal_text import meal_text, names_units, parse_meal
from glucoloop.units import HOURS_PER_DAY, MIN_PER_DAY

Names = Mapping[str, str] | None
"""Name under which the user gave each key."""
ALLOW_UNUSUAL: Final = "allow_unusual"


def ask_about(record: object, names: Names = None, others: Mapping[str, Quantity] | None = None) -> None:
    """Ask for confirmation of the values of a record outside their plausible ranges; `others` replace some of these.

    Raises
    ------
    ValueError
        For the first such value, with the unit in which it would be plausible and the way to confirm it.
    """
    for key, quantity in quantities(type(record)):
        value = getattr(record, key)
        if value is not None:
            _ask(value, (others or {}).get(key, quantity), key, names)


def ask_about_settings(
    settings: Iterable[Any], given: Mapping[str, object], names: Names = None, *, otherwise: Quantity | None = None
) -> None:
    """Ask for confirmation of unusual settings of a catalogue that were given; `otherwise` is that of other numbers."""
    for setting in settings:
        value, quantity = given.get(setting.name), setting.quantity or otherwise
        if quantity is not None and setting.kind in (int, float) and isinstance(value, int | float):
            _ask(value, quantity, setting.name, names)


def ask_about_part(part: Part) -> None:
    """Ask for confirmation of unusual settings of a part."""
    for name, value in part.values().items():
        part.setting(name).ask(value, f"{name} of the {part.kind} {part.name}")


def ask_about_meals(texts: Iterable[str]) -> None:
    """Ask for confirmation of meals of unusual size, or without any unit."""
    for text in texts:
        meal = parse_meal(text)
        if not any(names_units(text)):
            raise Refusal(
                f"the meal {text!r} names no unit; write {meal_text(meal)}, or {CONFIRM_OPTION} if that is meant"
            )
        ask(meal.carbs_g, MEAL, f"the size of the meal at {meal.t_min:g} min", CONFIRM_OPTION)


def ask_about_clock(meals: Iterable[str], horizon_min: float) -> None:
    """Ask about a meal like ``45g@7`` in a run of a day or longer, where hours were probably meant."""
    if horizon_min < MIN_PER_DAY:
        return
    for text in meals:
        meal = parse_meal(text)
        if not names_units(text)[1] and 0.0 < meal.t_min < HOURS_PER_DAY:
            size, time = f"{meal.carbs_g:g}g", f"{meal.t_min:g}"
            eating = f"/{meal.eating_min:g}min" if meal.eating_min else ""
            raise Refusal(
                f"the meal {text!r} begins {time} min after the start; that looks like hours. "
                f"Write {size}@{time}h{eating}, or {size}@{time}min{eating} if minutes are meant"
            )


def ask_about_pump(
    person: Patient,
    setpoint_mg_dl: float | None,
    *,
    min_insulin_mU_min: float,
    max_insulin_mU_min: float,
    names: Names = None,
) -> None:
    """Ask about a pump that cannot deliver the rate at which the patient rests.

    A target above the patient's own needs less insulin than that, so that a smaller pump is enough.
    """
    basal, resting = float(person.basal_insulin_mU_min), float(person.setpoint_mg_dl)
    if setpoint_mg_dl is not None and setpoint_mg_dl > resting:
        return
    rest = f"{basal:.1f} mU/min to rest at {resting:.1f} mg/dl"
    if max_insulin_mU_min < basal:
        most = LARGEST_RATE.within(least=basal, reason=f"the patient needs {rest}")
        _ask(max_insulin_mU_min, most, "max_insulin_mU_min", names)
    if basal < min_insulin_mU_min < max_insulin_mU_min:
        least = LEAST_RATE.within(most=basal, reason=f"the patient needs only {rest}")
        _ask(min_insulin_mU_min, least, "min_insulin_mU_min", names)


def _ask(value: float, quantity: Quantity, key: str, names: Names) -> None:
    ask(value, quantity, (names or {}).get(key, key), CONFIRM_OPTION)
