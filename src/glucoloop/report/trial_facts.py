"""Settings of a trial in words."""

from __future__ import annotations

from glucoloop.cohorts.trial import Trial
from glucoloop.meals import Meal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H


def _length(trial: Trial) -> str:
    plan = trial.plan
    if plan.horizon_min != plan.days * MIN_PER_DAY:
        return f"{plan.horizon_min:g} min"
    return "a day" if plan.days == 1 else f"{plan.days} days"


def _clock(t_min: float) -> str:
    return f"{t_min:g} min" if t_min % 15.0 else f"{t_min / MIN_PER_H:g} h"


def _told(meal: Meal) -> str:
    eaten = f", eaten for {meal.eating_min:g} min" if meal.eating_min else ""
    return f"{meal.carbs_g:g} g at {_clock(meal.t_min)}{eaten}"


def facts(trial: Trial) -> dict[str, str]:
    """Settings of a trial for the head of a page."""
    plan = trial.plan
    meals = ", ".join(map(_told, plan.meals)) or "none"
    if plan.varies:
        meals += f"; varied by {plan.size_spread_pct:g} % and {plan.time_spread_min:g} min"
    noise = f"variance {trial.noise_variance:g}, at most {trial.noise_bound_mg_dl:g} mg/dl"
    told = {
        "Population": f"{trial.population.name}: {trial.population.summary}".removesuffix(": "),
        "Seed": str(trial.seed),
        "Length": _length(trial),
        "Meals": meals + (", announced" if trial.announced and plan.meals else ""),
        "Meal model": str(trial.meal_model or "each person's own"),
        "Noise": noise if trial.noise_variance else "none",
        "Dead time": f"{trial.dead_time_samples * trial.sample_time_min:g} min",
        "Designed for": "the nominal patient" if trial.design == "nominal" else "each person",
        "Precision": trial.precision,
        "Arithmetic": trial.arithmetic,
    }
    if trial.first_person:
        told["First person"] = str(trial.first_person)
    if trial.faults:
        told["Faults"] = "; ".join(trial.faults)
    return told
