"""Keys of a test of estimators of unknown meals, and its usual trial."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

from glucoloop.config.key import Key
from glucoloop.config.options.case import CONTROLLER_PANEL, OF_OTHERS
from glucoloop.config.options.trial import MEALS_PANEL, SITUATION_KEYS
from glucoloop.control.catalogue import CONTROLLERS, ESTIMATING
from glucoloop.limits import MOST_DAYS

ESTIMATORS: Final = ESTIMATING.setting("estimator").choices
USUAL: Final[Mapping[str, Any]] = {
    "population": "nominal",
    "people": 1,
    "meals": ["55g@5h", "55g@14.5h"],
    "meal_size_spread_pct": 80.0,
    "meal_time_spread_min": 90.0,
    "noise_variance": 1.45,
}
"""Usual keys of the trial: two meals a day of 11 to 99 g, so far apart that one is over when the next begins."""
USUAL_DAYS: Final = 100
"""Usual number of days of one person; of several people, one day each."""
PEOPLE_KEYS: Final = ("people", "population", "first_person", "meals", "meal_size_spread_pct", "meal_time_spread_min")
NO_SITUATION: Final = "announce_meals"
"""Key that the test does not take, since an estimator need not find announced meals."""
TAKEN: Final = (
    *PEOPLE_KEYS,
    *(key for key in SITUATION_KEYS if key not in (NO_SITUATION, "metrics")),
    "known_dead_time",
)
"""Keys that the test has in common with a trial."""
ESTIMATORS_PANEL: Final = "Estimators"
_estimators = functools.partial(Key, panel=ESTIMATORS_PANEL)


@dataclass(frozen=True, kw_only=True)
class DetectionKeys:
    """Keys of such a test that a trial does not have, or that have another meaning here."""

    days: Annotated[
        int | None,
        Key(
            "Days of each person.",
            panel=MEALS_PANEL,
            told=f"{USUAL_DAYS}; of several people 1",
            at_least=1,
            at_most=MOST_DAYS,
        ),
    ] = None
    estimators: Annotated[
        tuple[str, ...],
        _estimators(f"{', '.join(ESTIMATORS)}; repeat it for more.", flag="--estimator", told="both"),
    ] = ESTIMATORS
    threshold: Annotated[
        float, _estimators("Probability of a meal above which it counts as detected.", metavar="P")
    ] = 0.5
    controller: Annotated[
        str, Key(f"Controller that doses: {', '.join(CONTROLLERS)}, {OF_OTHERS}.", panel=CONTROLLER_PANEL)
    ] = ESTIMATING.name
