"""The scenarios of this package."""

from __future__ import annotations

from glucoloop.control.action import ACTIONS, ActionComponent
from glucoloop.faults import FAULTS, FaultComponent
from glucoloop.meals.habits import HABITS, HabitComponent
from glucoloop.physiology.rhythm import RHYTHMS, RhythmComponent
from glucoloop.situations.scenarios import ScenarioComponent
from glucoloop.situations.therapy_settings import PROFILE_ERRORS, ProfileErrorComponent


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


class BlockedLine(PlainDay, name="occlusion"):
    """A plain day on which the line is blocked for an hour at lunch, and high glucose is corrected by hand at 14:00."""

    events: tuple[FaultComponent, ...] = (FAULTS.choose("occlusion, start=11.75h, duration=1h"),)
    actions: tuple[ActionComponent, ...] = (ACTIONS.choose("bolus, time=14h, above_mg_dl=180"),)


class DriftingSensor(PlainDay, name="sensor-drift"):
    """A plain day on which readings rise by 60 mg/dl too much from 08:00 to 14:00, when the sensor is replaced."""

    events: tuple[FaultComponent, ...] = (FAULTS.choose("drift, start=8h, duration=6h, mg_dl_h=10"),)


class DroppedBolus(PlainDay, name="dropped-bolus"):
    """A plain day on which no bolus is given from 11:45 to 12:30: that of the lunch is dropped."""

    actions: tuple[ActionComponent, ...] = (ACTIONS.choose("no-bolus, time=11.75h, duration=45min"),)


class ExerciseDay(PlainDay, name="exercise"):
    """A plain day with moderate exercise from 16:00 to 16:45, of which nobody is told.

    Insulin acts twice as much during it, and 1 mg/kg/min of glucose is taken up without insulin; sensitivity then fades
    back with a time constant of three hours.
    """

    rhythm: tuple[RhythmComponent, ...] = (
        RHYTHMS.choose("sensitivity, factor=2, from=16h, duration=45min, fade=3h, uptake_mg_kg_min=1"),
    )


class AnnouncedExercise(ExerciseDay, name="exercise-announced"):
    """The day with exercise of which the controller is told at 11:55, before the lunch."""

    actions: tuple[ActionComponent, ...] = (ACTIONS.choose("exercise, time=16h, duration=45min, before_min=245"),)


class Illness(PlainDay, name="illness"):
    """A plain day of an infection, on which insulin acts by 30 % less."""

    rhythm: tuple[RhythmComponent, ...] = (RHYTHMS.choose("sensitivity, factor=0.7, from=0h, duration=24h"),)


class RatiosHalved(PlainDay, name="ratios-halved"):
    """A plain day with half of the person's carbohydrate ratio and correction factor: boluses are twice as large."""

    profile_error: ProfileErrorComponent | None = PROFILE_ERRORS.choose("ratio_pct=50")


class RatiosDoubled(PlainDay, name="ratios-doubled"):
    """A plain day with twice the person's carbohydrate ratio and correction factor: boluses are half as large."""

    profile_error: ProfileErrorComponent | None = PROFILE_ERRORS.choose("ratio_pct=200")


class BasalHalved(PlainDay, name="basal-halved"):
    """A plain day with half of the person's basal rate in the profile."""

    profile_error: ProfileErrorComponent | None = PROFILE_ERRORS.choose("basal_pct=50")


class BasalDoubled(PlainDay, name="basal-doubled"):
    """A plain day with twice the person's basal rate in the profile."""

    profile_error: ProfileErrorComponent | None = PROFILE_ERRORS.choose("basal_pct=200")


class TwoMeals(PlainDay, name="two-meals"):
    """A plain day on which the lunch is followed by 50 g half an hour later."""

    meals: tuple[str, ...] = ("45g@7h", "70g@12h", "50g@12.5h", "60g@18h")


class SlowMeal(PlainDay, name="slow-meal"):
    """A plain day with a large dinner that enters slowly, as a pizza does: 110 g spread over three hours."""

    meals: tuple[str, ...] = ("45g@7h", "70g@12h", "110g@18h/3h")


class CustomScenario(ScenarioComponent, name="custom"):
    """A scenario of your own, from a file."""
