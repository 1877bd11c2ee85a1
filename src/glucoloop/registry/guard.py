"""Settings of the guard of a controller; nothing here imports a numerical library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from glucoloop.plausible import GLUCOSE_BOUND, Quantity
from glucoloop.registry.settings import Default, Setting, Value, known_names

PREFIX: Final = "guard_"


def _setting(name: str, summary: str, default: float, quantity: Quantity | None = None) -> Setting:
    return Setting(f"{PREFIX}{name}", float, summary, Default(default), quantity=quantity)


GUARD: Final[dict[str, Setting]] = {
    setting.name: setting
    for setting in (
        _setting("lowest_reading_mg_dl", "A lower reading is not believed.", 20.0, GLUCOSE_BOUND),
        _setting("highest_reading_mg_dl", "A higher reading is not believed.", 600.0, GLUCOSE_BOUND),
        _setting("fastest_mg_dl_min", "Fastest rise of a reading that is believed.", 3.0),
        _setting("stuck_min", "A reading that stays the same for so long under much insulin is not believed.", 20.0),
        _setting("stuck_on_board", "How much insulin that is, on board, as a part of the basal rate.", 0.25),
        _setting(
            "held_min", "Minutes for which a reading may stay the same and more than the basal rate be given.", 10.0
        ),
        _setting("gap_min", "Minutes without a believed reading after which the basal rate is given.", 20.0),
        _setting("long_gap_min", "Minutes after which a part of it is given.", 90.0),
        _setting("reduced_fraction", "That part.", 0.5),
        _setting("low_mg_dl", "Insulin is suspended if glucose is predicted to be lower.", 65.0, GLUCOSE_BOUND),
        _setting("ahead_min", "How far ahead that is predicted.", 40.0),
        _setting("hysteresis_mg_dl", "Insulin is given again above the bound and this.", 5.0),
        _setting("max_hour", "Largest dose in an hour, in basal hours.", 2.4),
        _setting("max_on_board", "Largest insulin on board beyond the basal rate, as a multiple of it.", 1.3),
        _setting("on_board_tau_min", "Time constant with which insulin on board is forgotten.", 90.0),
        _setting("fall_mg_dl", "Glucose above the setpoint for which one basal rate may be on board.", 60.0),
        _setting("error_mg_dl", "Error of the sensor that insulin is not added for.", 5.0),
        _setting("always_basal", "Multiple of the basal rate that is allowed whatever is read.", 1.2),
        _setting("doubt_tau_min", "Time constant with which a jump of the reading is forgotten.", 480.0),
    )
}
"""Settings by key; the keys are the fields of `control.GuardSettings`."""


def complete_guard(given: Mapping[str, object]) -> dict[str, Value]:
    """All limits of a guard: the given ones, and defaults for the others.

    Raises
    ------
    ValueError
        For an unknown limit, or a value that is no number.
    """
    for key in given:
        if key not in GUARD:
            raise ValueError(f"a guard has no limit {key!r}; {known_names(key, GUARD)}")
    checked = {key: GUARD[key].check(value) for key, value in given.items()}
    return {key: checked.get(key, setting.default.noise_free) for key, setting in GUARD.items()}
