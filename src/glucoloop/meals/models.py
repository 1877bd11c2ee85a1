"""Meal models by name, and the meal model of a patient.

A meal model joins every command by one class, entered in `MEAL_MODELS` or by the entry point of another package in the
group ``glucoloop.meal_models``.
"""

from __future__ import annotations

from typing import ClassVar, Final

from glucoloop._lazy_jax import jax, np
from glucoloop.arguments import is_traced
from glucoloop.component.base import MadeComponent
from glucoloop.component.catalogue import Catalogue
from glucoloop.meals.protocol import Ingestion, MealModel
from glucoloop.refusal import Refusal


class MealModelComponent(MadeComponent):
    """Declaration of a meal model, a `meals.MealModel`."""

    kind: ClassVar = "meal model"


MEAL_MODELS: Final = Catalogue(
    MealModelComponent,
    {
        "lehmann-deutsch": "glucoloop.meals.lehmann_deutsch:LehmannDeutschSettings",
        "hovorka": "glucoloop.meals.hovorka:HovorkaGutSettings",
        "roy-parker": "glucoloop.meals.roy_parker:RoyParkerSettings",
        "dalla-man": "glucoloop.meals.dalla_man:DallaManGutSettings",
    },
    example="hovorka, time_to_maximum_min=55",
)


def meal_model(text: str) -> MealModel:
    """A meal model from its name, with its published numbers where none are given: ``hovorka, bioavailability=1``."""
    model: MealModel = MEAL_MODELS.choose(text).made()
    return model


def meal_model_of(patient: object, instead: MealModel | None = None) -> MealModel:
    """The meal model that feeds a patient.

    Parameters
    ----------
    patient : Patient
        Patient whose attribute ``meal_model`` is used; without one, Lehmann and Deutsch's model with published numbers.
    instead : MealModel, optional
        Meal model to use in place of the patient's own.

    Raises
    ------
    ValueError
        For another model than its own where the patient digests in its own states.
    """
    from glucoloop.meals.lehmann_deutsch import LehmannDeutsch

    of_patient: MealModel = getattr(patient, "meal_model", LehmannDeutsch())
    if instead is not None and isinstance(of_patient, Ingestion):
        raise Refusal(
            f"{type(patient).__name__} digests meals in its own states, so no other meal model can feed it; "
            "leave meal_model out"
        )
    return of_patient if instead is None else instead


def check_meal_model(model: MealModel) -> None:
    """Refuse a meal model with a number that is not positive and finite; one that JAX traces is not looked at."""
    for path, value in jax.tree_util.tree_leaves_with_path(model):
        numbers = np.zeros(0) if is_traced(value) else np.asarray(value, float)
        bad = numbers[~(np.isfinite(numbers) & (numbers > 0.0))]
        if bad.size:
            name = jax.tree_util.keystr(path).removeprefix(".")
            raise Refusal(f"{name} of {bad.flat[0]:g} is not possible for a meal model; give a finite value above 0")
