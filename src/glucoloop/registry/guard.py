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
        _setting("lowest_reading_mg_dl", "Lowest reading that the guard accepts.", 20.0, GLUCOSE_BOUND),
        _setting("highest_reading_mg_dl", "Highest reading that the guard accepts.", 600.0, GLUCOSE_BOUND),
        _setting("fastest_mg_dl_min", "Fastest rise of a reading that the guard accepts.", 3.0),
        _setting(
            "stuck_min",
            "Minutes after which an unchanged reading is rejected while much or little insulin is on board.",
            20.0,
        ),
        _setting(
            "stuck_on_board",
            "Insulin on board, above or below that of the basal rate, that counts for this; in basal rates.",
            0.25,
        ),
        _setting(
            "held_min", "Minutes for which a reading may stay unchanged before at most the basal rate is given.", 10.0
        ),
        _setting("gap_min", "Minutes without an accepted reading after which the basal rate is given.", 20.0),
        _setting(
            "long_gap_min", "Minutes without an accepted reading after which a part of the basal rate is given.", 90.0
        ),
        _setting("reduced_fraction", "Part of the basal rate that is given then.", 0.5),
        _setting("low_mg_dl", "Predicted glucose below which insulin is suspended.", 65.0, GLUCOSE_BOUND),
        _setting("ahead_min", "Time of this prediction.", 40.0),
        _setting("hysteresis_mg_dl", "Distance above that bound from which insulin is given again.", 5.0),
        _setting("max_hour", "Largest dose in an hour, in basal hours.", 2.4),
        _setting("max_on_board", "Largest insulin on board beyond the basal rate, as a multiple of it.", 1.3),
        _setting("on_board_tau_min", "Time constant with which insulin on board decays.", 90.0),
        _setting("fall_mg_dl", "Glucose above the setpoint for which one basal rate may be on board.", 60.0),
        _setting("error_mg_dl", "Sensor error for which no insulin is added.", 5.0),
        _setting("always_basal", "Multiple of the basal rate that is allowed at any reading.", 1.2),
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
