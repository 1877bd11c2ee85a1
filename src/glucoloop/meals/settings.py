"""Meal models that can take the place of a patient's own: name and settings of each, and the place of its class.

A meal model joins every command by one class, entered in `MEAL_MODELS` or by the entry point of another package in the
group ``glucoloop.meal_models``.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.component.base import MadeComponent
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.setting import About


class MealModelComponent(MadeComponent):
    """Declaration of a meal model, a `meals.MealModel`."""

    kind: ClassVar = "meal model"


class LehmannDeutschSettings(MealModelComponent, name="lehmann-deutsch"):
    """A stomach that empties at most at a plateau rate, and a gut, of Lehmann and Deutsch (1992)."""

    sources = ("lehmann1992",)
    make: ClassVar = "glucoloop.meals:LehmannDeutsch"
    plateau_mg_min: Annotated[float, About("Largest rate of emptying.", above=0.0, at_most=1e5)] = 360.0
    ramp_min: Annotated[float, About("Length of each ramp of the rate.", above=0.0, at_most=1440.0)] = 30.0
    gut_time_constant_min: Annotated[float, About("Time constant of the gut.", above=0.0, at_most=1440.0)] = 60.0


class HovorkaGutSettings(MealModelComponent, name="hovorka"):
    """Two compartments in a row with one time constant, of Hovorka et al. (2004)."""

    sources = ("hovorka2004",)
    make: ClassVar = "glucoloop.meals:HovorkaGut"
    time_to_maximum_min: Annotated[
        float, About("Time from eating at once to the largest appearance.", above=0.0, at_most=1440.0)
    ] = 40.0
    bioavailability: Annotated[
        float, About("Share of the eaten carbohydrate that reaches the blood.", above=0.0, at_most=1.0)
    ] = 0.8


class RoyParkerSettings(MealModelComponent, name="roy-parker"):
    """A stomach that empties for an hour whatever the meal, and a gut, of Roy and Parker (2006)."""

    sources = ("royparker2006",)
    make: ClassVar = "glucoloop.meals:RoyParkerGut"
    rise_min: Annotated[float, About("Time in which emptying rises.", at_least=1.0, at_most=1440.0)] = 10.0
    plateau_min: Annotated[float, About("Time for which it stays.", at_least=0.0, at_most=1440.0)] = 35.0
    fall_min: Annotated[float, About("Time in which it falls.", at_least=1.0, at_most=1440.0)] = 10.0
    absorption_per_min: Annotated[float, About("Rate constant of the gut, per minute.", above=0.0, at_most=1.0)] = 0.022


class DallaManGutSettings(MealModelComponent, name="dalla-man"):
    """A stomach that empties by how much of the whole meal it holds, of Dalla Man et al. (2006)."""

    sources = ("dallaman2006", "dallaman2007")
    make: ClassVar = "glucoloop.meals:DallaManGut"
    k_max: Annotated[
        float, About("Largest rate of emptying, and rate of trituration, per minute.", above=0.0, at_most=1.0)
    ] = 0.0558
    k_min: Annotated[float, About("Smallest rate of emptying, per minute.", above=0.0, at_most=1.0)] = 0.0080
    k_abs: Annotated[float, About("Rate of absorption from the gut, per minute.", above=0.0, at_most=1.0)] = 0.057
    b: Annotated[
        float, About("Share of the meal in the stomach at which emptying is slower by half.", above=0.0, at_most=0.99)
    ] = 0.82
    d: Annotated[
        float, About("Share of the meal in the stomach at which emptying is faster by half.", above=0.001, at_most=0.99)
    ] = 0.010
    bioavailability: Annotated[
        float, About("Share of the absorbed carbohydrate that reaches the blood.", above=0.0, at_most=1.0)
    ] = 0.90


MEAL_MODELS: Final = Catalogue(
    MealModelComponent,
    {
        "lehmann-deutsch": "glucoloop.meals.settings:LehmannDeutschSettings",
        "hovorka": "glucoloop.meals.settings:HovorkaGutSettings",
        "roy-parker": "glucoloop.meals.settings:RoyParkerSettings",
        "dalla-man": "glucoloop.meals.settings:DallaManGutSettings",
    },
    example="hovorka, time_to_maximum_min=55",
)
