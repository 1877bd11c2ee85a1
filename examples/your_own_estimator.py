"""An estimator of meals from outside: ours, for a person who often drinks juice.

glucoloop run --controller 'meal-mpc, estimator=(your_own_estimator:Juice, share=0.5)'
glucoloop detect --estimator moving-horizon --estimator your_own_estimator:Juice
"""

from typing import Annotated, ClassVar

from glucoloop.plugin import (
    About,
    EstimatorComponent,
    FedModel,
    MealHabits,
    MealHorizon,
    design_meal_horizon,
)


class Juice(EstimatorComponent):
    """The moving horizon, with many meals through a fast gut, which are searched for longer."""

    make: ClassVar = "your_own_estimator:for_juice"
    share: Annotated[float, About("Share of juice among the meals.", at_least=0.0, below=1.0)] = 0.5


def for_juice(share: float, model: FedModel, habits: MealHabits, measurement_variance: float) -> MealHorizon:
    """The estimator; any `glucoloop.plugin.MealEstimator` will do."""
    return design_meal_horizon(
        model, habits, measurement_variance=measurement_variance, fast_meals=share, fast_horizon=6
    )


def main() -> None:
    """Print the estimator as a text, as on the command line."""
    print(Juice(share=0.4).text)


if __name__ == "__main__":
    main()
