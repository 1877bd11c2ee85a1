"""Meal models that can take the place of a patient's own: name and settings of each, and the place of its class.

A meal model joins every command by one class, entered in `MEAL_MODELS` or by the entry point of another package in the
group ``glucoloop.meal_models``.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.parts.catalogue import Catalogue
from glucoloop.parts.part import MadePart
from glucoloop.parts.setting import About


class MealModelPart(MadePart):
    """Declaration of a meal model, a `meals.MealModel`."""

    kind: ClassVar = "meal model"


class LehmannDeutschSettings(MealModelPart, name="lehmann-deutsch"):
    """A stomach that empties at most at a plateau rate, and a gut, of Lehmann and Deutsch (1992)."""

    make: ClassVar = "glucoloop.meals:LehmannDeutsch"
    plateau_mg_min: Annotated[float, About("Largest rate of emptying.", above=0.0, at_most=1e5)] = 360.0
    ramp_min: Annotated[float, About("Length of each ramp of the rate.", above=0.0, at_most=1440.0)] = 30.0
    gut_time_constant_min: Annotated[float, About("Time constant of the gut.", above=0.0, at_most=1440.0)] = 60.0


class HovorkaGutSettings(MealModelPart, name="hovorka"):
    """Two compartments in a row with one time constant, of Hovorka et al. (2004)."""

    make: ClassVar = "glucoloop.meals:HovorkaGut"
    time_to_maximum_min: Annotated[
        float, About("Time from eating at once to the largest appearance.", above=0.0, at_most=1440.0)
    ] = 40.0
    bioavailability: Annotated[
        float, About("Share of the eaten carbohydrate that reaches the blood.", above=0.0, at_most=1.0)
    ] = 0.8


MEAL_MODELS: Final = Catalogue(
    MealModelPart, (LehmannDeutschSettings, HovorkaGutSettings), example="hovorka, time_to_maximum_min=55"
)
