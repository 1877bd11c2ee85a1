"""Test of estimators of unknown meals: delay, certainty and accuracy on days of people under a controller."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.config.options.case import CONTROLLER_PANEL, OF_OTHERS
from glucoloop.config.options.trial import MEALS_PANEL, SITUATION_KEYS
from glucoloop.control.catalogue import CONTROLLERS, ESTIMATING, all_settings
from glucoloop.limits import MOST_DAYS
from glucoloop.studies.study import PlainStudy

ESTIMATORS: Final = ESTIMATING.setting("estimator").choices
USUAL_DAYS: Final = 100
"""Usual number of days of one person; of several people, one day each."""
ANNOUNCEMENTS: Final = ("announce_meals", "carb_error_pct", "carb_bias_pct")
"""Keys that the test does not take, since an estimator need not find announced meals."""
TAKEN: Final = (
    *("people", "population", "first_person", "meals", "meal_size_spread_pct", "meal_time_spread_min"),
    *(key for key in SITUATION_KEYS if key not in (*ANNOUNCEMENTS, "metrics")),
    "known_dead_time",
)
"""Keys that the test has in common with a trial."""
_PANEL: Final = "Estimators"
_SETTINGS: Final = {name: ESTIMATING.setting(name) for name in ESTIMATING.estimator_settings}
_estimators = functools.partial(Key, panel=_PANEL)


@dataclass(frozen=True, kw_only=True)
class DetectionSettings:
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
        float,
        _estimators("Probability of a meal above which it counts as detected.", metavar="P", above=0.0, below=1.0),
    ] = 0.5
    controller: Annotated[
        str, Key(f"Controller that doses: {', '.join(CONTROLLERS)}, {OF_OTHERS}.", panel=CONTROLLER_PANEL)
    ] = ESTIMATING.name


DETECT: Final = PlainStudy(
    name="detect",
    what="a test of estimators",
    help=(
        "Test the estimators of meals that nobody announced: how soon a meal is detected, how exactly its size is "
        "estimated, and how often there is a false alarm.\n\n"
        "Each day begins at rest and has its own meals and noise; the same number of days is without a meal. By "
        "default 100 days of one person are simulated, with two meals a day of 11 to 99 g, noise of variance 1.45, and "
        f"doses by {ESTIMATING.name}, which uses the estimator. Other controllers, such as basal, do not use it.\n\n"
        "  glucoloop detect --out detect\n\n"
        "  glucoloop detect --controller basal --estimator moving-horizon --threshold 0.8\n\n"
        "  glucoloop detect --population parker2000 --people 100 --meals-per-h 0.1 --out people\n\n"
        "  glucoloop detect --config detect/detect.toml"
    ),
    module="glucoloop.studies.detection.study",
    settings=(DetectionSettings,),
    shared="trial",
    taken=(*TAKEN, "settings", *all_settings()),
    refused=("estimator",),
    # two meals a day of 11 to 99 g, so far apart that one is over when the next begins
    usual={
        "population": "nominal",
        "people": 1,
        "meals": ["55g@5h", "55g@14.5h"],
        "meal_size_spread_pct": 80.0,
        "meal_time_spread_min": 90.0,
        "noise_variance": 1.45,
    },
    words={
        "help": {
            "known_dead_time": "Whether controller and estimators know the dead time.",
            **{name: setting.summary for name, setting in _SETTINGS.items()},
        },
        "default": {name: setting.default.text for name, setting in _SETTINGS.items()},
        "panel": dict.fromkeys(_SETTINGS, _PANEL),
    },
    summary="detect.json",
)
