"""A meal model from outside: a gut that is slower after fat.

glucoloop run --meal-model 'your_own_meal_model:AfterFat, fat_g=30'
"""

from typing import Annotated, ClassVar

from glucoloop.plugin import About, HovorkaGut, MealModelComponent

MIN_PER_G_OF_FAT = 0.7
"""Assumed here, to show how a meal model is made; no study is behind it."""


class AfterFat(MealModelComponent):
    """The gut of Hovorka et al. (2004) with an appearance that fat delays."""

    make: ClassVar = "your_own_meal_model:after_fat"
    fat_g: Annotated[float, About("Fat of each meal.", at_least=0.0, at_most=200.0)] = 20.0


def after_fat(fat_g: float) -> HovorkaGut:
    """The meal model; any `glucoloop.plugin.MealModel` will do."""
    return HovorkaGut(time_to_maximum_min=40.0 + MIN_PER_G_OF_FAT * fat_g)


def main() -> None:
    """Print when the appearance of a meal is largest."""
    for fat_g in (0.0, 30.0):
        print(f"{fat_g:g} g of fat: largest appearance after {after_fat(fat_g).time_to_maximum_min:g} min")


if __name__ == "__main__":
    main()
