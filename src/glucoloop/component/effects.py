"""Settings without effect: a setting says what it needs, and a component what it uses, so that both can be compared.

`situations.unused` compares what was given of a request with what all of its components use, and words a note for each
setting that changes nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final


class NoEffectWarning(UserWarning):
    """A setting that was given changes nothing, since nothing that was chosen uses it."""


@dataclass(frozen=True)
class Need:
    """Something without which a setting has no effect."""

    reason: str
    """Clause on why there is no effect, where no part of a request uses or has it."""
    noun: str = ""
    """Name of it, where it is controllers that use it, and `reason` is for a request without a controller."""
    effect: str = "no effect"


MEALS: Final = Need("there is no meal")
EXERCISE: Final = Need("there is no exercise")
RHYTHMS: Final = Need("the patient has no rhythms")
CHANCE: Final = Need("nothing is drawn at random")
DEAD_TIME: Final = Need("readings have no dead time")
READINGS: Final = Need("nothing uses readings", "readings", "no effect on insulin and glucose")
ANNOUNCEMENTS: Final = Need("nothing uses announcements of meals", "announcements of meals")
MEALS_ANNOUNCED: Final = Need("meals are not announced")
AHEAD: Final = Need("nothing doses before a meal is eaten", "announcements before a meal is eaten")
TIME_OF_DAY: Final = Need("nothing goes by the time of day", "the time of day")
PROFILE: Final = Need("nothing doses by the profile of a person", "the profile of a person")
CARB_RATIO: Final = Need("nothing doses by the carbohydrate ratio of a person", "the carbohydrate ratio of a person")
CORRECTION: Final = Need("nothing doses by the correction factor of a person", "the correction factor of a person")
BOLUSES: Final = Need("no boluses are given", "boluses")
SUBCUTANEOUS: Final = Need("insulin is intravenous", effect="no meaning")
GLUCAGON: Final = Need("no glucagon is given")
FORECASTS: Final = Need("nothing forecasts glucose", "forecasts of glucose")
TEMPORARY_TARGETS: Final = Need("no target is temporary")
OTHERS_TO_COMPARE: Final = Need("there is one controller alone")
INDIVIDUAL: Final = Need("no controller is designed", "anything of a person in its design")
OF_CONTROLLERS: Final = frozenset(
    {READINGS, ANNOUNCEMENTS, AHEAD, TIME_OF_DAY, PROFILE, CARB_RATIO, CORRECTION, BOLUSES, INDIVIDUAL, FORECASTS}
)
"""Needs that controllers may meet, by what they use or give."""

EVERYTHING: Final = OF_CONTROLLERS | {MEALS, EXERCISE, CHANCE, DEAD_TIME, SUBCUTANEOUS, GLUCAGON, TEMPORARY_TARGETS}
"""All needs, which a study of many situations meets in one or another."""
ONLY_READINGS: Final = frozenset({READINGS})
"""Needs that most controllers meet."""
DOSES_BY_PROFILE: Final = frozenset({READINGS, ANNOUNCEMENTS, AHEAD, PROFILE, CARB_RATIO, CORRECTION})
"""Needs that controllers meet which dose by the profile of a person, with boluses for announced meals."""


def warn_without_effect(notes: Iterable[str], stacklevel: int = 2) -> None:
    """Warn of settings without effect; `stacklevel` 2 is the caller of the function that calls this."""
    for text in notes:
        warnings.warn(text, NoEffectWarning, stacklevel + 1)
