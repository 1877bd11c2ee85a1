"""The scenarios of this package."""

from __future__ import annotations

from glucoloop.meals.habits import HABITS, HabitComponent
from glucoloop.situations.scenarios import ScenarioComponent


class PlainDay(ScenarioComponent, name="plain-day"):
    """A day with three meals that are announced and counted exactly."""

    announce_meals: bool = True


class UnkindDay(ScenarioComponent, name="unkind-day"):
    """A day with a snack in the afternoon that nobody announced, and a large late dinner that is announced late."""

    meals: tuple[str, ...] = ("45g@7h", "70g@12h", "110g@21h")
    announce_meals: bool = True
    habits: tuple[HabitComponent, ...] = (
        HABITS.choose("snack, carbs_g=30, time=15.5h, probability=1"),
        HABITS.choose("announced-late, minutes=20, meal=3"),
    )


class Week(ScenarioComponent, name="week"):
    """A week as people live it: meals that vary and are counted with errors, snacks, missed boluses, and a weekend."""

    days: int | None = 7
    announce_meals: bool = True
    carb_error_pct: float = 20.0
    meal_size_spread_pct: float = 25.0
    meal_time_spread_min: float = 30.0
    habits: tuple[HabitComponent, ...] = (
        HABITS.choose("weekend"),
        HABITS.choose("snack, probability=0.4, size_spread_pct=50, time_spread_min=60"),
        HABITS.choose("announced-late, minutes=5, spread_min=15"),
        HABITS.choose("unannounced, probability=0.1"),
        HABITS.choose("skipped, probability=0.03"),
    )


class Year(Week, name="year"):
    """52 such weeks, the length of the virtual trial of Reenberg et al. (arXiv 2202.13927)."""

    days: int | None = 364


class CustomScenario(ScenarioComponent, name="custom"):
    """A scenario of your own, from a file."""
