"""Settings of the guard of a controller; nothing here imports a numerical library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from glucoloop.plausible import GLUCOSE_BOUND, Quantity
from glucoloop.registry.patients import INTRAVENOUS, SUBCUTANEOUS, USUAL_PATIENT, PatientEntry
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


OF_ROUTE: Final[dict[str, dict[str, float]]] = {
    INTRAVENOUS: {},
    # A total daily dose is taken for 48 basal hours, since half of it is basal. By the rules of 500 and 1800 a gram of
    # carbohydrate then needs 0.096 basal hours, and a basal hour lowers glucose by 37.5 mg/dl.
    SUBCUTANEOUS: {
        # 5 % of a dose are left after 6 h, the duration of action that Loop and the pumps' calculators use (5 to 7 h).
        "guard_on_board_tau_min": 120.0,
        # Ten basal hours: the bolus for 70 g and three basal hours more, a bound like max_iob of open-source systems.
        "guard_max_on_board": 5.0,
        # All of it at once, beside the basal rate.
        "guard_max_hour": 11.0,
        # One basal rate on board is 2 basal hours.
        "guard_fall_mg_dl": 75.0,
    },
}
"""Usual limits by route of insulin, where they differ from the setting's own default, which is for a vein."""


def usual_limit(key: str, entry: PatientEntry) -> float:
    """A limit of a guard that is usual for a patient: the patient's own, that of the route, or the general one."""
    general = float(GUARD[key].default.noise_free)
    return float(entry.guard.get(key, OF_ROUTE[entry.insulin_route].get(key, general)))


def usual_text(key: str) -> str:
    """Usual values of a limit for help: the general one, and that of insulin under the skin where it differs."""
    setting, other = GUARD[key], OF_ROUTE[SUBCUTANEOUS].get(key)
    return setting.default.text if other is None else f"{setting.default.text}; {other:g} under the skin"


def complete_guard(given: Mapping[str, object], entry: PatientEntry = USUAL_PATIENT) -> dict[str, Value]:
    """All limits of a guard: the given ones, and those usual for the patient for the others.

    Raises
    ------
    ValueError
        For an unknown limit, or a value that is no number.
    """
    for key in given:
        if key not in GUARD:
            raise ValueError(f"a guard has no limit {key!r}; {known_names(key, GUARD)}")
    checked = {key: GUARD[key].check(value) for key, value in given.items()}
    return {key: checked.get(key, usual_limit(key, entry)) for key in GUARD}
