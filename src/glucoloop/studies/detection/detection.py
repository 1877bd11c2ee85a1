"""Definition of a test of estimators of unknown meals, on days of people under a controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.cohorts.trial import Trial
from glucoloop.meals.plan import MealPlan
from glucoloop.parts.setting import Value, known_names
from glucoloop.refusal import Refusal
from glucoloop.studies.detection.options import ESTIMATORS

MOST_RUNS: Final = 100_000


@dataclass(frozen=True, kw_only=True)
class Detection:
    """Estimators, and the days on which they are tried.

    Each day of each person begins at rest at midnight and has meals and noise of its own. As many days again are
    without a meal.

    Raises
    ------
    ValueError
        For no estimator, an unknown one or one that is named twice, a threshold that is no probability, or more days
        than can be computed.
    """

    trial: Trial
    """People, the plan of one day, sensor and pump, and the controllers: a case for each estimator, by its name, where
    the controller rests on it, or one case alone."""
    days: int
    """Number of days of each person."""
    estimators: tuple[str, ...]
    settings: Mapping[str, Value]
    """All settings of every estimator; see `control.catalogue.ESTIMATING`."""
    threshold: float
    """Probability of a meal above which it counts as detected."""
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Keys from which it was read, if it was."""

    def __post_init__(self) -> None:
        check_estimators(self.estimators)
        if not 0.0 < self.threshold < 1.0:
            raise Refusal(f"a threshold of {self.threshold:g} is not possible; give more than 0 and less than 1")
        if self.trial.people * self.days > MOST_RUNS:
            raise Refusal(
                f"{self.days} days of {self.trial.people} people are too many; give at most {MOST_RUNS} days in all"
            )

    @property
    def plan(self) -> MealPlan:
        """Meals of all days of a person."""
        day = self.trial.plan
        return MealPlan(day.meals, self.days, size_spread_pct=day.size_spread_pct, time_spread_min=day.time_spread_min)

    def case(self, estimator: str) -> str:
        """Label of the case under whose doses an estimator is tried."""
        labels = [case.label for case in self.trial.cases]
        return estimator if estimator in labels else labels[0]


def check_estimators(names: Sequence[str], called: str = "estimators") -> None:
    """Refuse an empty list, an unknown estimator, and a repeated one.

    Raises
    ------
    ValueError
        For such a list, with its name in the message.
    """
    if not names:
        raise Refusal(f"{called} names none; give one or more of {', '.join(ESTIMATORS)}")
    for name in names:
        if name not in ESTIMATORS:
            raise Refusal(f"{called} has the unknown {name!r}; {known_names(name, ESTIMATORS)}")
        if list(names).count(name) > 1:
            raise Refusal(f"{called} has {name!r} twice; leave one out")
