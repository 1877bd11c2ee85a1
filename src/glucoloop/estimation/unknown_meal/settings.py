"""Estimators of meals that nobody announced: name and settings of each, and the place of the function that makes it.

An estimator joins the meal-aware controller and `glucoloop detect` by one class, entered in `ESTIMATORS` or by the
entry point of another package in the group ``glucoloop.estimators``.
"""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.component.part import MadePart
from glucoloop.component.setting import About

_samples: Final = functools.partial(About, at_least=2, at_most=100)

NoisePace = Annotated[
    float,
    About(
        "Pace at which the size of a correlated error of the sensor is learned, in mg/dl per innovation; "
        "0: the noise is as told.",
        at_least=0.0,
        at_most=1.0,
    ),
]


class EstimatorPart(MadePart):
    """Declaration of an estimator of meals, an `estimation.unknown_meal.MealEstimator`.

    Its function is also given, if it has parameters of these names, what the controller assumes: ``model``
    (`models.nonlinear.FedModel`), ``habits`` (`estimation.unknown_meal.MealHabits`), ``disturbance_variance`` and
    ``measurement_variance``.
    """

    kind: ClassVar = "estimator"


class MovingHorizonSettings(EstimatorPart, name="moving-horizon"):
    """Beginning and end of a meal, over the latest samples; learns the sensor's noise, and knows of lost insulin."""

    sources = ("lehmann1992", "rao2003", "blom1988", "zhang1998")
    make: ClassVar = "glucoloop.estimation.unknown_meal:design_meal_horizon"
    horizon: Annotated[int, _samples("Samples over which the beginning or end of a meal is searched for, L.")] = 6
    fast_horizon: Annotated[int, _samples("The same for meals through a fast gut, F.")] = 4
    largest_disturbance_mg_min: Annotated[
        float, About("Largest unexplained appearance of glucose that is believed, to either side.", above=0.0)
    ] = 100.0
    noise_drift: Annotated[
        float,
        About(
            "Probability that the size of the sensor's correlated error changes by 1 mg/dl from sample to sample; "
            "0: the noise is as told.",
            at_least=0.0,
            at_most=1.0,
        ),
    ] = 0.01
    noise_patience: Annotated[
        float,
        About(
            "Decay of the expected number of meals with the size of the sensor's correlated error, per mg/dl.",
            at_least=0.0,
        ),
    ] = 3.0
    ends_unseen: Annotated[
        float,
        About(
            "Probability that a meal ends in a sample without a reading, if above the usual.", at_least=0.0, below=1.0
        ),
    ] = 0.3
    failures_per_h: Annotated[
        float,
        About("Expected number of times per hour at which insulin ceases to arrive, unreported.", at_least=0.0),
    ] = 0.002
    failure_min: Annotated[float, About("Mean time until insulin arrives again.", above=0.0)] = 90.0
    fast_meals: Annotated[
        float,
        About("Share of the meals that go through a gut of 30 min in place of 60 min.", at_least=0.0, below=1.0),
    ] = 0.1


class KalmanSettings(EstimatorPart, name="kalman"):
    """Rate at which the stomach empties, a random walk, by an extended Kalman filter."""

    sources = ("lehmann1992", "jazwinski1970")
    make: ClassVar = "glucoloop.estimation.unknown_meal:design_meal_kalman"
    emptying_variance: Annotated[
        float, About("Variance of the change of that rate from sample to sample, (mg/min)².", above=0.0)
    ] = 2500.0
    state_variance: Annotated[float, About("Process noise of each state of the model, per sample.", above=0.0)] = 1e-3


ESTIMATORS: Final = Catalogue(
    EstimatorPart, (MovingHorizonSettings, KalmanSettings), example="moving-horizon, fast_meals=0", unnamed=True
)
